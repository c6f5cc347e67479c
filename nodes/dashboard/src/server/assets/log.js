// The event log with its filter. Alarms are announced to screen readers.

import { byId, clock, make, rows, setText, readable } from './dom.js';
import { announce } from './status.js';

const SHOWN = 200;
const filter = { text: '', kind: '', mission: '', robot: '' };
let announced;

export function start(onChange) {
  byId('log-filter').onsubmit = (event) => event.preventDefault();
  for (const name of Object.keys(filter)) {
    byId(`log-${name}`).oninput = (event) => {
      filter[name] = event.target.value;
      onChange();
    };
  }
}

/** Announces new alarms, except directly after a seek in a recording. */
export function alarms(model, quiet) {
  const numbers = Object.keys(model.log ?? {}).map(Number);
  const last = Math.max(0, ...numbers);
  if (announced !== undefined && !quiet) {
    const fresh = numbers.filter((number) => number > announced).map((number) => model.log[number]).filter((event) => event.alarm);
    if (fresh.length) announce(fresh.map((event) => `${event.label}: ${event.text}`).join('. '));
  }
  announced = last;
}

export function update(model) {
  const all = Object.entries(model.log ?? {}).map(([key, event]) => ({ key, ...event }));
  all.sort((a, b) => b.key - a.key);
  options('kind', all.map((event) => [event.kind, readable(event.kind)]));
  options('mission', all.map((event) => [event.mission, event.mission]));
  options('robot', all.map((event) => [event.robot, event.robot]));
  const text = filter.text.toLowerCase();
  const fits = (event) =>
    (!filter.kind || event.kind === filter.kind) && (!filter.mission || event.mission === filter.mission) &&
    (!filter.robot || event.robot === filter.robot) && (!text || `${event.label} ${event.text} ${event.node}`.toLowerCase().includes(text));
  const found = all.filter(fits);
  setText(byId('log-count'), `${found.length} of the last ${all.length} events${found.length > SHOWN ? `, the latest ${SHOWN} shown` : ''}`);
  rows(byId('log').tBodies[0], found.slice(0, SHOWN), (row, event) => {
    row.className = event.alarm ? 'alarm' : '';
    row.replaceChildren(make('td', {}, clock(event.at_ms)), make('td', {}, event.label), make('td', {}, event.text));
  });
}

function options(name, pairs) {
  const choice = byId(`log-${name}`);
  const found = new Map(pairs.filter(([value]) => value));
  if (filter[name] && !found.has(filter[name])) found.set(filter[name], filter[name]);
  const sorted = [...found].sort(([, a], [, b]) => a.localeCompare(b));
  const names = JSON.stringify(sorted);
  if (choice.dataset.names === names) return;
  choice.dataset.names = names;
  choice.replaceChildren(make('option', { value: '' }, 'all'), ...sorted.map(([value, text]) => make('option', { value }, text)));
  choice.value = filter[name];
}
