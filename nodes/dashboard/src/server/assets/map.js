// The map: static parts are drawn once for each zoom. Robots are drawn in each browser frame, interpolated
// between two reports. In a crowd, robots that cover each other are drawn as groups, until the map is zoomed in.

import { grouped, sideOf } from './crowd.js';
import { chargersOf } from './chargers.js';
import { brief, byId, make } from './dom.js';
import { assemblyPlaces, closedNames, laneName, partName, placesOf, zonePlaces } from './places.js';
import { followPointer } from './pointer.js';
import { LOOKS, lookOf, paintGroup, paintRobot } from './robot_signs.js';
import { sheet } from './sprites.js';

const canvas = byId('map');
// The static layer covers the whole canvas.
const pen = canvas.getContext('2d', { alpha: false });
const staticLayer = document.createElement('canvas');
const MARGIN = 26;
/** Maximum time of the interpolation between two reports, in milliseconds. */
const INTERPOLATION_MAX = 700;
/** Distances in pixels within which a click selects a robot, a place or a lane. */
const [ROBOT_NEAR, PLACE_NEAR, LANE_NEAR] = [24, 16, 8];
/** Radius of the area around the places of a zone, and of the sign of a speed limit, in pixels. */
const [ZONE_RADIUS, LIMIT_RADIUS] = [16, 10];
/** Above this number of robots no tasks are shown below the names, and robots may be grouped. */
const TASKS = 40;
/** Above this number of robots only the selected one has a name and a route. */
const NAMES = 120;
/** Greatest zoom, and the step of the buttons. */
const [ZOOM_MAX, ZOOM_STEP] = [16, 1.6];

let plan;
/** Places of the plan by name, and lanes and walls of each level. */
let places = {};
let lanes = [];
let people = {};
let doors = {};
/** Zones of the fleet file, places of all zones by their names in orders, and speed limits. */
let zones = {};
let within = new Map();
let limits = [];
/** Names of all closed places and lanes. */
let closed = new Set();
/** Assembly places of the alarms in force. */
let assembly = new Set();
/** Chargers with their robots, by place. */
let chargers = new Map();
let level;
let scale = 1;
let offset = [0, 0];
let size = [0, 0];
/** Zoom, 1 for the whole plan, and the point of the plan in the middle of the canvas, in metres. */
let zoom = 1;
let middle = [0, 0];
/** Groups of robots as drawn, with their positions and radii in pixels. */
let groups = [];
let colours = {};
/** The selected robot, and the name of the selected place, lane or zone. */
let chosen;
let chosenPart;
let stale = false;
let moving = new Map();
let frameRequested = false;
let layOutRequested = false;
/** Sprites of robots, for crowds; painted again when sizes or colours change. */
let sprites;
/**
 * Statistics for tests: drawn frames; total and maximum drawing time in milliseconds; reports that
 * were drawn; reports that were replaced by the next report before they were drawn, with and
 * without a browser frame in between; groups of robots in the latest frame.
 */
export const drawStats = { groups: 0, frames: 0, took: 0, worst: 0, reports: 0, missed: 0, missed_with_a_frame_between: 0 };
let fresh = false;
let framePassed = false;

export function start(onChoose, onChoosePart) {
  new ResizeObserver(() => layOut()).observe(byId('floor'));
  // Another screen or zoom changes the pixel ratio.
  const watchPixels = () => {
    matchMedia(`(resolution: ${devicePixelRatio}dppx)`).addEventListener('change', () => { layOut(); watchPixels(); }, { once: true });
  };
  watchPixels();
  byId('level').onchange = (event) => {
    level = event.target.value;
    layOut();
  };
  byId('zoom-in').onclick = () => zoomBy(ZOOM_STEP);
  byId('zoom-out').onclick = () => zoomBy(1 / ZOOM_STEP);
  byId('zoom-whole').onclick = () => zoomBy(0);
  followPointer(canvas, {
    onZoom: zoomBy,
    canDrag: () => zoom > 1,
    onDrag: (dx, dy) => {
      middle = [middle[0] - dx / scale, middle[1] + dy / scale];
      requestLayOut();
    },
    onClick: (x, y) => click(x, y, onChoose, onChoosePart),
  });
}

/** Zooms into the group of robots at a position, or selects the nearest robot, place or lane. */
function click(x, y, onChoose, onChoosePart) {
  if (zoom < ZOOM_MAX && groups.some((group) => Math.hypot(group.px - x, group.py - y) <= group.radius)) {
    zoomBy(ZOOM_STEP ** 2, [x, y]);
    return;
  }
  const robot = nearest(x, y);
  if (robot) onChoose(robot);
  else {
    const part = nearestPart(x, y);
    if (part) onChoosePart(part);
  }
}

export function repaint() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ['floor', 'wall', 'lane', 'text', 'muted', 'zone', 'accent', 'on-accent', 'bad', 'warn', 'good', 'person', 'card', 'line']) {
    colours[name] = style.getPropertyValue(`--${name}`).trim();
  }
  layOut();
}

export function choose(robot) {
  chosen = robot;
  const pose = moving.get(robot)?.to;
  if (pose && zoom > 1 && !isInside(pose, 0)) {
    middle = pose.slice(0, 2);
    requestLayOut();
  }
  requestFrame();
}

/** Highlights a place, a lane or the places of a zone, on its level. */
export function choosePart(part) {
  chosenPart = part;
  const [first] = namesOf(part);
  const at = (places[first] ?? lanes.find((lane) => lane.name === first))?.level;
  if (at !== undefined && at !== level) {
    level = at;
    byId('level').value = level;
    layOut();
  }
  requestFrame();
}

/** Returns the names of the places of a zone, or the name of a place or lane. */
const namesOf = (part) => within.get(part) ?? [part];

/** For tests: returns the position of a place on the canvas, in pixels. */
export const positionOf = (name) => at(places[name].x_m, places[name].y_m);

export function setStale(is) {
  if (is !== stale) {
    stale = is;
    requestFrame();
  }
}

export function update(model, patch) {
  zones = model.zones ?? {};
  within = zonePlaces(model);
  if (!patch || patch.map) {
    plan = model.map;
    const levels = plan?.levels ?? [];
    byId('level-choice').hidden = levels.length < 2;
    byId('level').replaceChildren(...levels.map(({ name }) => make('option', { value: name }, name)));
    byId('door-sign').hidden = !plan?.doors?.length;
    if (!levels.some(({ name }) => name === level)) level = levels[0]?.name;
    byId('level').value = level;
    places = Object.fromEntries((plan?.places ?? []).map((place) => [place.name, place]));
    const end = (name) => [places[name].x_m, places[name].y_m];
    lanes = (plan?.lanes ?? []).map(({ between: [a, b] }) => ({ name: laneName(a, b), ends: [a, b], line: [end(a), end(b)], level: places[a].level }));
  }
  if (!patch || patch.map || patch.zones) {
    byId('zone-sign').hidden = Object.keys(zones).length === 0;
    layOut();
  }
  people = model.people ?? {};
  doors = model.doors ?? {};
  limits = Object.values(model.speed_limits ?? {});
  byId('limit-sign').hidden = limits.length === 0;
  closed = closedNames(model);
  byId('closure-sign').hidden = closed.size === 0;
  assembly = assemblyPlaces(model);
  byId('assembly-sign').hidden = assembly.size === 0;
  chargers = chargersOf(model);
  byId('charger-sign').hidden = chargers.size === 0;
  const robots = model.robots ?? {};
  const changed = patch ? patch.robots ?? {} : robots;
  if (patch?.robots) {
    drawStats.missed += fresh;
    drawStats.missed_with_a_frame_between += fresh && framePassed;
    [fresh, framePassed] = [true, false];
    requestAnimationFrame(() => { framePassed = true; });
  }
  const now = performance.now();
  for (const name of moving.keys()) if (!robots[name]) moving.delete(name);
  for (const name of Object.keys(changed)) {
    const robot = robots[name];
    if (!robot) continue;
    const known = moving.get(name);
    const to = [robot.x ?? 0, robot.y ?? 0, robot.yaw ?? 0];
    if (!known) {
      moving.set(name, { robot, from: to, to, at: now, time: 0, reportedAt: robot.telemetry_ms });
      continue;
    }
    known.robot = robot;
    if (to.some((value, index) => value !== known.to[index])) {
      // Slightly longer than the time since the last report, so that the robot does not stop before
      // the next report.
      const time = Math.min(Math.max(((robot.telemetry_ms ?? 0) - (known.reportedAt ?? 0)) * 1.25, 150), INTERPOLATION_MAX);
      Object.assign(known, { from: interpolate(known, now), to, at: now, time, reportedAt: robot.telemetry_ms });
    } else known.reportedAt = robot.telemetry_ms;
  }
  const all = Object.values(robots);
  const count = (word) => all.filter((robot) => robot.availability === word).length;
  canvas.setAttribute('aria-label', `Map with ${all.length} robots: ${count('holding')} at work, ${count('free')} free, ${count('out_of_service')} out of service. The tables below have the same content as text.`);
  requestFrame();
}

const interpolate = ({ from, to, at, time }, now) => {
  const share = time ? Math.min((now - at) / time, 1) : 1;
  const turn = ((to[2] - from[2] + Math.PI * 3) % (Math.PI * 2)) - Math.PI;
  return [from[0] + (to[0] - from[0]) * share, from[1] + (to[1] - from[1]) * share, from[2] + turn * share];
};

const at = (x, y) => [offset[0] + x * scale, offset[1] - y * scale];

function nearest(x, y) {
  let best;
  for (const [name, motion] of moving) {
    const [px, py] = at(motion.to[0], motion.to[1]);
    const distance = Math.hypot(px - x, py - y);
    if (distance < ROBOT_NEAR && (!best || distance < best[0])) best = [distance, name];
  }
  return best?.[1];
}

/** Returns the name of the nearest place of the shown level, or else of the nearest lane. */
function nearestPart(x, y) {
  const closest = (found, limit) => found.filter(([distance]) => distance < limit).sort(([a], [b]) => a - b)[0]?.[1];
  const onLevel = Object.values(places).filter((place) => place.level === level);
  const byPlace = onLevel.map((place) => {
    const [px, py] = at(place.x_m, place.y_m);
    return [Math.hypot(px - x, py - y), place.name];
  });
  const byLane = lanes.filter((lane) => lane.level === level).map(({ name, line }) => {
    const [[ax, ay], [bx, by]] = line.map((point) => at(...point));
    const [dx, dy] = [bx - ax, by - ay];
    const share = Math.min(Math.max(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy || 1), 0), 1);
    return [Math.hypot(ax + share * dx - x, ay + share * dy - y), name];
  });
  return closest(byPlace, PLACE_NEAR) ?? closest(byLane, LANE_NEAR);
}

/** Zooms the map by a factor, 0 for the whole plan. The point of the plan at a position of the canvas stays there. */
function zoomBy(factor, [x, y] = [size[0] / 2, size[1] / 2]) {
  const before = zoom;
  zoom = Math.min(Math.max(zoom * factor, 1), ZOOM_MAX);
  const change = zoom / before;
  const [mx, my] = [(x - size[0] / 2) / scale, (size[1] / 2 - y) / scale];
  middle = [middle[0] + mx * (1 - 1 / change), middle[1] + my * (1 - 1 / change)];
  // Another change may follow before the layout.
  scale *= change;
  requestLayOut();
}

/** Requests a layout before the next frame, if there is no request yet. */
function requestLayOut() {
  if (layOutRequested) return;
  layOutRequested = true;
  requestAnimationFrame(layOut);
}

/** Computes the layout again, for another size, plan, level, zoom or colours. */
function layOut() {
  layOutRequested = false;
  if (plan?.bounds_m?.west === undefined) return;
  const { west: x0, south: y0, east: x1, north: y1 } = plan.bounds_m;
  const width = byId('floor').clientWidth;
  if (!width) return;
  const [w, h] = [Math.max(x1 - x0, 1), Math.max(y1 - y0, 1)];
  const height = Math.min(Math.max((width - 2 * MARGIN) * (h / w) + 2 * MARGIN, 180), Math.max(innerHeight * 0.66, 320));
  scale = Math.min((width - 2 * MARGIN) / w, (height - 2 * MARGIN) / h) * zoom;
  const within = (value, least, length) => (zoom === 1 ? least + length / 2 : Math.min(Math.max(value, least), least + length));
  middle = [within(middle[0], x0, w), within(middle[1], y0, h)];
  offset = [width / 2 - middle[0] * scale, height / 2 + middle[1] * scale];
  size = [width, height];
  // A finger moves a zoomed map instead of the page.
  canvas.style.touchAction = zoom === 1 ? '' : 'none';
  byId('zoom-in').disabled = zoom === ZOOM_MAX;
  byId('zoom-out').disabled = byId('zoom-whole').disabled = zoom === 1;
  const ratio = devicePixelRatio || 1;
  for (const layer of [canvas, staticLayer]) {
    layer.width = Math.round(width * ratio);
    layer.height = Math.round(height * ratio);
    layer.getContext('2d').setTransform(ratio, 0, 0, ratio, 0, 0);
  }
  canvas.style.height = `${height}px`;
  drawStaticLayer(staticLayer.getContext('2d'));
  sprites = undefined;
  requestFrame();
}

function drawStaticLayer(pen) {
  pen.fillStyle = colours.floor;
  pen.fillRect(0, 0, ...size);
  pen.lineCap = 'round';
  for (const [name, area] of Object.entries(zones)) drawZone(pen, name, new Set(area));
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

/** Draws the places of a zone and the lanes between them as an area, with its name. */
function drawZone(pen, name, area) {
  const shown = [...area].map((place) => places[place]).filter((place) => place?.level === level).map((place) => [place.x_m, place.y_m]);
  if (shown.length === 0) return;
  pen.strokeStyle = colours.zone;
  pen.fillStyle = colours.zone;
  pen.lineWidth = 2 * ZONE_RADIUS;
  for (const lane of lanes) if (lane.level === level && lane.ends.every((place) => area.has(place))) path(pen, lane.line);
  for (const point of shown) dot(pen, ...at(...point), ZONE_RADIUS);
  const [x, y] = shown.map((point) => at(...point)).reduce((top, point) => (point[1] < top[1] ? point : top));
  pen.font = 'italic 11px system-ui, sans-serif';
  pen.textAlign = 'center';
  pen.fillStyle = colours.muted;
  pen.fillText(`zone ${name}`, x, y - ZONE_RADIUS - 12);
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

/** Requests a frame, if there is no request yet. */
function requestFrame() {
  if (frameRequested) return;
  frameRequested = true;
  requestAnimationFrame(draw);
}

function draw(now) {
  frameRequested = false;
  const began = performance.now();
  if (!size[0]) return;
  pen.save();
  pen.setTransform(1, 0, 0, 1, 0, 0);
  pen.drawImage(staticLayer, 0, 0);
  pen.restore();
  drawChargers();
  drawLimits();
  drawClosures();
  drawAssemblyPlaces();
  for (const door of plan?.doors ?? []) if (door.level === level) for (const posts of door.posts) drawDoor(posts, doors[door.name]);
  let interpolating = false;
  const onLevel = [];
  for (const [name, motion] of moving) {
    if (!isOnLevel(motion.robot)) continue;
    interpolating ||= now - motion.at < motion.time;
    onLevel.push([name, motion.robot, interpolate(motion, now)]);
  }
  const [crowd, radius] = [crowded(), radiusOf()];
  const isNamed = (name) => name === chosen || moving.size <= NAMES;
  for (const [name, robot, pose] of onLevel) if (robot.route?.length && isNamed(name)) drawRoute(robot, pose, name === chosen);
  for (const person of Object.values(people)) if (person.x !== undefined && isOnLevel(person)) drawPerson(person);
  const shown = zoom === 1 ? onLevel : onLevel.filter(([, , pose]) => isInside(pose, radius * 2));
  const { single: poses, groups: crowds } = crowd ? grouped(shown, sideOf(radius) / scale, chosen) : { single: shown, groups: [] };
  if (crowd) sprites ??= sheet(LOOKS, radius * 1.7 + 2, devicePixelRatio || 1, (pen, look, x, y, yaw) => paintRobot(pen, colours, look, x, y, yaw, radius));
  groups = crowds.map((group) => drawGroup(group, radius));
  for (const [name, robot, pose] of poses) drawRobot(name, robot, pose, radius, crowd);
  const taken = [];
  for (const [name, robot, pose] of poses) if (isNamed(name)) label(name, robot, pose, radius, crowd, taken);
  const took = performance.now() - began;
  drawStats.groups = groups.length;
  drawStats.frames += 1;
  drawStats.took += took;
  drawStats.worst = Math.max(drawStats.worst, took);
  drawStats.reports += fresh;
  fresh = false;
  if (interpolating && !stale) requestFrame();
}

/** Checks whether a pose is on the canvas, or at most `beside` pixels beside it. */
function isInside([x, y], beside) {
  const [px, py] = at(x, y);
  return px > -beside && py > -beside && px < size[0] + beside && py < size[1] + beside;
}

const isOnLevel = (item) => (places[item.place]?.level ?? level) === level;

const radiusOf = () => Math.min(Math.max(scale * 0.45, 5), 11);

const crowded = () => moving.size > TASKS;

/** Draws a battery beside each charger, filled if a robot charges there, and the number of robots that wait. */
function drawChargers() {
  for (const [name, { charging, waiting }] of chargers) {
    const place = places[name];
    if (place?.level !== level) continue;
    const [x, y] = at(place.x_m, place.y_m);
    pen.fillStyle = charging.length ? colours.good : colours.floor;
    pen.strokeStyle = colours.good;
    pen.lineWidth = 2;
    pen.beginPath();
    pen.roundRect(x - 26, y - 7, 10, 14, 2);
    pen.fill();
    pen.stroke();
    pen.fillStyle = colours.good;
    pen.fillRect(x - 23, y - 10, 4, 2);
    if (waiting.length === 0) continue;
    pen.font = '600 11px system-ui, sans-serif';
    pen.textAlign = 'right';
    pen.fillStyle = colours.warn;
    pen.fillText(`${waiting.length} waiting`, x - 30, y + 4);
  }
}

/** Draws the lanes of each speed limit as broken lines, and signs with the speed beside its places or at the middle of its lane. */
function drawLimits() {
  const shown = lanes.filter((lane) => lane.level === level);
  for (const { part, speed_mps: speed } of limits) {
    const [name, limited] = [partName(part), new Set(placesOf(part))];
    pen.strokeStyle = colours.warn;
    pen.lineWidth = 3;
    pen.setLineDash([8, 6]);
    for (const lane of shown) if (lane.name === name || lane.ends.some((place) => limited.has(place))) path(pen, lane.line);
    pen.setLineDash([]);
    for (const { name: own, line: [[ax, ay], [bx, by]] } of shown) if (own === name) drawLimitSign(at((ax + bx) / 2, (ay + by) / 2), speed);
    for (const place of [...limited].map((place) => places[place])) if (place?.level === level) drawLimitSign(at(place.x_m, place.y_m), speed);
  }
}

function drawLimitSign([x, y], speed) {
  pen.strokeStyle = colours.warn;
  pen.fillStyle = colours.floor;
  pen.beginPath();
  pen.arc(x + 15, y + 12, LIMIT_RADIUS, 0, 7);
  pen.fill();
  pen.stroke();
  pen.font = '600 9px system-ui, sans-serif';
  pen.textAlign = 'center';
  pen.fillStyle = colours.text;
  pen.fillText(brief(speed), x + 15, y + 15);
}

/** Draws closed lanes as broken lines, closed places as signs of no entry, and what is selected. */
function drawClosures() {
  if (!chosenPart && closed.size === 0) return;
  const selected = new Set(namesOf(chosenPart));
  const shown = lanes.filter((lane) => lane.level === level);
  pen.strokeStyle = colours.bad;
  pen.lineWidth = 3;
  pen.setLineDash([2, 6]);
  for (const lane of shown) if (closed.has(lane.name) || lane.ends.some((place) => closed.has(place))) path(pen, lane.line);
  pen.setLineDash([]);
  pen.strokeStyle = colours.text;
  for (const lane of shown) if (selected.has(lane.name)) path(pen, lane.line);
  for (const place of Object.values(places)) {
    if (place.level !== level) continue;
    const [x, y] = at(place.x_m, place.y_m);
    if (closed.has(place.name)) {
      pen.fillStyle = colours.bad;
      dot(pen, x, y, 8);
      pen.fillStyle = colours.floor;
      pen.fillRect(x - 5, y - 1.5, 10, 3);
    }
    if (!selected.has(place.name)) continue;
    pen.lineWidth = 2;
    pen.beginPath();
    pen.arc(x, y, 11, 0, 7);
    pen.stroke();
  }
}

/** Draws a framed square behind the robots at each assembly place. */
function drawAssemblyPlaces() {
  for (const place of [...assembly].map((name) => places[name])) {
    if (place?.level !== level) continue;
    const [x, y] = at(place.x_m, place.y_m);
    pen.fillStyle = colours.good;
    pen.fillRect(x - 10, y - 10, 20, 20);
    pen.fillStyle = colours.floor;
    pen.fillRect(x - 5, y - 5, 10, 10);
  }
}

function drawDoor([from, to], state) {
  pen.strokeStyle = state === 'open' ? colours.good : colours.warn;
  pen.lineWidth = 4;
  // Line patterns for closed, moving and open doors.
  pen.setLineDash({ open: [3, 6], opening: [6, 3], closing: [6, 3] }[state] ?? []);
  path(pen, [from, to]);
  pen.setLineDash([]);
}

function drawRoute(robot, [x, y], strong) {
  pen.strokeStyle = colours.accent;
  pen.globalAlpha = strong ? 1 : 0.6;
  pen.lineWidth = strong ? 3 : 2;
  pen.setLineDash([6, 5]);
  const route = robot.route.filter((place) => places[place]).map((place) => [places[place].x_m, places[place].y_m]);
  const points = [[x, y], ...route];
  path(pen, points);
  pen.setLineDash([]);
  const [ex, ey] = at(...points.at(-1));
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
  else paintRobot(pen, colours, lookOf(robot), px, py, yaw, radius);
}

/** Draws a group of robots, and returns its position and radius in pixels. */
function drawGroup({ robots, x, y }, radius) {
  const [px, py] = at(x, y);
  return { px, py, radius: paintGroup(pen, colours, robots.map(([, robot]) => robot), px, py, radius) };
}

/** Draws name, battery and task below a robot; skipped if it would cover another label. */
function label(name, robot, [x, y], radius, crowd, taken) {
  const [px, py] = at(x, y);
  const task = crowd ? null : robot.task;
  pen.font = '600 11px system-ui, sans-serif';
  const width = Math.max(pen.measureText(name).width, task ? pen.measureText(task).width : 0, 26);
  const box = [px - width / 2 - 3, py + radius + 3, width + 6, task ? 34 : 21];
  box[0] = Math.min(Math.max(box[0], 2), size[0] - box[2] - 2);
  // Above the robot, if there is no space below.
  if (taken.some((other) => overlap(box, other)) || box[1] + box[3] > size[1]) box[1] = py - radius - 3 - box[3];
  if (taken.some((other) => overlap(box, other)) && name !== chosen) return;
  taken.push(box);
  pen.globalAlpha = 0.82;
  pen.fillStyle = colours.floor;
  pen.beginPath();
  pen.roundRect(...box, 4);
  pen.fill();
  pen.globalAlpha = 1;
  const centre = box[0] + box[2] / 2;
  pen.textAlign = 'center';
  pen.fillStyle = colours.text;
  pen.fillText(name, centre, box[1] + 11);
  const low = robot.battery <= (robot.useful_charge ?? 0) + 0.1;
  pen.fillStyle = colours.line;
  pen.fillRect(centre - 13, box[1] + 14.5, 26, 3.5);
  pen.fillStyle = low ? colours.bad : colours.good;
  pen.fillRect(centre - 13, box[1] + 14.5, 26 * Math.min(Math.max(robot.battery ?? 0, 0), 1), 3.5);
  if (task) {
    pen.font = '10.5px system-ui, sans-serif';
    pen.fillStyle = colours.muted;
    pen.fillText(task, centre, box[1] + 29);
  }
}

const overlap = (a, b) => a[0] < b[0] + b[2] && b[0] < a[0] + a[2] && a[1] < b[1] + b[3] && b[1] < a[1] + a[3];

