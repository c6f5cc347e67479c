// Orders to robots: hold, release and maintenance. Each is confirmed with its effect on robots and their roles.

import { confirmAndSend } from './action.js';
import { byId, make, moment, setText } from './dom.js';
import { sendForm, showProblem } from './mission_form.js';

const FORM = 'order';
/** Maximum number of roles that a confirmation lists. */
const LISTED = 8;
/** Each order: its call, its effect on robots and on a role that a robot holds, and the announcement of its success. */
const ORDERS = {
  hold: {
    path: '/api/hold',
    effect: 'Held robots stand still at once, keep their roles, and get no others. Deadlines of missions go on. This is not an emergency stop.',
    role: 'waits',
    done: 'held',
  },
  release: { path: '/api/release', effect: 'Held robots continue their roles. Other robots stay as they are.', role: 'continues', done: 'released' },
  maintenance: {
    path: '/api/maintenance',
    effect: 'Robots in maintenance complete their roles, and get no others.',
    role: 'is completed',
    done: 'taken out of service',
  },
  end: { path: '/api/maintenance', effect: 'Robots that return to service get roles again.', role: 'goes on', done: 'returned to service' },
};

let robots = {};
let selected;
/** The order of the open form, and its robots: names, or `all`. */
let open;

export function start() {
  for (const button of byId('robot-orders').querySelectorAll('button')) button.onclick = () => give(button, [selected]);
  for (const id of ['hold-all', 'release-all']) byId(id).onclick = (event) => give(event.currentTarget, 'all');
  byId('order-back').onclick = () => byId(FORM).close();
  byId('order-form').onsubmit = (event) => {
    event.preventDefault();
    const { path, done } = ORDERS[open.order];
    sendForm(FORM, path, givenOrder(), `${nameOf(open.targets)} is ${done}`);
  };
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

function stateOf({ mission, role, orders = {} }) {
  const order = (word, given) => given && `${word} by ${given.by}${given.until_ms ? ` until ${moment(given.until_ms)}` : ''}${given.reason ? `: ${given.reason}` : ''}`;
  return [mission ? `${role ?? 'a role'} of ${mission}` : 'no role', order('held', orders.hold), order('in maintenance', orders.maintenance)].filter(Boolean).join('; ');
}

const nameOf = (targets) => (targets === 'all' ? 'Every robot' : targets.join(', '));

/** Describes the roles that an order affects. A release affects the roles of held robots. */
function affectedRoles(order, targets) {
  const names = (targets === 'all' ? Object.keys(robots) : targets).filter((name) => robots[name]?.mission && (order !== 'release' || robots[name].orders?.hold));
  const roles = names.slice(0, LISTED).map((name) => `${name}: ${robots[name].role ?? 'a role'} of ${robots[name].mission} ${ORDERS[order].role}`);
  return names.length > LISTED ? [...roles, `and ${names.length - LISTED} more`] : roles;
}

/** Opens the form of an order with fields, or confirms another order. */
function give(button, targets) {
  const { order } = button.dataset;
  const { path, effect, done } = ORDERS[order];
  const roles = affectedRoles(order, targets);
  const title = `${button.textContent}${targets === 'all' ? '' : `: ${nameOf(targets)}`}`;
  if (order === 'release' || order === 'end') {
    const request = order === 'end' ? { robots: targets, action: 'end' } : { robots: targets };
    confirmAndSend(button, [`${title}?`, effect, ...roles].join('\n'), path, request, `${nameOf(targets)} is ${done}`);
    return;
  }
  open = { order, targets };
  setText(byId('order-head'), title);
  setText(byId('order-effect'), effect);
  byId('order-roles').replaceChildren(...(roles.length ? roles : ['No role is affected.']).map((text) => make('li', {}, text)));
  // Hidden fields are neither checked nor sent.
  for (const [field, of] of [['minutes', 'hold'], ['until', 'maintenance']]) {
    byId(`order-${field}`).disabled = order !== of;
    byId(`order-${field}`).closest('label').hidden = order !== of;
  }
  byId('order-reason').required = order === 'maintenance';
  byId('order-reason').value = '';
  byId('order-until').value = '';
  setText(byId('order-send'), button.textContent);
  showProblem(FORM, '');
  byId(FORM).showModal();
  byId('order-reason').focus();
}

/** Returns the request of the open form. */
function givenOrder() {
  const value = (field) => byId(`order-${field}`).value.trim();
  const given = { robots: open.targets, reason: value('reason') };
  if (value('by')) given.by = value('by');
  if (open.order === 'hold') return { ...given, for_s: Number(value('minutes')) * 60 };
  if (value('until')) given.until = new Date(value('until')).toISOString();
  return { ...given, action: 'begin' };
}
