// Ensembles, and coordination: coordinator, voters, nodes, takeovers.

import { byId, cells, clock, make, numberCell, redraw, since, span, state, readable } from './dom.js';

const LEVELS = { ok: ['good', 'ok'], warning: ['warn', 'warning'], error: ['bad', 'error'] };

/** Columns of numbers. */
const NUMBERS = ['Age', 'Gap'];

const table = (caption, heads, rows) =>
  make('table', {}, make('caption', { className: 'unseen' }, caption), make('thead', {}, make('tr', {}, heads.map((head) => make('th', { scope: 'col', className: NUMBERS.includes(head) ? 'number' : '' }, head)))), make('tbody', {}, rows));

function row(head, ...others) {
  const element = make('tr');
  cells(element, head, ...others);
  return element;
}

/**
 * Shows the members, and the other nodes with their reasons, with the ages of their last contacts.
 */
export function ensembles(model) {
  const place = byId('ensembles');
  const lastContact = (name) => model.nodes?.[name]?.last_contact_ms;
  const coarse = (name) => Math.round((lastContact(name) ?? 0) / 2000);
  const shown = JSON.stringify([model.ensembles, Object.keys(model.nodes ?? {}).map(coarse)]);
  if (place.shown === shown) return;
  place.shown = shown;
  const all = Object.entries(model.ensembles ?? {});
  if (all.length === 0) return redraw(place, make('p', { className: 'none' }, 'No ensemble is known yet.'));
  const age = (name) => numberCell(lastContact(name) ? since(lastContact(name)) : '–');
  redraw(place, all.map(([name, { members = [], non_members = {}, membership = [], skills = [], stale_after_ms }]) => {
    const facts = make('dl', { className: 'notes' });
    const fact = (word, ...value) => facts.append(make('div', {}, make('dt', {}, word), make('dd', {}, ...value.flat())));
    if (membership.length) fact('condition', membership.map((condition, index) => [index ? ' and ' : '', make('code', {}, condition)]).flat());
    if (skills.length) fact('skills', skills.map(readable).join(', '));
    if (stale_after_ms) fact('without contact for', `${span(stale_after_ms)}: not a member`);
    const rows = [
      ...members.map((node) => row(node, make('td', {}, state('good', 'member')), age(node))),
      ...Object.entries(non_members).map(([node, reason]) => row(node, make('td', { className: 'wrap' }, state('wait', 'not a member'), make('span', { className: 'sub' }, reason)), age(node))),
    ];
    return [
      make('h3', {}, `${name}: ${members.length} ${members.length === 1 ? 'member' : 'members'} of ${rows.length} nodes`),
      facts,
      table(`Nodes: members of ${name}, and the reasons of the others`, ['Node', 'Status', 'Age'], rows),
    ];
  }).flat());
}

export function coordination(model) {
  const place = byId('coordination');
  const { coordinator, takeovers = [], nodes = {} } = model;
  const coarse = Object.entries(nodes).map(([name, node]) => [name, { ...node, last_contact_ms: Math.round(node.last_contact_ms / 2000) }]);
  const findings = model.health ?? [];
  const shown = JSON.stringify([{ ...coordinator, quorum_ms: 0 }, takeovers, coarse, findings]);
  if (place.shown === shown) return;
  place.shown = shown;
  const facts = make('dl', { className: 'notes' });
  const fact = (name, ...value) => facts.append(make('div', {}, make('dt', {}, name), make('dd', {}, ...value)));
  if (coordinator) {
    fact('coordinator', coordinator.node);
    fact('term', String(coordinator.term));
    fact('since', clock(coordinator.since_ms), ' (', since(coordinator.since_ms), ')');
    fact('voters', (coordinator.voters ?? []).join(', ') || '–');
    if (coordinator.learners?.length) fact('learners', coordinator.learners.join(', '));
    if (coordinator.voters_lost?.length) fact('voters lost', coordinator.voters_lost.join(', '));
  }
  const changes = takeovers.toReversed().map((change) => row(clock(change.at_ms), change.node, String(change.term), change.from ?? '–', numberCell(change.from ? span(change.gap_ms) : '–')));
  const list = Object.entries(nodes).map(([name, node]) => {
    const roles = [coordinator?.node === name && 'coordinator', coordinator?.voters?.includes(name) && 'voter', node.stationary && 'stationary', node.mains_powered && 'on mains', node.leaving && 'leaving'];
    return row(name, make('td', {}, state(node.alive ? 'good' : 'bad', node.alive ? 'alive' : node.status)), roles.filter(Boolean).join(', ') || '–', numberCell(since(node.last_contact_ms)));
  });
  const findingItems = findings.map(({ level, text }) => make('li', {}, state(...LEVELS[level] ?? ['wait', level]), make('span', {}, text)));
  redraw(
    place,
    findings.length ? make('ul', { className: 'findings' }, findingItems) : null,
    coordinator ? facts : make('p', { className: 'none' }, 'No contact with a coordinator yet.'),
    make('h3', {}, 'Takeovers'),
    changes.length ? table('Changes of the coordinator, the latest first', ['Time', 'Coordinator', 'Term', 'After', 'Gap'], changes) : make('p', { className: 'muted' }, 'No takeover was observed.'),
    make('h3', {}, 'Nodes'),
    table('Nodes, their status and the age of their last contact', ['Node', 'Status', 'Roles', 'Age'], list),
  );
}
