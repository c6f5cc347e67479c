// Closures: the selected place, lane or closed zone with its orders, and the list of all closures.

import { byId, cells, make, moment, rows, setText } from './dom.js';
import { valuesAhead } from './missions.js';
import { ask, confirmOrder, orderText } from './order_form.js';
import { closedNames, laneName, partName, placesOf, reachable } from './places.js';

/** Effects of closures. */
const OF_PLACE = 'No robot enters it, or drives a lane to it. A robot inside may leave.';
const OF_ZONE = 'No robot enters its places, or drives a lane to them. A robot inside may leave.';
const OF_LANE = 'No robot drives along it, in either direction.';
const OF_ALL = 'Robots under way take other ways, or wait and keep their roles. Deadlines of missions go on. This is not a safety function.';

let model = {};
/** Places and lanes of the map by name, each as in a closure. */
let parts = new Map();
let selected;
let choose = () => {};

export function start(onChoose) {
  choose = onChoose;
  byId('part').onchange = ({ target }) => choose(target.value || undefined);
  for (const button of byId('part-orders').querySelectorAll('button')) button.onclick = () => give(button);
}

/** Lists the places and lanes of the map. */
export function setMap({ places = [], lanes = [] } = {}) {
  const byName = (all) => all.sort(([a], [b]) => a.localeCompare(b));
  const named = {
    Places: byName(places.map(({ name }) => [name, { place: name }])),
    Lanes: byName(lanes.map(({ between: [a, b] }) => [laneName(a, b), { lane: [a, b] }])),
  };
  parts = new Map(Object.values(named).flat());
  const groups = Object.entries(named).map(([label, all]) => make('optgroup', { label }, all.map(([name]) => make('option', {}, name))));
  byId('part').replaceChildren(make('option', { value: '' }, 'none'), ...groups);
  byId('part').value = parts.has(selected) ? selected : '';
}

/** Shows the selected place, lane or zone, and the list. The buttons stay, so that they keep the focus. */
export function update(shown, part) {
  model = shown ?? {};
  const closures = Object.entries(model.closures ?? {});
  selected = part;
  byId('part').value = parts.has(part) ? part : '';
  const closure = model.closures?.[part];
  const open = part ? 'No closure is known.' : 'Select a place or lane, here or on the map, to close it.';
  const states = [
    closure && orderText('closed', closure.order),
    ...closedZonesWith(part).map((zone) => `in the closed ${zone}`),
    ...alarmsThatClose(part).map((alarm) => `closed by the alarm ${alarm}`),
  ];
  setText(byId('part-head'), part ?? 'No place or lane is selected');
  setText(byId('part-state'), states.filter(Boolean).join('; ') || open);
  // An opened zone is on no map.
  byId('part-orders').disabled = !closure && !parts.has(part);
  byId('closures-block').hidden = closures.length === 0;
  const items = closures.map(([key, { order }]) => ({ key, ...order, selected: key === part }));
  rows(byId('closures').tBodies[0], items, (row, item) => {
    const button = make('button', { className: 'rowbutton', type: 'button' }, item.key);
    button.setAttribute('aria-pressed', String(item.selected));
    // A press of a key has no click count. Such a user continues at the orders of the place or lane.
    button.onclick = (event) => {
      choose(item.key);
      if (event.detail === 0) byId('part-orders').focus();
    };
    cells(row, button, item.by, make('td', { className: 'wrap' }, item.reason || '–'), item.until_ms ? moment(item.until_ms) : 'it is opened');
  });
}

/** Returns the names of the closed zones with a place. */
const closedZonesWith = (place) => Object.entries(model.closures ?? {}).filter(([, { part }]) => part.zone?.places.includes(place)).map(([name]) => name);

/** Returns the names of the alarms that close a place or lane. */
const alarmsThatClose = (name) => Object.entries(model.alarms ?? {})
  .filter(([, { plan }]) => plan.closes.some((part) => partName(part) === name || placesOf(part).includes(name)))
  .map(([alarm]) => alarm);

/** Returns a place, lane or zone, which may be missing on the present map. */
const partOf = (name) => model.closures?.[name]?.part ?? parts.get(name) ?? { place: name };

/** Describes what a closure affects: robots at the place or on their way through it, and missions that need a place. */
function affectedBy(name) {
  const part = partOf(name);
  const within = new Set(placesOf(part));
  const [robots, lanes] = [Object.entries(model.robots ?? {}), model.map?.lanes ?? []];
  const passes = ({ place, route = [] }) => (part.lane ? route.some((to, index) => laneName(route[index - 1] ?? place, to) === name) : route.some((to) => within.has(to)));
  const role = (robot) => (robot.mission ? `, as ${robot.role ?? 'a role'} of ${robot.mission}` : '');
  const atPlace = robots.flatMap(([robot, shown]) => {
    if (passes(shown)) return [`${robot} is on its way ${within.has(shown.route.at(-1)) ? 'there' : 'through it'}${role(shown)}`];
    return within.has(shown.place) ? [`${robot} is there, or has just left${role(shown)}`] : [];
  });
  // Only robots with a speed drive.
  const starts = robots.filter(([, robot]) => robot.alive && robot.speed).map(([, robot]) => robot.place);
  const closed = closedNames(model);
  const [before, after] = [closed, new Set([...closed, ...(part.lane ? [name] : within)])].map((all) => reachable(lanes, starts, all));
  const needed = Object.entries(model.missions ?? {}).filter(([, mission]) => !mission.ended).flatMap(([id, mission]) =>
    [...new Set(valuesAhead(mission))].flatMap((place) => {
      if (within.has(place)) return [`${id} needs ${place}`];
      return before.has(place) && !after.has(place) ? [`${id} needs ${place}, which no robot reaches any more`] : [];
    }));
  return [...atPlace, ...needed];
}

/** Asks for the fields of a closure, or confirms the opening, and sends it. */
function give(button) {
  const { zone, place, lane } = partOf(selected);
  const request = lane ? { lanes: [lane] } : { places: [zone?.name ?? place] };
  const title = `${button.textContent}: ${selected}`;
  if (button.dataset.order === 'open') {
    const others = [...closedZonesWith(selected).map((zone) => `${zone} is closed`), ...alarmsThatClose(selected).map((alarm) => `the alarm ${alarm} lasts`)];
    const effect = others.length ? `It stays closed while ${others.join(' and while ')}.` : 'Robots may enter it again.';
    confirmOrder(button, { title, effect, affected: [], path: '/api/open', request, done: others.length ? `${selected} has no closure of its own` : `${selected} is open` });
    return;
  }
  const affected = affectedBy(selected);
  ask(button, {
    title,
    effect: `${lane ? OF_LANE : zone ? OF_ZONE : OF_PLACE} ${OF_ALL}`,
    affected: affected.length ? affected : ['No robot and no mission is known that it affects.'],
    path: '/api/close',
    request,
    done: `${selected} is closed`,
    end: 'until',
  });
}
