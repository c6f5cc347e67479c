// Forms of requests, and the fields of those that request missions. The ids of a form's elements begin with the id of its dialog.

import { byId, enable, make, readable, setText } from './dom.js';
import { send } from './request.js';
import { announce } from './status.js';

let named;

/** Adds the place of a problem to a form, and the buttons that close and send it. */
export function addButtons(form, send, close = 'Close') {
  const closing = make('button', { type: 'button', id: `${form}-close`, className: 'quiet' }, close);
  closing.onclick = () => byId(form).close();
  byId(`${form}-form`).append(
    make('p', { id: `${form}-problem`, className: 'problem', role: 'alert', hidden: true }),
    make('div', { className: 'actions' }, closing, make('button', { type: 'submit', id: `${form}-send`, className: 'primary' }, send)),
  );
}

/** Adds the fields for the priority and the deadline of a mission. */
export function addOptions(form) {
  const number = (name, text, properties) =>
    make('label', { className: 'field' }, text, make('input', { type: 'number', id: `${form}-${name}`, step: '1', ...properties }));
  const options = byId(`${form}-options`);
  options.prepend(number('priority', 'Priority, −100 to 100 ', { min: '-100', max: '100', value: '0' }));
  options.append(number('deadline', 'Deadline in seconds, optional ', { min: '1' }));
}

/** Opens a form with the missions that the user may submit by name, and draws the fields of the chosen mission. */
export async function openForm(form, firstField, drawParameters) {
  showProblem(form, '');
  try {
    named ??= (await send('GET', '/api/named-missions')).missions;
    fillMissions(byId(`${form}-mission`));
    drawParameters();
  } catch (problem) {
    showProblem(form, problem.message);
  }
  byId(form).showModal();
  byId(`${form}-${firstField}`).focus();
}

function fillMissions(choice) {
  if (choice.options.length > 0) return;
  choice.append(...named.map(({ mission, title }) => make('option', { value: mission, title }, mission)));
  choice.value = named.some(({ mission }) => mission === 'lab-samples') ? 'lab-samples' : choice.value;
}

/** Returns the mission that is chosen by name in a form. */
export const chosenMission = (form) => named?.find(({ mission }) => mission === byId(`${form}-mission`).value);

/** Shows a problem in a form; an empty text hides it. */
export function showProblem(form, text) {
  byId(`${form}-problem`).hidden = !text;
  setText(byId(`${form}-problem`), text);
}

/**
 * Sends the request of a form. A success closes the form, and `done` announces it, or is a function that returns the
 * announcement for a reply and throws what was not done. Returns whether it succeeded.
 */
export async function sendForm(form, path, request, done) {
  const button = byId(`${form}-send`);
  button.disabled = true;
  showProblem(form, '');
  try {
    const reply = await send('POST', path, request);
    const text = typeof done === 'function' ? done(reply) : done;
    byId(form).close();
    announce(text);
    return true;
  } catch (problem) {
    showProblem(form, problem.message);
    return false;
  } finally {
    enable(button);
  }
}

/** Returns the names of the places that a mission can use. */
export const placesOf = (model) => (model.map?.places ?? []).filter((place) => place.kind !== 'corridor').map(({ name }) => name);

/** Creates the fields of a mission's parameters. */
export function parameterFields(parameters, places) {
  return Object.entries(parameters).map(([name, { kind, default: value, description }]) => {
    const text = `${readable(name)}${description ? `: ${description}` : ''}${kind === 'seconds' ? ', in seconds' : ''}`;
    const known = kind === 'place' && places.length > 0 && (!value || places.includes(value));
    const field = known
      ? make('select', {}, places.map((place) => make('option', { value: place, selected: place === value }, place)))
      : make('input', { type: kind === 'seconds' ? 'number' : 'text', value: value ?? '', required: value === undefined, autocomplete: 'off' });
    field.dataset.parameter = name;
    return make('label', { className: 'field' }, text, field);
  });
}

/** Returns the mission that a form requests. */
export function givenMission(form) {
  const value = (field) => byId(`${form}-${field}`).value;
  const parameters = givenParameters(byId(`${form}-parameters`));
  const given = { mission: value('mission'), parameters, priority: Number(value('priority') || 0) };
  return value('deadline') ? { ...given, deadline_s: Number(value('deadline')) } : given;
}

/** Returns the values of the filled fields, by parameter. */
export function givenParameters(form) {
  const given = [...form.querySelectorAll('[data-parameter]')].filter((field) => field.value !== '');
  return Object.fromEntries(given.map((field) => [field.dataset.parameter, field.value]));
}
