// Ensembles, and who coordinates: voters, nodes, takeovers.

import { byId, cells, clock, make, numberCell, redraw, since, span, state, words } from './dom.js';

const LEVELS = { ok: ['good', 'well'], warning: ['warn', 'warning'], error: ['bad', 'error'] };

/** Columns of numbers. */
const NUMBERS = ['Age', 'Without'];

const table = (caption, heads, rows) =>
  make('table', {}, make('caption', { className: 'unseen' }, caption), make('thead', {}, make('tr', {}, heads.map((head) => make('th', { scope: 'col', className: NUMBERS.includes(head) ? 'number' : '' }, head)))), make('tbody', {}, rows));

function row(head, ...others) {
  const element = make('tr');
  cells(element, head, ...others);
  return element;
}

/** Who is a member and why others are not, each with how old that knowledge is. */
export function ensembles(picture) {
  const place = byId('ensembles');
  const heard = (name) => picture.nodes?.[name]?.heard_ms;
  const steady = (name) => Math.round((heard(name) ?? 0) / 2000);
  const shown = JSON.stringify([picture.ensembles, Object.keys(picture.nodes ?? {}).map(steady)]);
  if (place.shown === shown) return;
  place.shown = shown;
  const all = Object.entries(picture.ensembles ?? {});
  if (all.length === 0) return redraw(place, make('p', { className: 'none' }, 'No ensemble is known yet.'));
  const age = (name) => numberCell(heard(name) ? since(heard(name)) : '–');
  redraw(place, all.map(([name, { members = [], others = {}, membership = [], skills = [], stale_after_ms }]) => {
    const facts = make('dl', { className: 'notes' });
    const fact = (word, ...value) => facts.append(make('div', {}, make('dt', {}, word), make('dd', {}, ...value.flat())));
    if (membership.length) fact('asks that', membership.map((one, index) => [index ? ' and ' : '', make('code', {}, one)]).flat());
    if (skills.length) fact('skills', skills.map(words).join(', '));
    if (stale_after_ms) fact('not heard for', `${span(stale_after_ms)}: no member`);
    const rows = [
      ...members.map((node) => row(node, make('td', {}, state('good', 'member')), age(node))),
      ...Object.entries(others).map(([node, why]) => row(node, make('td', { className: 'wrap' }, state('wait', 'no member'), make('span', { className: 'sub' }, why)), age(node))),
    ];
    return [
      make('h3', {}, `${name}: ${members.length} ${members.length === 1 ? 'member' : 'members'} of ${rows.length} nodes`),
      facts,
      table(`Nodes: who is a member of ${name}, and why the others are not`, ['Node', 'Is', 'Age'], rows),
    ];
  }).flat());
}

export function coordination(picture) {
  const place = byId('coordination');
  const { coordinator, takeovers = [], nodes = {} } = picture;
  const steady = Object.entries(nodes).map(([name, node]) => [name, { ...node, heard_ms: Math.round(node.heard_ms / 2000) }]);
  const findings = picture.health ?? [];
  const shown = JSON.stringify([{ ...coordinator, quorum_ms: 0 }, takeovers, steady, findings]);
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
  const matter = findings.map(({ level, says }) => make('li', {}, state(...LEVELS[level] ?? ['wait', level]), make('span', {}, says)));
  redraw(
    place,
    findings.length ? make('ul', { className: 'findings' }, matter) : null,
    coordinator ? facts : make('p', { className: 'none' }, 'No coordinator was heard yet.'),
    make('h3', {}, 'Takeovers'),
    changes.length ? table('Changes of the coordinator, the latest first', ['When', 'Coordinator', 'Term', 'After', 'Without'], changes) : make('p', { className: 'muted' }, 'None was seen.'),
    make('h3', {}, 'Nodes'),
    table('Nodes, how they are and how long ago they were heard', ['Node', 'Is', 'Part', 'Age'], list),
  );
}
