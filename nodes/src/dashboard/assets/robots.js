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
    // To whole beats of gossip, so that a row is not drawn for an age alone.
    heard: Math.round(Math.max(robot.heard_ms ?? 0, robot.body_ms ?? 0) / 2000) * 2000,
    chosen: key === chosen,
  }));
  rows(byId('robots').tBodies[0], items, (row, item) => {
    const choose = make('button', { className: 'rowbutton', type: 'button' }, item.key);
    choose.setAttribute('aria-pressed', String(item.chosen));
    choose.onclick = () => onChoose(item.key);
    const [kind, text] = doing(item);
    const detail = item.task ? `${words(item.task)}${item.to ? ` → ${item.to}` : ''}` : item.problem;
    const does = make('td', { className: 'wrap' }, state(kind, text), detail ? make('span', { className: 'sub' }, detail) : null);
    if (item.chosen) row.setAttribute('aria-current', 'true');
    else row.removeAttribute('aria-current');
    cells(row, choose, does, meter(item.battery, percent(item.battery), item.low ? 'bad' : 'good'), item.place ?? '–', numberCell(since(item.heard)));
  });
  const people = Object.entries(picture.people ?? {}).map(([key, person]) => ({ key, ...person }));
  byId('people-block').hidden = people.length === 0;
  rows(byId('people').tBodies[0], people, (row, person) => {
    cells(row, person.key, person.away ? `away from ${person.place}` : person.place, (person.samples ?? []).join(', ') || '–');
  });
}

function doing(item) {
  if (!item.alive) return ['bad', 'not heard'];
  if (item.word === 'out_of_service' || item.able === false) return ['bad', 'out of service'];
  if (item.word === 'suspended') return ['warn', `suspended: ${item.job}`];
  if (item.job) return ['work', item.job];
  return ['wait', 'free'];
}
