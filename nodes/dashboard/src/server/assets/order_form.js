// The confirmation of an order to robots or of a closure: its effect, what it affects, and its fields.

import { confirmAndSend } from './action.js';
import { byId, make, moment, setText } from './dom.js';
import { addButtons, sendForm, showProblem } from './mission_form.js';

const FORM = 'order';
/** Maximum number of affected robots and missions that a confirmation lists. */
const LISTED = 8;

/** The order of the open form. */
let open;

export function start() {
  addButtons(FORM, 'Send', 'Back');
  byId('order-form').onsubmit = (event) => {
    event.preventDefault();
    sendForm(FORM, open.path, { ...open.request, ...givenFields() }, open.done);
  };
}

/**
 * Opens the form of an order. Besides a reason and a person it has a field for the end of the order:
 * `minutes`, or `until` if it may have no end.
 */
export function ask(button, order) {
  open = order;
  setText(byId('order-head'), order.title);
  setText(byId('order-effect'), order.effect);
  byId('order-affected').replaceChildren(...listed(order.affected).map((text) => make('li', {}, text)));
  // Hidden fields are neither checked nor sent.
  for (const field of ['minutes', 'until']) {
    byId(`order-${field}`).disabled = order.end !== field;
    byId(`order-${field}`).closest('label').hidden = order.end !== field;
  }
  byId('order-reason').required = Boolean(order.needsReason);
  byId('order-reason').value = '';
  byId('order-until').value = '';
  setText(byId('order-send'), button.textContent);
  showProblem(FORM, '');
  byId(FORM).showModal();
  byId('order-reason').focus();
}

/** Confirms an order without fields, and sends it. */
export function confirmOrder(button, { title, effect, affected, path, request, done }) {
  confirmAndSend(button, [`${title}?`, effect, ...listed(affected)].join('\n'), path, request, done);
}

/** Describes an order in force. */
export const orderText = (word, { by, reason, until_ms: until }) =>
  `${word} by ${by}${until ? ` until ${moment(until)}` : ''}${reason ? `: ${reason}` : ''}`;

const listed = (affected) => (affected.length > LISTED ? [...affected.slice(0, LISTED), `and ${affected.length - LISTED} more`] : affected);

/** Returns the fields of the open form. */
function givenFields() {
  const value = (field) => byId(`order-${field}`).value.trim();
  const given = { reason: value('reason') };
  if (value('by')) given.by = value('by');
  if (open.end === 'minutes') given.for_s = Number(value('minutes')) * 60;
  else if (value('until')) given.until = new Date(value('until')).toISOString();
  return given;
}
