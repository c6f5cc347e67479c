// The confirmation of an order to robots or of a closure: its effect, what it affects, and its fields.

import { confirmAndSend } from './action.js';
import { byId, make, moment, setText } from './dom.js';
import { addButtons, sendForm, showProblem } from './mission_form.js';
import { newRequest } from './request.js';

const FORM = 'order';
/** Maximum number of affected robots and missions that a confirmation lists. */
const LISTED = 8;

/** The order of the open form, and the name of its request. A changed form is a new request. */
let open;
let request;

export function start() {
  addButtons(FORM, 'Send', 'Back');
  byId('order-form').oninput = () => {
    request = undefined;
    describe();
  };
  byId('order-form').onsubmit = (event) => {
    event.preventDefault();
    const order = described();
    request ??= newRequest();
    sendForm(FORM, order.path, { ...order.request, ...givenFields(), request }, order.done);
  };
}

/** Creates an own field of an order. The name of its element is that of the request's member. */
export const field = (text, element) => make('label', { className: 'field' }, text, element);

/**
 * Opens the form of an order. Besides a person it has `fields` of its own, a field for the end of the order (`end`:
 * `minutes`, or `until` if it may have no end), and a reason (`reason`: `required`, `none`, or optional by default).
 * What depends on the values of its own fields, `describe` returns for them.
 */
export function ask(button, order) {
  open = order;
  request = undefined;
  setText(byId('order-head'), order.title);
  byId('order-fields').replaceChildren(...(order.fields ?? []));
  // Hidden fields are neither checked nor sent.
  for (const [name, shown] of Object.entries({ minutes: order.end === 'minutes', until: order.end === 'until', reason: order.reason !== 'none' })) {
    byId(`order-${name}`).disabled = !shown;
    byId(`order-${name}`).closest('label').hidden = !shown;
  }
  byId('order-reason').required = order.reason === 'required';
  byId('order-reason').value = '';
  byId('order-until').value = '';
  describe();
  setText(byId('order-send'), button.textContent);
  showProblem(FORM, '');
  byId(FORM).onclose = () => returnFocus(button);
  byId(FORM).showModal();
  (byId('order-fields').querySelector('[name]') ?? byId('order-reason')).focus();
}

/** Focuses the button of an order, or the one that has replaced it meanwhile. */
function returnFocus(button) {
  const { key } = button.dataset;
  if (!button.isConnected && key) document.querySelector(`[data-key="${CSS.escape(key)}"]`)?.focus();
}

const described = () => ({ ...open, ...open.describe?.(ownFields()) });

/** Shows the effect of the order, and what it affects. */
function describe() {
  const { effect, affected } = described();
  setText(byId('order-effect'), effect);
  byId('order-affected').replaceChildren(...listed(affected).map((text) => make('li', {}, text)));
}

/** Confirms an order without fields, and sends it. */
export function confirmOrder(button, { title, effect, affected, path, request: order, done }) {
  confirmAndSend(button, [`${title}?`, effect, ...listed(affected)].join('\n'), path, { ...order, request: newRequest() }, done);
}

/** Describes an order in force. */
export const orderText = (word, { by, reason, until_ms: until }) =>
  `${word} by ${by}${until ? ` until ${moment(until)}` : ''}${reason ? `: ${reason}` : ''}`;

const listed = (affected) => (affected.length > LISTED ? [...affected.slice(0, LISTED), `and ${affected.length - LISTED} more`] : affected);

/** Returns the values of the filled own fields, by name. */
function ownFields() {
  const filled = [...byId('order-fields').querySelectorAll('[name]')].filter(({ value }) => value !== '');
  const value = (element) => ({ checkbox: element.checked, number: Number(element.value) })[element.type] ?? element.value;
  return Object.fromEntries(filled.map((element) => [element.name, value(element)]));
}

/** Returns the fields of the open form. */
function givenFields() {
  const value = (name) => byId(`order-${name}`).value.trim();
  const given = ownFields();
  if (open.reason !== 'none') given.reason = value('reason');
  if (value('by')) given.by = value('by');
  if (open.end === 'minutes') given.for_s = Number(value('minutes')) * 60;
  else if (value('until')) given.until = new Date(value('until')).toISOString();
  return given;
}
