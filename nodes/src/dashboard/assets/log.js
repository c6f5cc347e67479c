// The event log with its filter. Alarms are said aloud.

import { byId, clock, make, rows, say, words } from './dom.js';
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

/** Says aloud what is new and alarming; not so if somebody has just gone elsewhere in a recording. */
export function alarms(picture, quiet) {
  const numbers = Object.keys(picture.log ?? {}).map(Number);
  const last = Math.max(0, ...numbers);
  if (announced !== undefined && !quiet) {
    const news = numbers.filter((number) => number > announced).map((number) => picture.log[number]).filter((event) => event.alarm);
    if (news.length) announce(news.map((event) => `${event.word}: ${event.text}`).join('. '));
  }
  announced = last;
}

export function update(picture) {
  const all = Object.entries(picture.log ?? {}).map(([key, event]) => ({ key, ...event }));
  all.sort((a, b) => b.key - a.key);
  options('kind', all.map((event) => [event.kind, words(event.kind)]));
  options('mission', all.map((event) => [event.mission, event.mission]));
  options('robot', all.map((event) => [event.robot, event.robot]));
  const text = filter.text.toLowerCase();
  const fits = (event) =>
    (!filter.kind || event.kind === filter.kind) && (!filter.mission || event.mission === filter.mission) &&
    (!filter.robot || event.robot === filter.robot) && (!text || `${event.word} ${event.text} ${event.node}`.toLowerCase().includes(text));
  const found = all.filter(fits);
  say(byId('log-count'), `${found.length} of the last ${all.length} events${found.length > SHOWN ? `, the latest ${SHOWN} shown` : ''}`);
  rows(byId('log').tBodies[0], found.slice(0, SHOWN), (row, event) => {
    row.className = event.alarm ? 'alarm' : '';
    row.replaceChildren(make('td', {}, clock(event.at_ms)), make('td', {}, event.word), make('td', {}, event.text));
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
