// Ensembles, and who coordinates: voters, nodes, takeovers.

import { byId, cells, clock, make, numberCell, redraw, since, span, state } from './dom.js';

/** Columns of numbers. */
const NUMBERS = ['Age', 'Without'];

const table = (caption, heads, rows) =>
  make('table', {}, make('caption', { className: 'unseen' }, caption), make('thead', {}, make('tr', {}, heads.map((head) => make('th', { scope: 'col', className: NUMBERS.includes(head) ? 'number' : '' }, head)))), make('tbody', {}, rows));

function row(head, ...others) {
  const element = make('tr');
  cells(element, head, ...others);
  return element;
}

export function ensembles(picture) {
  const place = byId('ensembles');
  const shown = JSON.stringify(picture.ensembles);
  if (place.shown === shown) return;
  place.shown = shown;
  const all = Object.entries(picture.ensembles ?? {});
  if (all.length === 0) return redraw(place, make('p', { className: 'none' }, 'No ensemble is known yet.'));
  redraw(place, all.map(([name, { members = [], others = {} }]) => [
    make('h3', {}, `${name}: ${members.length} members`),
    make('ul', { className: 'members' }, members.map((member) => make('li', {}, member))),
    Object.keys(others).length ? make('h3', {}, 'Not members, and why') : null,
    Object.keys(others).length ? table(`Nodes that are no members of ${name}`, ['Node', 'Why not'], Object.entries(others).map(([node, why]) => row(node, make('td', { className: 'wrap' }, why)))) : null,
  ]).flat());
}

export function coordination(picture) {
  const place = byId('coordination');
  const { coordinator, takeovers = [], nodes = {} } = picture;
  const steady = Object.entries(nodes).map(([name, node]) => [name, { ...node, heard_ms: Math.round(node.heard_ms / 2000) }]);
  const shown = JSON.stringify([{ ...coordinator, quorum_ms: 0 }, takeovers, steady]);
  if (place.shown === shown) return;
  place.shown = shown;
  const facts = make('dl', { className: 'notes' });
  const fact = (name, ...value) => facts.append(make('div', {}, make('dt', {}, name), make('dd', {}, ...value)));
  if (coordinator) {
    fact('coordinator', coordinator.node);
    fact('term', String(coordinator.term));
    fact('since', clock(coordinator.since_ms), ' (', since(coordinator.since_ms), ')');
    fact('voters', (coordinator.voters ?? []).join(', ') || '–');
    if (coordinator.observers?.length) fact('observers', coordinator.observers.join(', '));
    if (coordinator.voters_lost?.length) fact('voters lost', coordinator.voters_lost.join(', '));
  }
  const changes = takeovers.toReversed().map((one) => row(clock(one.at_ms), one.node, String(one.term), one.from ?? '–', numberCell(one.from ? span(one.gap_ms) : '–')));
  const list = Object.entries(nodes).map(([name, node]) => {
    const is = [coordinator?.node === name && 'coordinator', coordinator?.voters?.includes(name) && 'voter', node.stationary && 'stationary', node.mains_powered && 'on mains', node.leaving && 'leaving'];
    return row(name, make('td', {}, state(node.alive ? 'good' : 'bad', node.alive ? 'alive' : node.status)), is.filter(Boolean).join(', ') || '–', numberCell(since(node.heard_ms)));
  });
  redraw(
    place,
    coordinator ? facts : make('p', { className: 'none' }, 'No coordinator was heard yet.'),
    make('h3', {}, 'Takeovers'),
    changes.length ? table('Changes of the coordinator, the latest first', ['When', 'Coordinator', 'Term', 'After', 'Without'], changes) : make('p', { className: 'muted' }, 'None was seen.'),
    make('h3', {}, 'Nodes'),
    table('Nodes, how they are and how long ago they were heard', ['Node', 'Is', 'Part', 'Age'], list),
  );
}
