// Robots and people in words: the text of the map.

import { byId, cells, make, meter, numberCell, percent, rows, say, since, state, words } from './dom.js';

export function update(picture, chosen, onChoose) {
  const robots = Object.entries(picture.robots ?? {});
  const count = (word) => robots.filter(([, robot]) => robot.alive && robot.availability === word).length;
  say(byId('robots-count'), `${robots.length}: ${count('holding') + count('suspended')} at work, ${count('free')} free`);
  const items = robots.map(([key, robot]) => ({
    key,
    alive: robot.alive,
    able: robot.able,
    word: robot.availability,
    problem: robot.problem,
    job: robot.mission && `${robot.role ?? 'a role'} of ${robot.mission}`,
    task: robot.task,
    to: robot.destination,
    battery: Math.round((robot.battery ?? 0) * 100) / 100,
    low: robot.battery <= (robot.useful_charge ?? 0) + 0.1,
    place: robot.place,
    chosen: key === chosen,
  }));
  const body = byId('robots').tBodies[0];
  rows(body, items, (row, item) => {
    const choose = make('button', { className: 'rowbutton', type: 'button' }, item.key);
    choose.setAttribute('aria-pressed', String(item.chosen));
    choose.onclick = () => onChoose(item.key);
    const [kind, text] = doing(item);
    const detail = item.task ? `${words(item.task)}${item.to ? ` → ${item.to}` : ''}` : item.problem;
    const does = make('td', { className: 'wrap' }, state(kind, text), detail ? make('span', { className: 'sub' }, detail) : null);
    if (item.chosen) row.setAttribute('aria-current', 'true');
    else row.removeAttribute('aria-current');
    cells(row, choose, does, meter(item.battery, percent(item.battery), item.low ? 'bad' : 'good'), item.place ?? '–', row.cells[4] ?? numberCell(since(0)));
  });
  // No row is made anew for an age alone.
  for (const row of body.rows) {
    const { heard_ms = 0, body_ms = 0 } = picture.robots[row.dataset.row];
    row.querySelector('[data-since]').dataset.since = Math.max(heard_ms, body_ms);
  }
  const people = Object.entries(picture.people ?? {}).map(([key, person]) => ({ key, ...person }));
  byId('people-block').hidden = people.length === 0;
  rows(byId('people').tBodies[0], people, (row, person) => {
    cells(row, person.key, words(person.role) || '–', person.away ? `away from ${person.place}` : person.place, (person.samples ?? []).join(', ') || '–');
  });
  const doors = Object.entries(picture.doors ?? {}).map(([key, is]) => ({ key, is }));
  byId('doors-block').hidden = doors.length === 0;
  rows(byId('doors').tBodies[0], doors, (row, door) => cells(row, door.key, make('td', {}, state(DOORS[door.is] ?? 'wait', words(door.is)))));
}

const DOORS = { open: 'good', opening: 'work', closing: 'work', closed: 'wait' };

function doing(item) {
  if (!item.alive) return ['bad', 'not heard'];
  if (item.word === 'out_of_service' || item.able === false) return ['bad', 'out of service'];
  if (item.word === 'suspended') return ['warn', `suspended: ${item.job}`];
  if (item.job) return ['work', item.job];
  return ['wait', 'free'];
}
