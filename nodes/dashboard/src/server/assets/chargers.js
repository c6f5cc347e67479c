// Chargers: who charges there, who is on the way, and who waits.

import { byId, cells, rows } from './dom.js';

/** Returns the chargers by place, each with the robots that charge, that are on the way, and that wait for it. */
export function chargersOf(model) {
  const onMap = (model.map?.places ?? []).filter((place) => place.kind === 'charger').map(({ name }) => name);
  const chargers = new Map([...new Set([...(model.charging?.chargers ?? []), ...onMap])].sort().map((place) => [place, { charging: [], coming: [], waiting: [] }]));
  for (const [robot, { charging = {} }] of Object.entries(model.robots ?? {})) {
    chargers.get(charging.connected?.charger)?.charging.push(robot);
    chargers.get(charging.bound?.charger)?.coming.push(robot);
    for (const place of charging.waiting?.chargers ?? []) chargers.get(place)?.waiting.push(robot);
  }
  return chargers;
}

/** Describes the charging of a robot. */
export function chargingText({ connected, bound, waiting, leaving }) {
  if (connected) return `charges at ${connected.charger}`;
  if (bound) return `goes to the charger ${bound.charger}`;
  if (waiting) return `waits for ${waiting.chargers.join(' or ') || 'a charger'}`;
  return leaving ? `drives to ${leaving.to}, to make room` : '';
}

/** Shows the table of chargers. */
export function update(model) {
  const all = [...chargersOf(model)].map(([key, charger]) => ({ key, ...charger }));
  byId('chargers-block').hidden = all.length === 0;
  const names = (robots) => robots.join(', ') || '–';
  rows(byId('chargers').tBodies[0], all, (row, { key, charging, coming, waiting }) => cells(row, key, names(charging), names(coming), names(waiting)));
}
