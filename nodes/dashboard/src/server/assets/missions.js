// Missions: the list, and the selected mission with its tree, roles, steps and chart.

import { byId, cells, clock, make, meter, note, numberCell, redraw, rows, setText, since, span, state, readable } from './dom.js';
import { chart } from './gantt.js';

const KINDS = { completed: 'good', running: 'work', pending: 'wait', failed: 'bad', canceled: 'warn', needs_intervention: 'bad' };
const MARKS = { done: ['✓', 'done'], running: ['▸', 'under way'], failed: ['✕', 'failed'], skipped: ['–', 'skipped'], open: ['·', 'to do'] };

export const badge = (mission) => state(KINDS[mission.state] ?? 'wait', readable(mission.state));

const latestFirst = (model) => Object.entries(model.missions ?? {}).sort(([, a], [, b]) => b.number - a.number);

/** Calls `onChange` when the filter of the list has changed. */
export function start(onChange) {
  byId('missions-filter').oninput = onChange;
  byId('missions-filter').onsubmit = (event) => event.preventDefault();
}

/** Checks whether a mission fits the filter of the list: its state, and a text in its id, its parameters or its robots. */
function isListed([id, { state, ended, parameters, holders }]) {
  const [wanted, text] = [byId('missions-state').value, byId('missions-text').value.trim().toLowerCase()];
  const texts = [id, ...Object.values(parameters ?? {}), ...Object.values(holders ?? {})];
  return (!wanted || wanted === state || (wanted === 'active' && !ended)) && texts.some((value) => value.toLowerCase().includes(text));
}

/**
 * Shows the list and the selected mission; the default is the latest running mission. `actions` are those of the buttons:
 * of the mission, of its roles, and of the list.
 */
export function update(model, now, { mission: selected, select, actions }) {
  const all = latestFirst(model);
  const listed = all.filter(isListed).slice(0, 100);
  setText(byId('missions-none'), all.length ? 'No mission fits the filter.' : 'No mission is known yet.');
  byId('missions-none').hidden = listed.length > 0;
  byId('missions').hidden = listed.length === 0;
  const active = listed.filter(([, { ended }]) => !ended).map(([id]) => id);
  const cancelListed = byId('cancel-listed');
  cancelListed.disabled = active.length === 0;
  cancelListed.onclick = () => actions.cancelAll(cancelListed, active);
  const current = all.find(([id]) => id === selected) ?? all.find(([, mission]) => mission.state === 'running') ?? all.find(([, mission]) => !mission.ended) ?? all[0];
  const items = listed.map(([key, mission]) => ({
    key,
    state: mission.state,
    done: mission.done,
    steps: mission.steps,
    holders: mission.holders,
    ended: mission.ended && mission.ended_ms ? mission.ended_ms - mission.submitted_ms : undefined,
    over: mission.ended,
    submitted: mission.submitted_ms,
    selected: key === current?.[0],
  }));
  rows(byId('missions').tBodies[0], items, (row, item) => {
    const button = make('button', { className: 'rowbutton', type: 'button' }, item.key);
    button.setAttribute('aria-pressed', String(item.selected));
    button.onclick = () => select(item.key);
    const share = item.steps ? item.done / item.steps : 0;
    const time = item.over ? span(item.ended) : since(item.submitted);
    cells(row, button, make('td', {}, badge(item)), meter(share, `${item.done ?? 0}/${item.steps ?? 0}`, item.state === 'completed' ? 'good' : ''), holders(item.holders), numberCell(time));
    if (item.selected) row.setAttribute('aria-current', 'true');
    else row.removeAttribute('aria-current');
  });
  history(all.filter(([, mission]) => mission.ended));
  const article = byId('mission');
  article.hidden = !current;
  if (current) detail(article, ...current, now, actions);
}

const holders = (holders) => Object.entries(holders ?? {}).map(([role, robot]) => `${robot} (${role})`).join(', ') || '–';

function detail(article, id, mission, now, actions) {
  const shown = JSON.stringify([id, mission]);
  const figure = article.querySelector('.gantt');
  if (article.shown === shown && figure) {
    if (!mission.ended) figure.replaceWith(chart(id, mission, now));
    return;
  }
  article.shown = shown;
  const head = make('header', {}, make('h3', {}, id), badge(mission));
  const act = (key, text, className, action) => {
    const button = make('button', { type: 'button', className, 'data-key': key }, text);
    button.onclick = () => action(button);
    return button;
  };
  if (!mission.ended) {
    head.append(
      act('priority', 'Change priority', '', (button) => actions.changePriority(button, id)),
      act('cancel', 'Cancel mission', 'danger', (button) => actions.cancel(button, id)),
    );
  }
  if (mission.state === 'needs_intervention') head.append(act('resolve', 'Resolve', 'primary', () => actions.resolve(id, mission)));
  /** Returns the buttons of a role of robots that has not ended. */
  const orders = (name, { kind, phase, holder }) => {
    if (mission.ended || kind === 'unmanaged' || phase === 'ended') return '–';
    const order = (action, text) => act(`${action}-${name}`, text, '', (button) => actions[action](button, id, name));
    return make('div', { className: 'orders' },
      holder ? order('reassign', 'Reassign') : null,
      ['open', 'promised'].includes(phase) ? order('pin', 'Pin') : null,
      mission.orders?.[name] ? order('unpin', 'End order') : null);
  };
  const notes = make('dl', { className: 'notes' });
  const add = (name, value) => value && notes.append(note(name, value));
  for (const [name, value] of Object.entries(mission.parameters ?? {})) add(name, value);
  for (const [name, value] of Object.entries(mission.result ?? {})) add(`result: ${readable(name)}`, String(value));
  for (const [role, order] of Object.entries(mission.orders ?? {})) add(role, order);
  if (mission.priority) add('priority', String(mission.priority));
  add('submitted', clock(mission.submitted_ms));
  if (mission.award_after_ms !== undefined) add('award after', `${mission.award_after_ms.toFixed(1)} ms`);
  if (mission.deadline_ms) add('deadline', clock(mission.deadline_ms));
  if (mission.branch === 'recovery') add('branch', 'recovery');
  add('class of the cause', mission.cause_class);
  const problem = mission.cause ?? mission.pending_reason;
  const cause = problem && make('p', { className: `cause ${mission.state === 'failed' || mission.state === 'needs_intervention' ? 'bad' : ''}` }, problem);
  const bars = mission.bars ?? [];
  redraw(
    article,
    head,
    notes,
    cause,
    mission.items?.length ? [make('h3', {}, 'In robots’ hands'), make('ul', { className: 'items' }, mission.items.map((item) => make('li', {}, lastKnownPlace(item))))] : null,
    make('h3', {}, 'Chart'),
    chart(id, mission, now),
    bars.length === 0 ? make('p', { className: 'muted' }, 'No task was started while this page’s node was connected.') : null,
    make('h3', {}, 'Tasks'),
    mission.tasks ? make('ul', { className: 'tree' }, tree(mission, 0)) : make('p', { className: 'muted' }, 'Its tasks are not known here yet.'),
    make('h3', {}, 'Roles'),
    Object.keys(mission.roles ?? {}).length ? roles(mission, orders) : make('p', { className: 'muted' }, 'Its roles are not known here yet.'),
  );
}

/** Describes the last known place of an item. */
export const lastKnownPlace = ({ item, role, robot, place, certain }) =>
  `${readable(item)}: ${certain ? `${robot} has it` : `${robot} may have it`}, as ${role}${place ? `; last at ${place}` : ''}`;

function tree(mission, index) {
  const { id, body } = mission.tasks[index];
  if (body.Abstract) {
    const { order, children } = body.Abstract;
    const how = order === 'unordered' ? ' in any order' : '';
    const mark = combined(children.map((child) => markOf(mission, child)));
    return make('li', {}, sign(mission, mark), readable(id), make('span', { className: 'how' }, how), make('ul', {}, children.map((child) => tree(mission, child))));
  }
  const { type, roles = [], parameters = {} } = body.Elementary;
  const to = type === 'navigation' && parameters.to ? ` → ${parameters.to}` : '';
  const who = roles.map((role) => make('span', { className: 'role' }, mission.holders?.[role] ? `${role}: ${mission.holders[role]}` : role));
  const results = Object.entries(mission.task_results?.[id] ?? {}).map(([name, value]) => `${readable(name)}: ${value}`);
  const found = results.length ? make('span', { className: 'how results' }, ` ${results.join(', ')}`) : null;
  return make('li', {}, sign(mission, markOf(mission, index)), readable(id), make('span', { className: 'how' }, to), who, found);
}

function sign(mission, found) {
  // An ended mission has no running tasks.
  const mark = mission.ended && found === 'running' ? 'open' : found;
  const [glyph, text] = MARKS[mark];
  return make('span', { className: `mark ${mark}`, role: 'img', 'aria-label': text, title: text }, glyph);
}

function markOf(mission, index) {
  const { id, body } = mission.tasks[index];
  if (body.Abstract) return combined(body.Abstract.children.map((child) => markOf(mission, child)));
  const bar = (mission.bars ?? []).findLast((item) => item.task === id);
  if (bar?.state === 'skipped') return 'skipped';
  const steps = Object.values(mission.roles ?? {}).flatMap((role) => (role.steps ?? []).filter((step) => step.label === id));
  if (mission.state === 'completed' || (steps.length > 0 && steps.every((step) => step.done)) || bar?.state === 'done') return 'done';
  if (bar?.state === 'running') return 'running';
  return bar?.state === 'failed' ? 'failed' : 'open';
}

/** Returns the values of the parameters of the tasks that have not ended; those of the mission if its tasks are not known. */
export function valuesAhead(mission) {
  if (!mission.tasks) return Object.values(mission.parameters ?? {});
  const ahead = mission.tasks.filter(({ body }, index) => body.Elementary && !['done', 'skipped'].includes(markOf(mission, index)));
  return ahead.flatMap(({ body }) => Object.values(body.Elementary.parameters ?? {}));
}

function combined(marks) {
  if (marks.includes('failed')) return 'failed';
  if (marks.every((mark) => mark === 'skipped')) return 'skipped';
  if (marks.every((mark) => mark === 'done' || mark === 'skipped')) return 'done';
  return marks.some((mark) => mark !== 'open') ? 'running' : 'open';
}

function roles(mission, orders) {
  const table = make('table', {}, make('caption', { className: 'unseen' }, 'Roles of the mission, their holders, their steps and orders about them'));
  const head = ['Role', 'Holder', 'Steps', 'Orders'].map((text) => make('th', { scope: 'col' }, text));
  const body = make('tbody');
  for (const [name, role] of Object.entries(mission.roles ?? {})) {
    const steps = role.steps ?? [];
    const done = steps.filter((step) => step.done).length;
    const list = make('ol', {}, steps.map((step) => make('li', {}, `${step.done ? '✓ ' : ''}${readable(step.label)}`)));
    const details = make('details', {}, make('summary', {}, `${done} of ${steps.length}`), list);
    details.dataset.key = `steps-${name}`;
    details.firstChild.dataset.key = `summary-${name}`;
    const row = make('tr');
    const by = role.kind === 'unmanaged' ? 'a person' : role.holder ?? 'not assigned';
    const notes = [readable(role.phase), role.epoch && `epoch ${role.epoch}`, role.promise && planned(role.promise)];
    cells(row, name, make('td', {}, by, make('span', { className: 'sub' }, notes.filter(Boolean).join(', '))), details, orders(name, role));
    body.append(row);
  }
  table.append(make('thead', {}, make('tr', {}, head)), body);
  return table;
}

// The planned start of a promised role, and what its robot does before.
function planned({ planned_at_ms: at, after }) {
  const before = after.map(({ mission, role }) => `${role} of ${mission}`).join(', ');
  return `from about ${clock(at)}${before && `, after ${before}`}`;
}

function history(ended) {
  byId('history-none').hidden = ended.length > 0;
  byId('history').hidden = ended.length === 0;
  const items = ended.map(([key, { state, cause, award_after_ms, ended_ms, submitted_ms, holders }]) => ({ key, state, cause, award_after_ms, ended_ms, submitted_ms, holders }));
  rows(byId('history').tBodies[0], items, (row, item) => {
    const outcome = make('td', { className: 'wrap' }, badge(item), item.cause ? make('span', { className: 'sub' }, item.cause) : null);
    const award = item.award_after_ms === undefined ? '–' : `${item.award_after_ms.toFixed(1)} ms`;
    const took = item.ended_ms ? span(item.ended_ms - item.submitted_ms) : '–';
    cells(row, item.key, outcome, numberCell(award), numberCell(took), holders(item.holders), item.ended_ms ? clock(item.ended_ms) : 'unknown');
  });
}

