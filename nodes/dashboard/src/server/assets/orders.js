// Orders to robots: hold, release and maintenance. Each is confirmed with its effect on robots and their roles.

import { byId, setText } from './dom.js';
import { ask, confirmOrder, orderText } from './order_form.js';

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
  release: { path: '/api/release', effect: 'Held robots continue their roles. Other robots stay as they are.', role: 'continues', done: 'released' },
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

let robots = {};
let selected;

export function start() {
  for (const button of byId('robot-orders').querySelectorAll('button')) button.onclick = () => give(button, [selected]);
  for (const id of ['hold-all', 'release-all']) byId(id).onclick = (event) => give(event.currentTarget, 'all');
}

/** Shows the selected robot with its orders. Its buttons stay, so that they keep the focus. */
export function update(model, robot) {
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

/** Describes the roles that an order affects. A release affects the roles of held robots. */
function affectedRoles(order, targets) {
  const names = (targets === 'all' ? Object.keys(robots) : targets).filter((name) => robots[name]?.mission && (order !== 'release' || robots[name].orders?.hold));
  return names.map((name) => `${name}: ${robots[name].role ?? 'a role'} of ${robots[name].mission} ${ORDERS[order].role}`);
}

/** Asks for the fields of an order, or confirms it, and sends it. */
function give(button, targets) {
  const { order } = button.dataset;
  const { request, done, ...fixed } = ORDERS[order];
  const roles = affectedRoles(order, targets);
  const given = {
    ...fixed,
    title: `${button.textContent}${targets === 'all' ? '' : `: ${nameOf(targets)}`}`,
    request: { ...request, robots: targets },
    done: `${nameOf(targets)} is ${done}`,
  };
  if (fixed.end) ask(button, { ...given, affected: roles.length ? roles : ['No role is affected.'] });
  else confirmOrder(button, { ...given, affected: roles });
}
