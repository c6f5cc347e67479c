// Asking for a mission, withdrawing one, and closing one after a rescue.

import { byId, make, say, words } from './dom.js';
import { whereabouts } from './missions.js';
import { announce } from './status.js';

let shipped = [];
let places = [];
let request;

export function start(onSubmitted) {
  startRescue();
  const dialog = byId('order');
  byId('new-mission').onclick = async () => {
    trouble('');
    try {
      if (shipped.length === 0) shipped = (await ask('GET', '/api/shipped')).missions;
      fill();
    } catch (problem) {
      trouble(problem.message);
    }
    dialog.showModal();
    byId('order-mission').focus();
  };
  byId('order-close').onclick = () => dialog.close();
  byId('order-mission').onchange = parameters;
  // Whatever is changed is another request; the same one, asked again, gets the same mission.
  byId('order-form').oninput = () => { request = undefined; };
  byId('order-form').onsubmit = async (event) => {
    event.preventDefault();
    trouble('');
    const send = byId('order-send');
    send.disabled = true;
    say(send, 'Submitting …');
    request ??= `page-${Date.now().toString(36)}-${Math.random().toString(36).slice(2, 8)}`;
    const given = [...document.querySelectorAll('[data-parameter]')].filter((one) => one.value !== '');
    const order = {
      mission: byId('order-mission').value,
      parameters: Object.fromEntries(given.map((one) => [one.dataset.parameter, one.value])),
      request,
      priority: Number(byId('order-priority').value || 0),
    };
    if (byId('order-deadline').value) order.deadline_s = Number(byId('order-deadline').value);
    try {
      const { mission } = await ask('POST', '/api/missions', order);
      request = undefined;
      dialog.close();
      announce(`${mission} is acknowledged`);
      onSubmitted(mission);
    } catch (problem) {
      trouble(problem.message);
    } finally {
      send.disabled = false;
      say(send, 'Submit');
    }
  };
}

export function setPlaces(picture) {
  places = (picture.map?.places ?? []).filter((place) => place.kind !== 'corridor').map(({ name }) => name);
}

export async function cancel(id, button) {
  if (!confirm(`Cancel ${id}? Its robots stop safely.`)) return;
  button.disabled = true;
  try {
    await ask('POST', `/api/missions/${encodeURIComponent(id)}/cancel`, {});
    announce(`${id} is canceled`);
  } catch (problem) {
    button.disabled = false;
    announce(problem.message);
    alert(problem.message);
  }
}

/** Asks who took care of what a mission left in robots' hands, and closes it then. */
export function rescue(id, mission) {
  const dialog = byId('rescue');
  dialog.dataset.mission = id;
  say(byId('rescue-head'), `Close ${id} after a rescue`);
  say(byId('rescue-cause'), mission.cause ?? '');
  byId('rescue-items').replaceChildren(...(mission.items ?? []).map((item) => make('li', {}, whereabouts(item))));
  trouble('', 'rescue');
  dialog.showModal();
  byId('rescue-by').focus();
}

function startRescue() {
  const dialog = byId('rescue');
  byId('rescue-back').onclick = () => dialog.close();
  byId('rescue-form').onsubmit = async (event) => {
    event.preventDefault();
    const { mission } = dialog.dataset;
    const send = byId('rescue-send');
    send.disabled = true;
    trouble('', 'rescue');
    try {
      await ask('POST', `/api/missions/${encodeURIComponent(mission)}/rescued`, { by: byId('rescue-by').value });
      dialog.close();
      announce(`${mission} is closed`);
    } catch (problem) {
      trouble(problem.message, 'rescue');
    } finally {
      send.disabled = false;
    }
  };
}

function fill() {
  const choice = byId('order-mission');
  if (choice.options.length === 0) {
    choice.append(...shipped.map(({ mission, title }) => make('option', { value: mission, title }, mission)));
    choice.value = shipped.some((one) => one.mission === 'lab-samples') ? 'lab-samples' : choice.value;
  }
  parameters();
}

function parameters() {
  const chosen = shipped.find((one) => one.mission === byId('order-mission').value);
  say(byId('order-title'), chosen?.title ?? '');
  const fields = Object.entries(chosen?.parameters ?? {}).map(([name, { kind, default: value, description }]) => {
    const text = `${words(name)}${description ? `: ${description}` : ''}${kind === 'seconds' ? ', in seconds' : ''}`;
    const known = kind === 'place' && places.length > 0 && (!value || places.includes(value));
    const field = known
      ? make('select', {}, places.map((place) => make('option', { value: place, selected: place === value }, place)))
      : make('input', { type: kind === 'seconds' ? 'number' : 'text', value: value ?? '', required: value === undefined, autocomplete: 'off' });
    field.dataset.parameter = name;
    return make('label', { className: 'field' }, text, field);
  });
  byId('order-parameters').replaceChildren(...fields);
}

function trouble(text, form = 'order') {
  byId(`${form}-problem`).hidden = !text;
  say(byId(`${form}-problem`), text);
}

async function ask(method, path, value) {
  const options = { method };
  if (value !== undefined) Object.assign(options, { body: JSON.stringify(value), headers: { 'content-type': 'application/json' } });
  let answer;
  try {
    answer = await fetch(path, options);
  } catch {
    throw new Error('This page’s node does not answer.');
  }
  const said = await answer.json().catch(() => ({}));
  if (!answer.ok) throw new Error(said.error ?? `The node answers ${answer.status}.`);
  return said;
}
