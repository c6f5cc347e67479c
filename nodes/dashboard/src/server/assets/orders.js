// Orders to robots: hold, release and maintenance. Each is confirmed with its effect on robots and their roles.

import { byId, make, setText } from './dom.js';
import { ask, conditionField, confirmOrder, field, orderText } from './order_form.js';
import { partName } from './places.js';
import { send } from './request.js';

/**
 * Each order: its call with its own members, its effect on robots and on a role that a robot holds, the announcement
 * of its success, and the fields of its form. An order without the field of its end has no form.
 */
const ORDERS = {
  hold: {
    path: '/api/hold',
    effect: 'Held robots stand still at once, keep their roles, and get no others. Deadlines of missions go on. This is not an emergency stop.',
    role: 'waits',
    done: 'held',
    end: 'minutes',
  },
  release: {
    path: '/api/release',
    effect: 'Held robots continue their roles. Other robots stay as they are.',
    role: 'continues',
    done: 'released',
    reason: 'none',
  },
  maintenance: {
    path: '/api/maintenance',
    request: { action: 'begin' },
    effect: 'Robots in maintenance complete their roles, and get no others.',
    role: 'is completed',
    done: 'taken out of service',
    end: 'until',
    reason: 'required',
  },
  end: {
    path: '/api/maintenance',
    request: { action: 'end' },
    effect: 'Robots that return to service get roles again.',
    role: 'goes on',
    done: 'returned to service',
  },
};

let model = {};
let robots = {};
let selected;

export function start() {
  for (const button of byId('robot-orders').querySelectorAll('button')) button.onclick = () => give(button, [selected]);
  for (const id of ['hold-all', 'release-all']) byId(id).onclick = (event) => give(event.currentTarget, 'all');
  for (const id of ['hold-group', 'release-group']) byId(id).onclick = (event) => giveGroup(event.currentTarget);
}

/** Shows the selected robot with its orders. Its buttons stay, so that they keep the focus. */
export function update(shown, robot) {
  model = shown;
  robots = model.robots ?? {};
  selected = robots[robot] && robot;
  setText(byId('robot-head'), selected ?? 'No robot is selected');
  setText(byId('robot-state'), selected ? stateOf(robots[selected]) : 'Select a robot in the table or on the map to hold it or to take it out of service.');
  byId('robot-orders').disabled = !selected;
}

/** Moves the focus to the orders of the selected robot. */
export function focus() {
  if (selected) byId('robot-orders').focus();
}

function stateOf({ mission, role, orders: { hold, maintenance } = {} }) {
  return [
    mission ? `${role ?? 'a role'} of ${mission}` : 'no role',
    hold && orderText('held', hold),
    maintenance && orderText('in maintenance', maintenance),
  ].filter(Boolean).join('; ');
}

const nameOf = (targets) => (targets === 'all' ? 'Every robot' : targets.join(', '));

/** Describes the role that an order to a robot affects, if any. A release affects the roles of held robots. */
function affectedRole(order, name) {
  const { mission, role, orders } = robots[name] ?? {};
  return mission && (order !== 'release' || orders?.hold) ? `${name}: ${role ?? 'a role'} of ${mission} ${ORDERS[order].role}` : undefined;
}

/** Asks for the fields of an order, or confirms it, and sends it. */
function give(button, targets) {
  const { order } = button.dataset;
  const { request, done, ...fixed } = ORDERS[order];
  const roles = (targets === 'all' ? Object.keys(robots) : targets).map((name) => affectedRole(order, name)).filter(Boolean);
  const given = {
    ...fixed,
    title: `${button.textContent}${targets === 'all' ? '' : `: ${nameOf(targets)}`}`,
    request: { ...request, robots: targets },
    done: `${nameOf(targets)} is ${done}`,
  };
  if (fixed.end) ask(button, { ...given, affected: roles.length ? roles : ['No role is affected.'] });
  else confirmOrder(button, { ...given, affected: roles });
}

/** Asks for a zone or a condition, and gives an order to the robots in it, or that meet it, after a preview of them. */
function giveGroup(button) {
  const { order } = button.dataset;
  const { effect, done, ...fixed } = ORDERS[order];
  const [condition, where] = conditionField('Condition on a robot, such as robot.attributes.section == "icu" or robot.battery < 0.2');
  const zones = Object.keys(model.zones ?? {});
  const zone = make('select', { name: 'zone' },
    zones.map((name) => make('option', { value: name }, `in zone ${name} now`)),
    make('option', { value: '' }, 'that meet a condition'));
  // The selected zone of the map.
  const chosen = zones.find((name) => partName({ zone: { name } }) === byId('part').value);
  if (chosen) zone.value = chosen;
  const update = () => {
    where.hidden = zone.value !== '';
    condition.disabled = where.hidden;
  };
  zone.oninput = update;
  update();
  ask(button, {
    ...fixed,
    title: button.textContent,
    effect: `${effect} The order is for the robots that are in the zone, or meet the condition, when it is given.`,
    fields: [field('Robots', zone), where],
    preview: async (given) => {
      const selection = given.zone ? { zone: given.zone } : { where: given.where };
      const found = (await send('POST', '/api/robots/select', { robots: selection })).robots;
      if (found.length === 0) return { summary: given.zone ? `No robot is in zone ${given.zone} now.` : 'No robot meets the condition now.' };
      const count = found.length === 1 ? 'one robot' : `${found.length} robots`;
      return {
        summary: `Selected now: ${count}.`,
        affected: found.map((name) => affectedRole(order, name) ?? name),
        send: `${order === 'hold' ? 'Hold' : 'Release'} ${count}`,
        request: { robots: selection },
      };
    },
    done: ({ robots: ordered }) => `${nameOf(Object.keys(ordered))}: ${done}`,
  });
}
