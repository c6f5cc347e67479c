// Closures and speed limits: the selected place, lane or zone with its orders, and the lists of all.

import { byId, cells, make, moment, rows, setText } from './dom.js';
import { valuesAhead } from './missions.js';
import { ask, confirmOrder, field, orderText } from './order_form.js';
import { closedNames, laneName, partName, placesOf, reachable } from './places.js';

/** Effects of closures. */
const OF_PLACE = 'No robot enters it, or drives a lane to it. A robot inside may leave.';
const OF_ZONE = 'No robot enters its places, or drives a lane to them. A robot inside may leave.';
const OF_LANE = 'No robot drives along it, in either direction.';
const OF_ALL = 'Robots under way take other ways, or wait and keep their roles. Deadlines of missions go on. This is not a safety function.';

const OF_LIMIT = 'Of several limits the lowest holds. A robot that drives there stops, and goes on at the allowed speed. This is not a safety function.';

/** Speed that the form of a limit proposes, and the lowest that is allowed, in metres per second. */
const [SPEED, SPEED_MIN] = [0.3, 0.05];

let model = {};
/** Places and lanes of the map, and zones of the fleet file, by name, each as in an order. */
let parts = new Map();
let selected;
let choose = () => {};

export function start(onChoose) {
  choose = onChoose;
  byId('part').onchange = ({ target }) => choose(target.value || undefined);
  for (const button of byId('part-orders').querySelectorAll('button')) button.onclick = () => give(button);
}

/** Lists the places and lanes of the map, and the zones. */
export function setParts({ map: { places = [], lanes = [] } = {}, zones = {} }) {
  const byName = (all) => all.sort(([a], [b]) => a.localeCompare(b));
  const named = {
    Places: byName(places.map(({ name }) => [name, { place: name }])),
    Lanes: byName(lanes.map(({ between: [a, b] }) => [laneName(a, b), { lane: [a, b] }])),
    Zones: byName(Object.entries(zones).map(([name, within]) => ({ zone: { name, places: within } })).map((part) => [partName(part), part])),
  };
  parts = new Map(Object.values(named).flat());
  const groups = Object.entries(named).map(([label, all]) => make('optgroup', { label }, all.map(([name]) => make('option', {}, name))));
  byId('part').replaceChildren(make('option', { value: '' }, 'none'), ...groups);
  byId('part').value = parts.has(selected) ? selected : '';
}

/** Shows the selected place, lane or zone, and the list. The buttons stay, so that they keep the focus. */
export function update(shown, part) {
  model = shown ?? {};
  selected = part;
  byId('part').value = parts.has(part) ? part : '';
  const [closure, limit] = [model.closures?.[part], model.speed_limits?.[part]];
  const none = part ? 'No closure and no speed limit is known.' : 'Select a place, lane or zone here, or a place or lane on the map, to close it or to limit the speed there.';
  const states = [
    closure && orderText('closed', closure.order),
    ...zonesWith(part, model.closures).map((zone) => `in the closed ${zone}`),
    ...alarmsThatClose(part).map((alarm) => `closed by the alarm ${alarm}`),
    limit && orderText(`limited to ${limit.speed_mps} m/s`, limit.order),
    ...zonesWith(part, model.speed_limits).map((zone) => `in ${zone}, limited to ${model.speed_limits[zone].speed_mps} m/s`),
  ];
  setText(byId('part-head'), part ?? 'No place, lane or zone is selected');
  setText(byId('part-state'), states.filter(Boolean).join('; ') || none);
  // A part of an order may be missing on the present map and in the present fleet file.
  byId('part-orders').disabled = !closure && !limit && !parts.has(part);
  list('closures', model.closures, 'it is opened', () => []);
  list('limits', model.speed_limits, 'it is cleared', ({ speed_mps: speed }) => [`${speed} m/s`]);
}

/** Lists orders about places, lanes and zones, each with the cells of its kind. `endless` is the end of an order without one. */
function list(id, orders = {}, endless, own) {
  byId(`${id}-block`).hidden = Object.keys(orders).length === 0;
  const items = Object.entries(orders).map(([key, given]) => ({ key, ...given.order, own: own(given), selected: key === selected }));
  rows(byId(id).tBodies[0], items, (row, item) => {
    const button = make('button', { className: 'rowbutton', type: 'button' }, item.key);
    button.setAttribute('aria-pressed', String(item.selected));
    // A press of a key has no click count. Such a user continues at the orders of the place, lane or zone.
    button.onclick = (event) => {
      choose(item.key);
      if (event.detail === 0) byId('part-orders').focus();
    };
    cells(row, button, ...item.own, item.by, make('td', { className: 'wrap' }, item.reason || '–'), item.until_ms ? moment(item.until_ms) : endless);
  });
}

/** Returns the names of the zones with a place that have an order. */
const zonesWith = (place, orders = {}) => Object.entries(orders).filter(([, { part }]) => part.zone?.places.includes(place)).map(([name]) => name);

/** Returns the names of the alarms that close a place or lane. */
const alarmsThatClose = (name) => Object.entries(model.alarms ?? {})
  .filter(([, { plan }]) => plan.closes.some((part) => partName(part) === name || placesOf(part).includes(name)))
  .map(([alarm]) => alarm);

/** Returns a place, lane or zone, which may be missing on the present map and in the present fleet file. */
const partOf = (name) => [model.closures, model.speed_limits].map((orders) => orders?.[name]?.part).find(Boolean) ?? parts.get(name) ?? { place: name };

/** Describes the robots at a place, lane or zone, or on their way through it. */
function robotsAt(name) {
  const part = partOf(name);
  const within = new Set(placesOf(part));
  const passes = ({ place, route = [] }) => (part.lane ? route.some((to, index) => laneName(route[index - 1] ?? place, to) === name) : route.some((to) => within.has(to)));
  const role = (robot) => (robot.mission ? `, as ${robot.role ?? 'a role'} of ${robot.mission}` : '');
  return Object.entries(model.robots ?? {}).flatMap(([robot, shown]) => {
    if (passes(shown)) return [`${robot} is on its way ${within.has(shown.route.at(-1)) ? 'there' : 'through it'}${role(shown)}`];
    return within.has(shown.place) ? [`${robot} is there, or has just left${role(shown)}`] : [];
  });
}

/** Describes what a closure affects: robots at the place or on their way through it, and missions that need a place. */
function affectedBy(name) {
  const part = partOf(name);
  const within = new Set(placesOf(part));
  const [robots, lanes] = [Object.values(model.robots ?? {}), model.map?.lanes ?? []];
  // Only robots with a speed drive.
  const starts = robots.filter((robot) => robot.alive && robot.speed).map((robot) => robot.place);
  const closed = closedNames(model);
  const [before, after] = [closed, new Set([...closed, ...(part.lane ? [name] : within)])].map((all) => reachable(lanes, starts, all));
  const needed = Object.entries(model.missions ?? {}).filter(([, mission]) => !mission.ended).flatMap(([id, mission]) =>
    [...new Set(valuesAhead(mission))].flatMap((place) => {
      if (within.has(place)) return [`${id} needs ${place}`];
      return before.has(place) && !after.has(place) ? [`${id} needs ${place}, which no robot reaches any more`] : [];
    }));
  return [...robotsAt(name), ...needed];
}

/** Asks for the fields of an order about the selected place, lane or zone, or confirms it, and sends it. */
function give(button) {
  const { zone, place, lane } = partOf(selected);
  const request = lane ? { lanes: [lane] } : { places: [zone?.name ?? place] };
  const title = `${button.textContent}: ${selected}`;
  ORDERS[button.dataset.order](button, { title, request }, { zone, lane });
}

/** The orders, by the names of their buttons. */
const ORDERS = {
  open(button, given) {
    const others = [...zonesWith(selected, model.closures).map((zone) => `${zone} is closed`), ...alarmsThatClose(selected).map((alarm) => `the alarm ${alarm} lasts`)];
    const effect = others.length ? `It stays closed while ${others.join(' and while ')}.` : 'Robots may enter it again.';
    confirmOrder(button, { ...given, effect, affected: [], path: '/api/open', done: others.length ? `${selected} has no closure of its own` : `${selected} is open` });
  },
  close(button, given, { zone, lane }) {
    const affected = affectedBy(selected);
    ask(button, {
      ...given,
      effect: `${lane ? OF_LANE : zone ? OF_ZONE : OF_PLACE} ${OF_ALL}`,
      affected: affected.length ? affected : ['No robot and no mission is known that it affects.'],
      path: '/api/close',
      done: `${selected} is closed`,
      end: 'until',
    });
  },
  limit(button, { title, request }, { lane }) {
    const [where, robots] = [lane ? 'along it, in both directions' : 'on every lane from and to its places', robotsAt(selected)];
    const number = { type: 'number', min: String(SPEED_MIN), step: 'any', value: String(model.speed_limits?.[selected]?.speed_mps ?? SPEED), required: true };
    ask(button, {
      title,
      fields: [field(`Speed in metres per second, ${SPEED_MIN} or more`, make('input', { name: 'speed_mps', ...number }))],
      describe: ({ speed_mps: speed }) => ({
        effect: `Robots drive at most ${speed ?? '–'} m/s ${where}. ${OF_LIMIT}`,
        affected: robots.length ? robots : ['No robot is known that it affects now.'],
        done: `${selected} is limited to ${speed} m/s`,
      }),
      path: '/api/limit',
      request: { ...request, action: 'set' },
      end: 'until',
    });
  },
  clear(button, { title, request }) {
    const zones = zonesWith(selected, model.speed_limits);
    confirmOrder(button, {
      title,
      effect: zones.length ? `The limit of ${zones.join(' and ')} still holds there.` : 'Robots drive at their own speed there, or at that of other limits.',
      affected: [],
      path: '/api/limit',
      request: { ...request, action: 'clear' },
      done: `${selected} has no speed limit of its own`,
    });
  },
};
