// Orders to missions: their priorities, the robots of their roles, and the cancellation of several.

import { make } from './dom.js';
import { ask, confirmOrder, field } from './order_form.js';

let model = {};

export const update = (shown) => { model = shown; };

/** Asks for the priority of a mission, and changes it. */
export function changePriority(button, id) {
  const mission = model.missions[id];
  const waiting = Object.entries(model.missions).filter(([other, { state }]) => state === 'pending' && other !== id).map(([, other]) => other);
  const number = { type: 'number', min: '-100', max: '100', step: '1', value: String(mission.priority), required: true };
  ask(button, {
    title: `Change the priority of ${id}`,
    fields: [field('Priority, −100 to 100', make('input', { name: 'priority', ...number }))],
    describe: ({ priority = mission.priority }) => {
      const before = waiting.filter((other) => other.priority > priority || (other.priority === priority && other.number < mission.number)).length;
      return {
        effect: 'Missions with a higher priority get free robots first. Roles that robots hold stay with them.',
        affected: [`Waiting missions before it: ${before}, after it: ${waiting.length - before}.`],
        done: `${id} has priority ${priority}`,
      };
    },
    path: '/api/priority',
    request: { mission: id },
    reason: 'none',
  });
}

/** Asks for the next robot of a held or promised role, and reassigns it. */
export function reassign(button, id, role) {
  const { holder, phase } = model.missions[id].roles[role];
  const others = Object.keys(model.robots ?? {}).filter((robot) => robot !== holder);
  const robot = make('select', { name: 'to' }, make('option', { value: '' }, 'any other robot'), options(others));
  const end = phase === 'promised' ? `${holder} does not get the role` : `${holder} returns the role once its body is at rest`;
  ask(button, {
    title: `Reassign ${role} of ${id}`,
    fields: [field('Robot', robot), field('Tasks of the role that have ended may be repeated ', make('input', { name: 'repeat', type: 'checkbox' }))],
    describe: ({ to }) => ({
      effect: `${end}, and ${to ? `${to} gets it` : 'another robot gets it'} and starts it from its beginning. The role stays with its robot if that has an item in it, or if other roles have acted on its work.`,
      affected: rolesOf([holder, to]),
      done: `${role} of ${id} is reassigned`,
    }),
    path: '/api/reassign',
    request: { mission: id, role },
    reason: 'none',
  });
}

/** Asks for the only robot that may get a role that waits, and pins the role to it. */
export function pin(button, id, role) {
  const { holder } = model.missions[id].roles[role];
  const robots = Object.keys(model.robots ?? {});
  const robot = make('select', { name: 'pin', required: true }, options(robots));
  if (robots.includes(holder)) robot.value = holder;
  ask(button, {
    title: `Pin ${role} of ${id}`,
    fields: [field('Robot', robot)],
    describe: (given) => ({
      effect: `No robot but ${given.pin ?? 'this robot'} gets the role from now on, also after its loss. ${holder && given.pin !== holder ? `${holder} does not get it.` : ''}`,
      affected: rolesOf([given.pin]),
      done: `${role} of ${id} is pinned`,
    }),
    path: '/api/reassign',
    request: { mission: id, role },
    reason: 'none',
  });
}

/** Confirms the end of the order about a role, and sends it. */
export const unpin = (button, id, role) => confirmOrder(button, {
  title: `End the order about ${role} of ${id}`,
  effect: `It is ${model.missions[id].orders?.[role]}. Then any robot may get it.`,
  affected: [],
  path: '/api/reassign',
  request: { mission: id, role, unpin: true },
  done: `Any robot may get ${role} of ${id}`,
});

/** Confirms the cancellation of missions, and sends it. They are canceled in one entry of the ledger. */
export const cancelAll = (button, missions) => confirmOrder(button, {
  title: `Cancel ${missions.length === 1 ? 'one mission' : `${missions.length} missions`}`,
  effect: 'Robots stop safely and become free.',
  affected: missions.map((id) => {
    const robots = new Set(Object.values(model.missions[id]?.holders ?? {}));
    return robots.size ? `${id}, with ${[...robots].join(', ')}` : `${id}, without a robot`;
  }),
  path: '/api/missions/cancel',
  request: { missions },
  done: ({ missions: canceled = {}, refused = {} }) => {
    const problems = Object.entries(refused).map(([id, why]) => `${id}: ${why}`);
    if (problems.length) throw new Error(problems.join('\n'));
    return `Canceled: ${Object.keys(canceled).join(', ')}`;
  },
});

const options = (robots) => robots.map((robot) => make('option', { value: robot }, robot));

/** Describes the roles that robots hold now. */
const rolesOf = (robots) => robots.filter(Boolean).map((name) => {
  const { mission, role } = model.robots?.[name] ?? {};
  return `${name} holds ${mission ? `${role ?? 'a role'} of ${mission}` : 'no role'}`;
});
