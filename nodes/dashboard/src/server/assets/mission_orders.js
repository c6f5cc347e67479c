// Orders to missions: their priorities, the robots of their roles, and the cancellation of several.

import { byId, make } from './dom.js';
import { ask, conditionField, confirmOrder, field } from './order_form.js';
import { send } from './request.js';

let model = {};

export function start() {
  byId('cancel-where').onclick = ({ currentTarget }) => cancelWhere(currentTarget);
}

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

const OF_CANCELLATION = 'Robots stop safely and become free.';

const countOf = (missions) => (missions.length === 1 ? 'one mission' : `${missions.length} missions`);

/** Describes a mission with its robots. */
function withRobots(id) {
  const robots = new Set(Object.values(model.missions?.[id]?.holders ?? {}));
  return robots.size ? `${id}, with ${[...robots].join(', ')}` : `${id}, without a robot`;
}

/** Describes the reply to a cancellation, or throws which missions were left out. */
function canceledText({ missions = {}, refused = {}, again }) {
  if (again) return 'The missions were canceled before; the audit trail lists them';
  const canceled = Object.keys(missions).length ? [`Canceled: ${Object.keys(missions).join(', ')}`] : [];
  const problems = Object.entries(refused).map(([id, why]) => `${id}: ${why}`);
  if (problems.length) throw new Error([...problems, ...canceled].join('\n'));
  return canceled.join('');
}

/** Confirms the cancellation of missions, and sends it. They are canceled in one entry of the ledger. */
export const cancelAll = (button, missions) => confirmOrder(button, {
  title: `Cancel ${countOf(missions)}`,
  effect: OF_CANCELLATION,
  affected: missions.map(withRobots),
  path: '/api/missions/cancel',
  request: { missions },
  done: canceledText,
});

/** Asks for a condition, shows the missions that the coordinator would cancel, and cancels these and no others. */
function cancelWhere(button) {
  ask(button, {
    title: button.textContent,
    effect: `${OF_CANCELLATION} The missions that the preview lists are canceled, and no others.`,
    fields: [conditionField('Condition on a mission, such as mission.name == "lab-samples" && mission.age_s > 3600')[1]],
    preview: async ({ where }) => {
      const { missions, refused } = await send('POST', '/api/missions/cancel', { missions: { where }, dry_run: true });
      const [accepted, others] = [Object.keys(missions), Object.entries(refused)];
      const shown = { affected: [...accepted.map(withRobots), ...others.map(([id, why]) => `${id} stays: ${why}`)] };
      if (accepted.length === 0) return { ...shown, summary: others.length ? 'No mission can be canceled.' : 'No mission meets the condition now.' };
      return { ...shown, summary: `Selected now: ${countOf(accepted)}.`, send: `Cancel ${countOf(accepted)}`, request: { missions: accepted } };
    },
    path: '/api/missions/cancel',
    reason: 'none',
    done: canceledText,
  });
}

const options = (robots) => robots.map((robot) => make('option', { value: robot }, robot));

/** Describes the roles that robots hold now. */
const rolesOf = (robots) => robots.filter(Boolean).map((name) => {
  const { mission, role } = model.robots?.[name] ?? {};
  return `${name} holds ${mission ? `${role ?? 'a role'} of ${mission}` : 'no role'}`;
});
