// The audit trail: who requested which change, and when. It is read while its panel is open.

import { byId, cells, make, moment, readable, rows, setText } from './dom.js';
import { send } from './request.js';

const SHOWN = 200;
/** Interval between reads in milliseconds. */
const INTERVAL = 3000;

let entries = [];
let isReading = false;

export function start(isOpen) {
  byId('audit-filter').onsubmit = (event) => event.preventDefault();
  byId('audit-person').oninput = draw;
  setInterval(() => isOpen() && read(), INTERVAL);
}

/** Reads the trail, and shows it; keeps the entries that are shown if it cannot be read. */
export async function read() {
  if (isReading) return;
  isReading = true;
  let problem = '';
  try {
    entries = (await send('GET', '/api/audit')).entries.toReversed();
  } catch (error) {
    problem = error.message;
  } finally {
    isReading = false;
  }
  byId('audit-problem').hidden = !problem;
  setText(byId('audit-problem'), problem);
  draw();
}

function draw() {
  const person = byId('audit-person').value.trim().toLowerCase();
  const found = entries.filter(({ by }) => by.toLowerCase().includes(person));
  setText(byId('audit-count'), `${found.length} of ${entries.length} changes${found.length > SHOWN ? `, the latest ${SHOWN} shown` : ''}`);
  rows(byId('audit').tBodies[0], found.slice(0, SHOWN).map((entry) => ({ ...entry, key: String(entry.number) })), (row, { at_ms: at, by, action, subject, details }) => {
    const what = make('td', { className: 'wrap' }, subject, details ? make('span', { className: 'sub' }, details) : null);
    cells(row, moment(at), make('td', { className: 'wrap' }, by || '–'), readable(action), what);
  });
}
