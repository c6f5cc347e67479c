// Schedule of all missions: a row for each robot, a bar for each of its role assignments and of its
// promised roles with a planned start, and the same as a table. The chart is a single stop for Tab;
// arrows move between bars, Enter opens the mission.

import { byId, cells, clock, make, numberCell, percent, redraw, rows as tableRows, setText, span, state } from './dom.js';
import { frame, shape } from './gantt.js';

/** Maximum number of drawn rows; the table has all rows. */
const ROWS = 60;
/** Robots without a role get a row in fleets up to this size. */
const IDLE = 24;
/**
 * Width of the column with the robots' utilization; and the future part of the chart, as a share of
 * the past part.
 */
const [RIGHT, AHEAD] = [46, 0.6];
const KINDS = { active: ['running', 'work', '▸'], suspended: ['halted', 'warn', '‖'], completed: ['done', 'good', '✓'], released: ['failed', 'bad', '✕'], aborted: ['broken', 'wait', '✕'], promised: ['ahead', 'wait', '◇'] };
const letter = 6.2;

/** Key of the bar with the focus, or with the last focus. */
let current;
let choose = () => {};

export function start(onChange, onChoose) {
  choose = onChoose;
  byId('schedule-span').onchange = onChange;
  byId('schedule-chart').onkeydown = move;
}

export function update(model, now) {
  const all = Object.entries(model.missions ?? {}).flatMap(([id, mission]) => (mission.assignments ?? []).map((assignment, index) => ({ ...assignment, mission: id, key: `${id}#${index}` })));
  const asked = Number(byId('schedule-span').value);
  const first = Math.min(now - 1000, asked ? now - asked : Math.max(Math.min(...all.map((assignment) => assignment.from_ms)), now - 600000));
  const seen = [...all.filter((assignment) => (assignment.to_ms ?? now) >= first && assignment.from_ms <= now), ...promised(model, now)];
  const busy = new Set(seen.map((assignment) => assignment.by));
  const robots = Object.keys(model.robots ?? {});
  const rows = [...new Set([...busy, ...(robots.length <= IDLE ? robots : [])])].sort().slice(0, ROWS);
  byId('schedule-none').hidden = seen.length > 0;
  byId('schedule-all').hidden = seen.length === 0;
  if (seen.length === 0) return;
  const left = busy.size - rows.filter((robot) => busy.has(robot)).length;
  setText(byId('schedule-note'), left > 0 ? `${left} more robots had roles; see the table.` : '');
  redraw(byId('schedule-chart'), chart(rows, seen, first, now));
  table(seen, now);
}

/** Returns the promised roles. Their starts are late if the roles before them take longer than planned. */
function promised(model, now) {
  return Object.entries(model.robots ?? {}).flatMap(([by, { next = [] }]) => {
    const late = Math.max(now - (next[0]?.start_ms ?? now), 0);
    return next.map(({ mission, role, start_ms: start, planned_ms: planned }) => {
      const from_ms = start + late;
      return { mission, role, by, from_ms, to_ms: from_ms + (planned ?? 0), planned_ms: planned, state: 'promised', key: `${mission}#later-${role}` };
    });
  });
}

const took = (assignment, now) => (assignment.to_ms ?? now) - assignment.from_ms;

const planned = (assignment) => (assignment.planned_ms === undefined ? '' : `, planned ${span(assignment.planned_ms)}`);

function chart(rows, seen, first, now) {
  const ahead = Math.max(...seen.map((assignment) => assignment.to_ms ?? assignment.from_ms + (assignment.planned_ms ?? 0)), now);
  const last = Math.max(now + (now - first) * 0.02, Math.min(ahead, now + (now - first) * AHEAD));
  const { svg, x, y, line, width, height } = frame(rows.length, first, last, { zero: now, right: RIGHT });
  const bars = [];
  rows.forEach((robot, row) => {
    svg.append(shape('text', { x: 0, y: y(row) + 17 }, robot.slice(0, 18)));
    const own = seen.filter((assignment) => assignment.by === robot).sort((a, b) => a.from_ms - b.from_ms);
    const worked = own.reduce((sum, assignment) => sum + Math.max(Math.min(assignment.to_ms ?? now, now) - Math.max(assignment.from_ms, first), 0), 0);
    svg.append(shape('text', { x: width, y: y(row) + 17, class: 'axis', 'text-anchor': 'end' }, percent(Math.min(Math.max(worked / (now - first), 0), 1))));
    for (const assignment of own) {
      const [kind, , sign] = KINDS[assignment.state] ?? KINDS.active;
      const [from, to] = [x(assignment.from_ms), Math.max(x(assignment.to_ms ?? now), x(assignment.from_ms) + 2)];
      const when = kind === 'ahead' ? `in ${span(Math.max(assignment.from_ms - now, 1000))}` : span(took(assignment, now));
      const text = `${assignment.by}, ${assignment.role} of ${assignment.mission}: ${assignment.state}, ${when}${planned(assignment)}`;
      const bar = shape('g', { role: 'button', tabindex: -1, 'aria-label': text, class: 'bar', 'data-key': assignment.key, 'data-row': row, 'data-at': from });
      bar.append(shape('rect', { x: from, y: y(row) + 4, width: to - from, height: height - 10, rx: 3, class: kind }));
      if (assignment.planned_ms !== undefined && kind !== 'ahead') {
        const end = x(assignment.from_ms + assignment.planned_ms);
        bar.append(shape('rect', { x: from, y: y(row) + height - 5, width: Math.max(end - from, 2), height: 3, class: 'planned' }));
      }
      const name = `${sign} ${assignment.mission} ${assignment.role}`;
      const fits = [name, `${sign} ${assignment.mission}`, sign].find((label) => label.length * letter < to - from - 8);
      if (fits) bar.append(shape('text', { x: from + 5, y: y(row) + 16, class: `on ${kind}` }, fits));
      bar.append(shape('title', {}, text));
      bar.onclick = () => choose(assignment.mission);
      bars.push(bar);
      svg.append(bar);
    }
  });
  svg.append(line(now));
  const stop = bars.find((bar) => bar.dataset.key === current) ?? bars.at(-1);
  stop?.setAttribute('tabindex', 0);
  return svg;
}

/** Moves the focus: along a row in time, between rows to the nearest bar in time. */
function move(event) {
  const at = event.target.closest('.bar');
  if (!at) return;
  if (event.key === 'Enter' || event.key === ' ') {
    event.preventDefault();
    at.onclick();
    return;
  }
  const bars = [...byId('schedule-chart').querySelectorAll('.bar')];
  const [row, x] = [Number(at.dataset.row), Number(at.dataset.at)];
  const own = bars.filter((bar) => Number(bar.dataset.row) === row);
  const nearest = (rows) => {
    const there = rows.find((other) => bars.some((bar) => Number(bar.dataset.row) === other));
    return bars.filter((bar) => Number(bar.dataset.row) === there).sort((a, b) => Math.abs(a.dataset.at - x) - Math.abs(b.dataset.at - x))[0];
  };
  const found = [...new Set(bars.map((bar) => Number(bar.dataset.row)))].sort((a, b) => a - b);
  const next = {
    ArrowRight: () => own[own.indexOf(at) + 1],
    ArrowLeft: () => own[own.indexOf(at) - 1],
    ArrowDown: () => nearest(found.filter((other) => other > row)),
    ArrowUp: () => nearest(found.filter((other) => other < row).reverse()),
    Home: () => bars[0],
    End: () => bars.at(-1),
  }[event.key];
  if (!next) return;
  event.preventDefault();
  const to = next();
  if (!to) return;
  for (const bar of bars) bar.setAttribute('tabindex', bar === to ? 0 : -1);
  current = to.dataset.key;
  to.focus();
}

function table(seen, now) {
  const items = seen.toSorted((a, b) => b.from_ms - a.from_ms || a.by.localeCompare(b.by)).map((assignment) => ({ ...assignment, took: assignment.state === 'promised' ? '–' : span(took(assignment, now)) }));
  tableRows(byId('schedule').tBodies[0], items, (row, assignment) => {
    const [, kind] = KINDS[assignment.state] ?? KINDS.active;
    const button = make('button', { className: 'rowbutton', type: 'button' }, assignment.mission);
    button.onclick = () => choose(assignment.mission);
    const plan = assignment.planned_ms === undefined ? 'unknown' : span(assignment.planned_ms);
    cells(row, assignment.by, make('td', {}, button, make('span', { className: 'sub' }, assignment.role)), make('td', {}, state(kind, assignment.state)), clock(assignment.from_ms), numberCell(assignment.took), numberCell(plan));
  });
}
