// The map: what stands still is drawn once, robots in each frame of the browser, filled in between two reports.

import { byId, make } from './dom.js';
import { sheet } from './sprites.js';

const canvas = byId('map');
// The ground covers all of it.
const pen = canvas.getContext('2d', { alpha: false });
const ground = document.createElement('canvas');
const MARGIN = 26;
/** Longest time in which a robot is moved from one report to the next, in milliseconds. */
const GLIDE = 700;
/** More robots than this show no task beside their names. */
const TASKS = 40;

let plan;
/** Places of the plan by name, and ways and walls of each level. */
let places = {};
let lanes = [];
let people = {};
let doors = {};
let level;
let scale = 1;
let offset = [0, 0];
let size = [0, 0];
let colours = {};
let chosen;
let stale = false;
let moving = new Map();
let wanted = false;
/** Robots as they look, for a crowd; painted anew when sizes or colours change. */
let sprites;
/**
 * To be looked at by tests: frames drawn, the time that drawing took, in all and at most, in milliseconds; what the node reported of
 * robots and was drawn, and what was overtaken by the next report before it could be, with a frame of the browser's in between or not.
 */
export const drawn = { frames: 0, took: 0, worst: 0, reports: 0, missed: 0, missed_with_a_frame_between: 0 };
let fresh = false;
let given = false;

export function start(onChoose) {
  new ResizeObserver(() => lay()).observe(byId('floor'));
  // Another screen, or another zoom, has other pixels.
  const watchPixels = () => {
    matchMedia(`(resolution: ${devicePixelRatio}dppx)`).addEventListener('change', () => { lay(); watchPixels(); }, { once: true });
  };
  watchPixels();
  byId('level').onchange = (event) => {
    level = event.target.value;
    lay();
  };
  canvas.onclick = (event) => {
    const near = nearest(event.offsetX, event.offsetY);
    if (near) onChoose(near);
  };
}

export function repaint() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ['floor', 'wall', 'lane', 'text', 'muted', 'accent', 'on-accent', 'bad', 'warn', 'good', 'person', 'card', 'line']) {
    colours[name] = style.getPropertyValue(`--${name}`).trim();
  }
  lay();
}

export function choose(robot) {
  chosen = robot;
  ask();
}

export function setStale(is) {
  if (is !== stale) {
    stale = is;
    ask();
  }
}

export function update(picture, patch) {
  if (!patch || patch.map) {
    plan = picture.map;
    const levels = plan?.levels ?? [];
    byId('level-choice').hidden = levels.length < 2;
    byId('level').replaceChildren(...levels.map(({ name }) => make('option', { value: name }, name)));
    byId('door-sign').hidden = !plan?.doors?.length;
    if (!levels.some(({ name }) => name === level)) level = levels[0]?.name;
    byId('level').value = level;
    places = Object.fromEntries((plan?.places ?? []).map((place) => [place.name, place]));
    const end = (name) => [places[name].x_m, places[name].y_m];
    lanes = (plan?.lanes ?? []).map(({ between: [a, b] }) => ({ line: [end(a), end(b)], level: places[a].level }));
    lay();
  }
  people = picture.people ?? {};
  doors = picture.doors ?? {};
  const robots = picture.robots ?? {};
  const changed = patch ? patch.robots ?? {} : robots;
  if (patch?.robots) {
    drawn.missed += fresh;
    drawn.missed_with_a_frame_between += fresh && given;
    [fresh, given] = [true, false];
    requestAnimationFrame(() => { given = true; });
  }
  const now = performance.now();
  for (const name of moving.keys()) if (!robots[name]) moving.delete(name);
  for (const name of Object.keys(changed)) {
    const robot = robots[name];
    if (!robot) continue;
    const known = moving.get(name);
    const to = [robot.x ?? 0, robot.y ?? 0, robot.yaw ?? 0];
    if (!known) {
      moving.set(name, { robot, from: to, to, at: now, time: 0, body: robot.body_ms });
      continue;
    }
    known.robot = robot;
    if (to.some((value, index) => value !== known.to[index])) {
      // A little longer than from the last report to this one, so that it does not stop before the next.
      const time = Math.min(Math.max(((robot.body_ms ?? 0) - (known.body ?? 0)) * 1.25, 150), GLIDE);
      Object.assign(known, { from: where(known, now), to, at: now, time, body: robot.body_ms });
    } else known.body = robot.body_ms;
  }
  const all = Object.values(robots);
  const count = (word) => all.filter((robot) => robot.availability === word).length;
  canvas.setAttribute('aria-label', `Map with ${all.length} robots: ${count('holding')} at work, ${count('free')} free, ${count('out_of_service')} out of service. The table of robots says the same in words.`);
  ask();
}

const where = (one, now) => {
  const share = one.time ? Math.min((now - one.at) / one.time, 1) : 1;
  const turn = ((one.to[2] - one.from[2] + Math.PI * 3) % (Math.PI * 2)) - Math.PI;
  return [0, 1].map((index) => one.from[index] + (one.to[index] - one.from[index]) * share).concat(one.from[2] + turn * share);
};

const at = (x, y) => [offset[0] + x * scale, offset[1] - y * scale];

function nearest(x, y) {
  let best;
  for (const [name, one] of moving) {
    const [px, py] = at(one.to[0], one.to[1]);
    const distance = Math.hypot(px - x, py - y);
    if (distance < 24 && (!best || distance < best[0])) best = [distance, name];
  }
  return best?.[1];
}

/** Lays the floor out anew: another size, plan, level or colours. */
function lay() {
  if (plan?.bounds_m?.west === undefined) return;
  const { west: x0, south: y0, east: x1, north: y1 } = plan.bounds_m;
  const width = byId('floor').clientWidth;
  if (!width) return;
  const [w, h] = [Math.max(x1 - x0, 1), Math.max(y1 - y0, 1)];
  const height = Math.min(Math.max((width - 2 * MARGIN) * (h / w) + 2 * MARGIN, 180), Math.max(innerHeight * 0.66, 320));
  scale = Math.min((width - 2 * MARGIN) / w, (height - 2 * MARGIN) / h);
  offset = [(width - w * scale) / 2 - x0 * scale, (height + h * scale) / 2 + y0 * scale];
  size = [width, height];
  const ratio = devicePixelRatio || 1;
  for (const one of [canvas, ground]) {
    one.width = Math.round(width * ratio);
    one.height = Math.round(height * ratio);
    one.getContext('2d').setTransform(ratio, 0, 0, ratio, 0, 0);
  }
  canvas.style.height = `${height}px`;
  drawGround(ground.getContext('2d'));
  sprites = undefined;
  ask();
}

function drawGround(pen) {
  pen.fillStyle = colours.floor;
  pen.fillRect(0, 0, ...size);
  pen.lineCap = 'round';
  pen.strokeStyle = colours.lane;
  pen.lineWidth = 3;
  for (const lane of lanes) if (lane.level === level) path(pen, lane.line);
  pen.strokeStyle = colours.wall;
  pen.lineWidth = 2;
  for (const wall of plan.walls ?? []) if (wall.level === level) path(pen, wall.line);
  const font = Math.min(Math.max(scale * 0.55, 9), 12);
  pen.font = `${font}px system-ui, sans-serif`;
  pen.textAlign = 'center';
  for (const [name, place] of Object.entries(places)) {
    if (place.level !== level) continue;
    const [x, y] = at(place.x_m, place.y_m);
    pen.fillStyle = colours.lane;
    dot(pen, x, y, 3);
    if (place.kind === 'corridor' || scale < 9) continue;
    pen.fillStyle = colours.muted;
    pen.fillText(name, x, y - 15);
  }
}

function path(pen, points) {
  pen.beginPath();
  for (const [index, [x, y]] of points.entries()) pen[index ? 'lineTo' : 'moveTo'](...at(x, y));
  pen.stroke();
}

function dot(pen, x, y, radius) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 7);
  pen.fill();
}

/** Asks for a frame, if none is asked for. */
function ask() {
  if (wanted) return;
  wanted = true;
  requestAnimationFrame(draw);
}

function draw(now) {
  wanted = false;
  const began = performance.now();
  if (!size[0]) return;
  pen.save();
  pen.setTransform(1, 0, 0, 1, 0, 0);
  pen.drawImage(ground, 0, 0);
  pen.restore();
  for (const door of plan?.doors ?? []) if (door.level === level) for (const posts of door.posts) drawDoor(posts, doors[door.name]);
  const here = [...moving].filter(([, { robot }]) => isHere(robot));
  let gliding = false;
  const poses = here.map(([name, one]) => {
    gliding ||= now - one.at < one.time;
    return [name, one.robot, where(one, now)];
  });
  for (const [name, robot, pose] of poses) if (robot.route?.length) drawRoute(robot, pose, name === chosen);
  const crowd = crowded();
  for (const person of Object.values(people)) if (person.x !== undefined && isHere(person)) drawPerson(person);
  const radius = radiusOf();
  if (crowd) sprites ??= sheet(LOOKS, radius * 1.7 + 2, devicePixelRatio || 1, (pen, look, x, y, yaw) => paintRobot(pen, look, x, y, yaw, radius));
  for (const [name, robot, pose] of poses) drawRobot(name, robot, pose, radius, crowd);
  const taken = [];
  for (const [name, robot, pose] of poses) label(name, robot, pose, radius, crowd, taken);
  const took = performance.now() - began;
  drawn.frames += 1;
  drawn.took += took;
  drawn.worst = Math.max(drawn.worst, took);
  drawn.reports += fresh;
  fresh = false;
  if (gliding && !stale) ask();
}

const isHere = (one) => (places[one.place]?.level ?? level) === level;

const radiusOf = () => Math.min(Math.max(scale * 0.45, 5), 11);

const crowded = () => moving.size > TASKS;

function drawDoor([from, to], state) {
  pen.strokeStyle = state === 'open' ? colours.good : colours.warn;
  pen.lineWidth = 4;
  // What stands open is a way through, what moves is neither.
  pen.setLineDash({ open: [3, 6], opening: [6, 3], closing: [6, 3] }[state] ?? []);
  path(pen, [from, to]);
  pen.setLineDash([]);
}

function drawRoute(robot, [x, y], strong) {
  pen.strokeStyle = colours.accent;
  pen.globalAlpha = strong ? 1 : 0.6;
  pen.lineWidth = strong ? 3 : 2;
  pen.setLineDash([6, 5]);
  path(pen, [[x, y], ...robot.route]);
  pen.setLineDash([]);
  const [ex, ey] = at(...robot.route.at(-1));
  pen.beginPath();
  pen.arc(ex, ey, 5, 0, 7);
  pen.stroke();
  pen.globalAlpha = 1;
}

function drawPerson(person) {
  const [x, y] = at(person.x, person.y);
  pen.fillStyle = colours.person;
  pen.globalAlpha = person.away ? 0.35 : 1;
  dot(pen, x + 13, y + 3, 3.6);
  pen.beginPath();
  pen.roundRect(x + 8.5, y + 7, 9, 8, [4, 4, 1, 1]);
  pen.fill();
  pen.globalAlpha = 1;
}

const isOut = (robot) => !robot.alive || robot.availability === 'out_of_service' || robot.able === false;

const LOOKS = ['busy', 'free', 'suspended', 'out'];

const lookOf = (robot) => {
  if (isOut(robot)) return 'out';
  return { holding: 'busy', suspended: 'suspended' }[robot.availability] ?? 'free';
};

function drawRobot(name, robot, [x, y, yaw], radius, crowd) {
  const [px, py] = at(x, y);
  if (name === chosen) {
    pen.strokeStyle = colours.text;
    pen.lineWidth = 2;
    pen.beginPath();
    pen.arc(px, py, radius + 5, 0, 7);
    pen.stroke();
  }
  if (crowd) sprites.stamp(pen, lookOf(robot), px, py, yaw);
  else paintRobot(pen, lookOf(robot), px, py, yaw, radius);
}

function paintRobot(pen, look, px, py, yaw, radius) {
  const colour = { out: colours.bad, suspended: colours.warn }[look] ?? colours.accent;
  // The nose tells the heading.
  pen.fillStyle = colour;
  pen.beginPath();
  pen.moveTo(px + Math.cos(yaw) * radius * 1.7, py - Math.sin(yaw) * radius * 1.7);
  pen.lineTo(px + Math.cos(yaw + 0.75) * radius, py - Math.sin(yaw + 0.75) * radius);
  pen.lineTo(px + Math.cos(yaw - 0.75) * radius, py - Math.sin(yaw - 0.75) * radius);
  pen.fill();
  pen.beginPath();
  pen.arc(px, py, radius, 0, 7);
  pen.fillStyle = look === 'busy' || look === 'suspended' ? colour : colours.floor;
  pen.fill();
  pen.strokeStyle = colour;
  pen.lineWidth = 2;
  if (look === 'out') pen.setLineDash([3, 3]);
  pen.stroke();
  pen.setLineDash([]);
}

/** Name, battery and task beneath a robot; left out where another label is already, so that all that is there can be read. */
function label(name, robot, [x, y], radius, crowd, taken) {
  const [px, py] = at(x, y);
  const text = crowd && name !== chosen && moving.size > 120 ? null : name;
  const task = crowd ? null : robot.task;
  if (!text) return;
  pen.font = '600 11px system-ui, sans-serif';
  const width = Math.max(pen.measureText(text).width, task ? pen.measureText(task).width : 0, 26);
  const box = [px - width / 2 - 3, py + radius + 3, width + 6, task ? 34 : 21];
  box[0] = Math.min(Math.max(box[0], 2), size[0] - box[2] - 2);
  // Above, if there is no room beneath.
  if (taken.some((other) => overlap(box, other)) || box[1] + box[3] > size[1]) box[1] = py - radius - 3 - box[3];
  if (taken.some((other) => overlap(box, other)) && name !== chosen) return;
  taken.push(box);
  pen.globalAlpha = 0.82;
  pen.fillStyle = colours.floor;
  pen.beginPath();
  pen.roundRect(...box, 4);
  pen.fill();
  pen.globalAlpha = 1;
  const middle = box[0] + box[2] / 2;
  pen.textAlign = 'center';
  pen.fillStyle = colours.text;
  pen.fillText(text, middle, box[1] + 11);
  const low = robot.battery <= (robot.useful_charge ?? 0) + 0.1;
  pen.fillStyle = colours.line;
  pen.fillRect(middle - 13, box[1] + 14.5, 26, 3.5);
  pen.fillStyle = low ? colours.bad : colours.good;
  pen.fillRect(middle - 13, box[1] + 14.5, 26 * Math.min(Math.max(robot.battery ?? 0, 0), 1), 3.5);
  if (task) {
    pen.font = '10.5px system-ui, sans-serif';
    pen.fillStyle = colours.muted;
    pen.fillText(task, middle, box[1] + 29);
  }
}

const overlap = (a, b) => a[0] < b[0] + b[2] && b[0] < a[0] + a[2] && a[1] < b[1] + b[3] && b[1] < a[1] + a[3];

