// Alarms: those in force above the page, and the orders that raise and clear them.

import { byId, make, moment, redraw } from './dom.js';
import { ask, confirmOrder, field, orderText } from './order_form.js';
import { partName } from './places.js';

let model = {};

export function start() {
  byId('raise-alarm').onclick = (event) => raise(event.currentTarget);
}

/** Shows the alarms in force. An alarm is drawn again only after a change, which screen readers announce. */
export function update(shown) {
  model = shown;
  const alarms = Object.entries(model.alarms ?? {});
  byId('raise-alarm').hidden = Object.keys(model.declared_alarms ?? {}).length === 0;
  byId('alarms').hidden = alarms.length === 0;
  const key = JSON.stringify(alarms);
  if (byId('alarms-list').shown === key) return;
  byId('alarms-list').shown = key;
  redraw(byId('alarms-list'), alarms.map(([name, { plan, order }]) => {
    const clear = make('button', { type: 'button', className: 'danger', 'data-key': `clear-${name}` }, `Clear ${name}`);
    clear.onclick = () => confirmClear(clear, name);
    const text = make('p', { role: 'alert' }, `Alarm ${name}, ${orderText('raised', order)}, since ${moment(order.since_ms)}. ${planText(plan)}`);
    return make('div', {}, text, clear);
  }));
}

/** Describes what an alarm demands. Another fleet file may lack an alarm for which the form is open. */
function planText(plan) {
  if (!plan) return 'The fleet file no longer declares it.';
  const { robots, places = [], closes = [] } = plan;
  const demand = robots === 'assemble' ? `Robots drive to the nearest of ${places.join(', ')}.` : 'Robots stand still.';
  return closes.length ? `${demand} Closed: ${closes.map(partName).join(', ')}.` : demand;
}

/** Asks for the alarm and its reason, and raises it. */
function raise(button) {
  const names = Object.keys(model.declared_alarms);
  ask(button, {
    title: 'Raise an alarm',
    fields: [field('Alarm', make('select', { name: 'alarm' }, names.map((name) => make('option', { value: name }, name))))],
    describe: ({ alarm }) => ({
      effect: `${planText(model.declared_alarms[alarm])} No robot takes a role, and robots with roles keep them, until the alarm is cleared. Deadlines of missions go on. This is not a safety function.`,
      affected: affected('is suspended', 'waits for the all-clear'),
      done: `The alarm ${alarm} is raised`,
    }),
    path: '/api/alarm',
    request: { action: 'raise' },
  });
}

function confirmClear(button, alarm) {
  const others = Object.keys(model.alarms ?? {}).filter((name) => name !== alarm);
  const request = { action: 'clear', alarm };
  const order = { title: `Clear the alarm ${alarm}`, path: '/api/alarm', request, done: `The alarm ${alarm} is cleared` };
  if (others.length) confirmOrder(button, { ...order, effect: `Robots still obey the alarm ${others.join(' and ')}.`, affected: [] });
  else confirmOrder(button, { ...order, effect: 'Robots continue their roles, and take others.', affected: affected('continues', 'continues') });
}

/** Describes the robots and missions that an alarm affects: their numbers, held roles, and missions without a robot. */
function affected(role, mission) {
  const robots = Object.entries(model.robots ?? {}).filter(([, robot]) => robot.alive);
  const held = robots.filter(([, robot]) => robot.mission);
  const underWay = robots.filter(([, robot]) => robot.route?.length).length;
  const missions = Object.entries(model.missions ?? {}).filter(([, { ended }]) => !ended).map(([id]) => id);
  const without = missions.filter((id) => !held.some(([, robot]) => robot.mission === id));
  return [
    `Robots: ${robots.length}, of them under way: ${underWay}. Missions that have not ended: ${missions.length}.`,
    ...held.map(([name, robot]) => `${name}: ${robot.role ?? 'a role'} of ${robot.mission} ${role}`),
    ...without.map((id) => `${id} ${mission}`),
  ];
}
