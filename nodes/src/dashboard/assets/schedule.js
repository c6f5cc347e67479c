// All missions over time: a row for each robot, a bar for each role that it had, and the same as a table. The chart is one stop for
// Tab; arrows lead from bar to bar, Enter to the mission.

import { byId, cells, clock, make, numberCell, percent, redraw, rows as tableRows, say, span, state } from './dom.js';
import { frame, shape } from './gantt.js';

/** Rows drawn at most; all stand in the table. */
const ROWS = 60;
/** Robots without a role have a row of their own in fleets up to this size. */
const IDLE = 24;
/** Room behind the rows for how much of the time a robot was at work; and ahead of now for what is planned, as a share of what was. */
const [RIGHT, AHEAD] = [46, 0.6];
const KINDS = { 'at work': ['running', 'work', '▸'], suspended: ['halted', 'warn', '‖'], 'carried out': ['done', 'good', '✓'], 'given up': ['failed', 'bad', '✕'], 'broken off': ['broken', 'wait', '✕'] };
const letter = 6.2;

/** The key of the bar that has, or had last, the focus. */
let current;
let choose = () => {};

export function start(onChange, onChoose) {
  choose = onChoose;
  byId('schedule-span').onchange = onChange;
  byId('schedule-chart').onkeydown = move;
}

export function update(picture, now) {
  const all = Object.entries(picture.missions ?? {}).flatMap(([id, mission]) => (mission.tenures ?? []).map((one, index) => ({ ...one, mission: id, key: `${id}#${index}` })));
  const asked = Number(byId('schedule-span').value);
  const first = Math.min(now - 1000, asked ? now - asked : Math.max(Math.min(...all.map((one) => one.from_ms)), now - 600000));
  const seen = all.filter((one) => (one.to_ms ?? now) >= first && one.from_ms <= now);
  const busy = new Set(seen.map((one) => one.by));
  const robots = Object.keys(picture.robots ?? {});
  const rows = [...new Set([...busy, ...(robots.length <= IDLE ? robots : [])])].sort().slice(0, ROWS);
  byId('schedule-none').hidden = seen.length > 0;
  byId('schedule-all').hidden = seen.length === 0;
  if (seen.length === 0) return;
  const left = busy.size - rows.filter((robot) => busy.has(robot)).length;
  say(byId('schedule-note'), left > 0 ? `${left} more robots had roles; they stand in the table.` : '');
  redraw(byId('schedule-chart'), chart(rows, seen, first, now));
  table(seen, now);
}

const took = (one, now) => (one.to_ms ?? now) - one.from_ms;

const planned = (one) => (one.planned_ms === undefined ? '' : `, planned ${span(one.planned_ms)}`);

function chart(rows, seen, first, now) {
  const ahead = Math.max(...seen.map((one) => (one.to_ms === undefined && one.planned_ms !== undefined ? one.from_ms + one.planned_ms : now)));
  const last = Math.max(now + (now - first) * 0.02, Math.min(ahead, now + (now - first) * AHEAD));
  const { svg, x, y, line, width, height } = frame(rows.length, first, last, { zero: now, right: RIGHT });
  const bars = [];
  rows.forEach((robot, row) => {
    svg.append(shape('text', { x: 0, y: y(row) + 17 }, robot.slice(0, 18)));
    const own = seen.filter((one) => one.by === robot).sort((a, b) => a.from_ms - b.from_ms);
    const worked = own.reduce((sum, one) => sum + Math.min(one.to_ms ?? now, now) - Math.max(one.from_ms, first), 0);
    svg.append(shape('text', { x: width, y: y(row) + 17, class: 'axis', 'text-anchor': 'end' }, percent(Math.min(Math.max(worked / (now - first), 0), 1))));
    for (const one of own) {
      const [kind, , sign] = KINDS[one.state] ?? KINDS['at work'];
      const [from, to] = [x(one.from_ms), Math.max(x(one.to_ms ?? now), x(one.from_ms) + 2)];
      const text = `${one.by}, ${one.role} of ${one.mission}: ${one.state}, ${span(took(one, now))}${planned(one)}`;
      const bar = shape('g', { role: 'button', tabindex: -1, 'aria-label': text, class: 'bar', 'data-key': one.key, 'data-row': row, 'data-at': from });
      bar.append(shape('rect', { x: from, y: y(row) + 4, width: to - from, height: height - 10, rx: 3, class: kind }));
      if (one.planned_ms !== undefined) {
        const end = x(one.from_ms + one.planned_ms);
        bar.append(shape('rect', { x: from, y: y(row) + height - 5, width: Math.max(end - from, 2), height: 3, class: 'planned' }));
      }
      const name = `${sign} ${one.mission} ${one.role}`;
      const fits = [name, `${sign} ${one.mission}`, sign].find((label) => label.length * letter < to - from - 8);
      if (fits) bar.append(shape('text', { x: from + 5, y: y(row) + 16, class: `on ${kind}` }, fits));
      bar.append(shape('title', {}, text));
      bar.onclick = () => choose(one.mission);
      bars.push(bar);
      svg.append(bar);
    }
  });
  svg.append(line(now));
  const stop = bars.find((bar) => bar.dataset.key === current) ?? bars.at(-1);
  stop?.setAttribute('tabindex', 0);
  return svg;
}

/** Arrows: along a row in time, between rows to the bar that is nearest in time. */
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
  const items = seen.toSorted((a, b) => b.from_ms - a.from_ms || a.by.localeCompare(b.by)).map((one) => ({ ...one, took: Math.round(took(one, now) / 1000) }));
  tableRows(byId('schedule').tBodies[0], items, (row, one) => {
    const [, kind] = KINDS[one.state] ?? KINDS['at work'];
    const button = make('button', { className: 'rowbutton', type: 'button' }, one.mission);
    button.onclick = () => choose(one.mission);
    const plan = one.planned_ms === undefined ? 'not known' : span(one.planned_ms);
    cells(row, one.by, make('td', {}, button, make('span', { className: 'sub' }, one.role)), make('td', {}, state(kind, one.state)), clock(one.from_ms), numberCell(span(took(one, now))), numberCell(plan));
  });
}
