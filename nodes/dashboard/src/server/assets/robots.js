// Tables of robots, people and doors: the map's content as text.

import { brief, byId, cells, hour, make, meter, numberCell, percent, rows, setText, since, state, readable } from './dom.js';

export function update(model, chosen, onChoose) {
  const robots = Object.entries(model.robots ?? {});
  const count = (word) => robots.filter(([, robot]) => robot.alive && robot.availability === word).length;
  setText(byId('robots-count'), `${robots.length}: ${count('holding') + count('suspended')} at work, ${count('free')} free`);
  const describe = ({ key, robot }) => ({
    key,
    alive: robot.alive,
    canMove: robot.can_move,
    availability: robot.availability,
    problem: robot.problem,
    held: Boolean(robot.orders?.hold),
    job: robot.mission && `${robot.role ?? 'a role'} of ${robot.mission}`,
    task: robot.task,
    to: robot.destination,
    battery: Math.round((robot.battery ?? 0) * 100) / 100,
    low: robot.battery <= (robot.useful_charge ?? 0) + 0.1,
    forecast: robot.forecast && forecastText(robot.forecast),
    place: robot.place,
    readings: Object.entries(robot.readings ?? {}).map(([name, value]) => `${name} ${brief(value)}`).join(', '),
    chosen: key === chosen,
  });
  const body = byId('robots').tBodies[0];
  const fill = (row, item) => {
    const choose = make('button', { className: 'rowbutton', type: 'button' }, item.key);
    choose.setAttribute('aria-pressed', String(item.chosen));
    // A press of a key has no click count. Such a user continues at the orders of the robot.
    choose.onclick = (event) => onChoose(item.key, event.detail === 0);
    const [kind, text] = activity(item);
    const detail = item.problem ?? (item.task ? `${readable(item.task)}${item.to ? ` → ${item.to}` : ''}` : null);
    const does = make('td', { className: 'wrap' }, state(kind, text), detail ? make('span', { className: 'sub' }, detail) : null);
    const where = make('td', { className: 'wrap' }, item.place ?? '–', item.readings ? make('span', { className: 'sub' }, item.readings) : null);
    if (item.chosen) row.setAttribute('aria-current', 'true');
    else row.removeAttribute('aria-current');
    const charge = make('td', {}, meter(item.battery, percent(item.battery), item.low ? 'bad' : 'good'), item.forecast ? make('span', { className: 'sub' }, item.forecast) : null);
    cells(row, choose, does, charge, where, row.cells[4] ?? numberCell(since(0)));
    // The age of a row that scrolling adds.
    dateRow(row, model);
  };
  rows(body, robots.map(([key, robot]) => ({ key, robot })), fill, describe);
  // Ages are updated without redrawing the row.
  for (const row of body.rows) dateRow(row, model);
  const people = Object.entries(model.people ?? {}).map(([key, person]) => ({ key, ...person }));
  byId('people-block').hidden = people.length === 0;
  rows(byId('people').tBodies[0], people, (row, person) => {
    cells(row, person.key, readable(person.role) || '–', person.away ? `away from ${person.place}` : person.place, (person.samples ?? []).join(', ') || '–');
  });
  const doors = Object.entries(model.doors ?? {}).map(([key, is]) => ({ key, state: is }));
  byId('doors-block').hidden = doors.length === 0;
  rows(byId('doors').tBodies[0], doors, (row, door) => cells(row, door.key, make('td', {}, state(DOORS[door.state] ?? 'wait', readable(door.state)))));
}

function dateRow(row, model) {
  const robot = model.robots?.[row.dataset.row];
  if (!robot) return;
  const { last_contact_ms = 0, telemetry_ms = 0 } = robot;
  row.querySelector('[data-since]').dataset.since = Math.max(last_contact_ms, telemetry_ms);
}

/** Describes when the charge of a robot reaches the next threshold. */
export const forecastText = ({ share, at_ms: at }) => `${percent(share)} at ${hour(at)}`;

const DOORS = { open: 'good', opening: 'work', closing: 'work', closed: 'wait' };

function activity(item) {
  if (!item.alive) return ['bad', 'no contact'];
  if (item.availability === 'out_of_service' || item.canMove === false) return ['bad', 'out of service'];
  if (item.held) return ['warn', item.job ? `held: ${item.job}` : 'held'];
  if (item.availability === 'suspended') return ['warn', `suspended: ${item.job}`];
  if (item.job) return ['work', item.job];
  return ['wait', item.availability === 'charging' ? 'charging' : 'free'];
}
