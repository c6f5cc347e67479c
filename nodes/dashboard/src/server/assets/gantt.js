// Charts over time: the tasks of one mission, a row for each role.

import { make, span, readable } from './dom.js';

const SVG = 'http://www.w3.org/2000/svg';
const [LEFT, ROW, TOP, WIDTH] = [120, 26, 18, 720];

export function shape(tag, attributes, text) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) if (value !== undefined) element.setAttribute(name, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

/**
 * Creates an empty chart with `rows` rows from `first` to `last`. Returns `x` of an instant, `y` of
 * a row, and the drawing with its lines and its axis, which counts from `zero`. `right` is the
 * width of the column behind the rows.
 */
export function frame(rows, first, last, { zero = first, right = 12, ...attributes }) {
  const x = (ms) => LEFT + ((Math.min(Math.max(ms, first), last) - first) / (last - first)) * (WIDTH - LEFT - right);
  const y = (row) => TOP + row * ROW;
  const height = y(rows) + 6;
  const svg = shape('svg', { viewBox: `0 0 ${WIDTH} ${height}`, ...attributes });
  const step = roundStep((last - first) / 6);
  for (let tick = Math.ceil((first - zero) / step) * step; zero + tick <= last; tick += step) {
    const at = x(zero + tick);
    svg.append(shape('line', { x1: at, x2: at, y1: TOP - 4, y2: height }));
    const text = tick === 0 ? (zero === first ? '+0 s' : 'now') : `${tick > 0 ? '+' : '−'}${brief(Math.abs(tick))}`;
    if (at < WIDTH - 45) svg.append(shape('text', { x: at + 3, y: 10, class: 'axis' }, text));
  }
  for (let row = 1; row <= rows; row += 1) svg.append(shape('line', { x1: 0, x2: WIDTH, y1: y(row), y2: y(row) }));
  const line = (ms) => shape('line', { x1: x(ms), x2: x(ms), y1: TOP - 4, y2: height, class: 'now' });
  return { svg, x, y, line, width: WIDTH, height: ROW };
}

const brief = (ms) => (ms < 1000 ? `${ms} ms` : ms < 120000 ? `${ms / 1000} s` : `${Math.round(ms / 6000) / 10} min`);

/** Draws the chart of a mission, from its request until its end or until now. */
export function chart(id, mission, now) {
  const bars = mission.bars ?? [];
  const holder = (role) => mission.holders?.[role] ?? bars.findLast((bar) => bar.role === role)?.by;
  const roles = [...new Set([...Object.keys(mission.roles ?? {}), ...bars.map((bar) => bar.role)])];
  const first = mission.submitted_ms || bars[0]?.from_ms || now;
  const last = Math.max(mission.ended ? mission.ended_ms ?? Math.max(first, ...bars.map((bar) => bar.to_ms ?? bar.from_ms)) : now, first + 1000);
  const running = bars.filter((bar) => bar.state === 'running').map((bar) => `${readable(bar.task)} by ${bar.by}`).join(', ');
  const done = bars.filter((bar) => bar.state === 'done').length;
  const { svg, x, y, line, height } = frame(roles.length, first, last, {
    role: 'img',
    'aria-label': `Chart of ${id} over ${span(last - first)}: ${done} tasks done${running ? `; under way: ${running}` : ''}. The list of tasks below has the same content as text.`,
  });
  roles.forEach((role, row) => {
    const who = holder(role);
    svg.append(shape('text', { x: 0, y: y(row) + 17 }, who && who !== role ? `${role}: ${who}`.slice(0, 19) : role));
    for (const bar of bars.filter((item) => item.role === role)) {
      const [from, to] = [x(bar.from_ms), x(bar.to_ms ?? now)];
      const kind = bar.state === 'aborted' ? 'broken' : bar.state;
      const rect = shape('rect', { x: from, y: y(row) + 5, width: Math.max(to - from - 1, 2), height: height - 10, rx: 3, class: kind });
      rect.append(shape('title', {}, `${readable(bar.task)}: ${bar.state}, ${span((bar.to_ms ?? now) - bar.from_ms)}, by ${bar.by}`));
      svg.append(rect);
    }
  });
  if (!mission.ended) svg.append(line(now));
  return make('div', { className: 'gantt' }, svg);
}

/** Rounds up to 0.1, 0.2, 0.5, 1, 2, 5 … seconds, and from a minute on to minutes. */
function roundStep(ms) {
  if (ms > 20000) return [30, 60, 120, 300, 600, 1200, 1800, 3600, 7200].map((s) => s * 1000).find((step) => step >= ms) ?? 14400000;
  const ten = 10 ** Math.floor(Math.log10(Math.max(ms, 100)));
  return [1, 2, 5, 10].map((factor) => factor * ten).find((step) => step >= ms);
}
