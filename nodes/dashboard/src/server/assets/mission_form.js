// Fields for the parameters of a mission.

import { make, readable } from './dom.js';
import { send } from './request.js';

let named;

/** Returns the missions that the user may submit by name, with their parameters. */
export const namedMissions = async () => (named ??= (await send('GET', '/api/named-missions')).missions);

/** Fills an empty choice of missions. */
export function fillMissions(choice, missions) {
  if (choice.options.length > 0) return;
  choice.append(...missions.map(({ mission, title }) => make('option', { value: mission, title }, mission)));
  choice.value = missions.some(({ mission }) => mission === 'lab-samples') ? 'lab-samples' : choice.value;
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

/** Returns the values of the filled fields, by parameter. */
export function givenParameters(form) {
  const given = [...form.querySelectorAll('[data-parameter]')].filter((field) => field.value !== '');
  return Object.fromEntries(given.map((field) => [field.dataset.parameter, field.value]));
}
