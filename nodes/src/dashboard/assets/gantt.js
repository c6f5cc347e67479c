// A mission's tasks over time: a row for each role.

import { make, span, words } from './dom.js';

const SVG = 'http://www.w3.org/2000/svg';
const [LEFT, ROW, TOP, WIDTH] = [120, 26, 18, 720];

function shape(tag, attributes, text) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

/** The chart of a mission, from its request until it ended or until now. */
export function chart(id, mission, now) {
  const bars = mission.bars ?? [];
  const holder = (role) => mission.holders?.[role] ?? bars.findLast((bar) => bar.role === role)?.by;
  const roles = [...new Set([...Object.keys(mission.roles ?? {}), ...bars.map((bar) => bar.role)])];
  const first = mission.submitted_ms || bars[0]?.from_ms || now;
  const last = Math.max(mission.ended ? mission.ended_ms ?? Math.max(first, ...bars.map((bar) => bar.to_ms ?? bar.from_ms)) : now, first + 1000);
  const x = (ms) => LEFT + ((Math.min(Math.max(ms, first), last) - first) / (last - first)) * (WIDTH - LEFT - 12);
  const height = TOP + roles.length * ROW + 6;
  const running = bars.filter((bar) => bar.state === 'running').map((bar) => `${words(bar.task)} by ${bar.by}`).join(', ');
  const done = bars.filter((bar) => bar.state === 'done').length;
  const svg = shape('svg', {
    viewBox: `0 0 ${WIDTH} ${height}`,
    role: 'img',
    'aria-label': `Chart of ${id} over ${span(last - first)}: ${done} tasks done${running ? `; under way: ${running}` : ''}. The tasks below say the same in words.`,
  });
  const step = nice((last - first) / 6);
  for (let tick = 0; tick <= last - first; tick += step) {
    const at = x(first + tick);
    svg.append(shape('line', { x1: at, x2: at, y1: TOP - 4, y2: height }));
    if (at < WIDTH - 45) svg.append(shape('text', { x: at + 3, y: 10, class: 'axis' }, `+${tick >= 1000 || tick === 0 ? `${tick / 1000} s` : `${tick} ms`}`));
  }
  roles.forEach((role, index) => {
    const y = TOP + index * ROW;
    svg.append(shape('line', { x1: 0, x2: WIDTH, y1: y + ROW, y2: y + ROW }));
    const who = holder(role);
    svg.append(shape('text', { x: 0, y: y + 17 }, who && who !== role ? `${role}: ${who}`.slice(0, 19) : role));
    for (const bar of bars.filter((one) => one.role === role)) {
      const [from, to] = [x(bar.from_ms), x(bar.to_ms ?? now)];
      const kind = bar.state === 'broken off' ? 'broken' : bar.state;
      const one = shape('rect', { x: from, y: y + 5, width: Math.max(to - from - 1, 2), height: ROW - 10, rx: 3, class: kind });
      one.append(shape('title', {}, `${words(bar.task)}: ${bar.state}, ${span((bar.to_ms ?? now) - bar.from_ms)}, by ${bar.by}`));
      svg.append(one);
    }
  });
  if (!mission.ended) svg.append(shape('line', { x1: x(now), x2: x(now), y1: TOP - 4, y2: height, class: 'now' }));
  return make('div', { className: 'gantt' }, svg);
}

/** The next of 0.1, 0.2, 0.5, 1, 2, 5 … seconds. */
function nice(ms) {
  const ten = 10 ** Math.floor(Math.log10(Math.max(ms, 100)));
  return [1, 2, 5, 10].map((factor) => factor * ten).find((step) => step >= ms);
}
