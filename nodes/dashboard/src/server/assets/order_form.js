// The confirmation of an order: its effect, what it affects, and its fields.

import { confirmAndSend } from './action.js';
import { byId, enable, make, moment, setText } from './dom.js';
import { addButtons, sendForm, showProblem } from './mission_form.js';
import { newRequest } from './request.js';

const FORM = 'order';
/** Maximum number of affected robots and missions that a confirmation lists. */
const LISTED = 8;
/** Maximum length of a condition. */
const CONDITION_MAX = 1024;
/** Button that shows what an order affects. */
const PREVIEW = 'Preview';

/** The order of the open form, its preview, and the name of its request. A changed form is a new request. */
let open;
let preview;
let request;

export function start() {
  addButtons(FORM, 'Send', 'Back');
  byId('order-form').oninput = ({ target }) => {
    request = undefined;
    if (target.closest('#order-fields')) preview = undefined;
    describe();
  };
  byId('order-form').onsubmit = async (event) => {
    event.preventDefault();
    const form = open;
    if (form.preview && !preview?.request) return showPreview(form);
    const order = described();
    request ??= newRequest();
    const own = form.preview ? {} : ownFields();
    const isDone = await sendForm(FORM, order.path, { ...order.request, ...own, ...givenFields(), request }, order.done);
    // What the form selects may have changed.
    if (!isDone && form.preview && open === form) {
      request = preview = undefined;
      describe();
    }
  };
}

/** Creates an own field of an order. The name of its element is that of the request's member. */
export const field = (text, element) => make('label', { className: 'field' }, text, element);

/** Creates the own field `where` of an order: a condition in CEL. Returns its element, and the field. */
export function conditionField(text) {
  const element = make('input', { name: 'where', type: 'text', maxLength: CONDITION_MAX, autocomplete: 'off', spellcheck: false, required: true });
  return [element, field(`${text} `, element)];
}

/**
 * Opens the form of an order. Besides a person it has `fields` of its own, a field for the end of the order (`end`:
 * `minutes`, or `until` if it may have no end), and a reason (`reason`: `required`, `none`, or optional by default).
 * What depends on the values of its own fields, `describe` returns for them.
 *
 * If the node or the coordinator selects what the order affects, `preview` asks for it with the values of the own fields.
 * It returns a `summary`, what is `affected`, and, unless that is nothing, the members of the `request` that the own
 * fields demand, with the text of the button that sends it (`send`). The form sends no order without a preview.
 */
export function ask(button, order) {
  open = { send: order.preview ? PREVIEW : button.textContent, ...order };
  request = preview = undefined;
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

const described = () => ({ ...open, ...open.describe?.(ownFields()), ...preview });

/** Shows the effect of the order, and what it affects: all that a preview lists. */
function describe() {
  const { effect, summary = '', affected = [], send } = described();
  const texts = open.preview ? affected : listed(affected);
  setText(byId('order-effect'), effect);
  setText(byId('order-summary'), summary);
  byId('order-affected').replaceChildren(...texts.map((text) => make('li', {}, text)));
  // Only a list that can be longer than its box is a stop for the keyboard.
  byId('order-list').tabIndex = texts.length > LISTED ? 0 : -1;
  setText(byId('order-send'), send);
}

/** Asks what the order of a form affects now, and shows it, unless the form has changed meanwhile. */
async function showPreview(form) {
  const [button, own] = [byId('order-send'), ownFields()];
  const isSame = () => open === form && JSON.stringify(own) === JSON.stringify(ownFields());
  button.disabled = true;
  showProblem(FORM, '');
  try {
    const found = await form.preview(own);
    if (isSame()) preview = found;
  } catch (problem) {
    if (isSame()) showProblem(FORM, problem.message);
  } finally {
    enable(button);
  }
  describe();
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

/** Returns the fields of the open form that other orders have, too. */
function givenFields() {
  const value = (name) => byId(`order-${name}`).value.trim();
  const given = {};
  if (open.reason !== 'none') given.reason = value('reason');
  if (value('by')) given.by = value('by');
  if (open.end === 'minutes') given.for_s = Number(value('minutes')) * 60;
  else if (value('until')) given.until = new Date(value('until')).toISOString();
  return given;
}
