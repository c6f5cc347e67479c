// Schedules: a table with their actions, the next occurrences by day, and the form of a new schedule.

import { confirmAndSend } from './action.js';
import { byId, cells, make, redraw, rows, state } from './dom.js';
import { addButtons, addOptions, chosenMission, givenMission, openForm, parameterFields, placesOf, sendForm } from './mission_form.js';

const FORM = 'add-schedule';
/** Number of days on the calendar. */
const DAYS = 7;
const ACTIONS = {
  pause: ['Pause', 'Its occurrences are left out until it is resumed.', 'paused'],
  resume: ['Resume', 'Its next occurrences are submitted.', 'resumed'],
  remove: ['Remove', 'Its missions go on.', 'removed'],
};

let places = [];
let choose = () => {};

export function start(onChoose) {
  choose = onChoose;
  addButtons(FORM, 'Add');
  addOptions(FORM);
  byId('new-schedule').onclick = () => openForm(FORM, 'name', parameters);
  byId(FORM).onclose = () => byId('add-schedule-parameters').replaceChildren();
  byId('add-schedule-mission').onchange = parameters;
  byId('add-schedule-form').onsubmit = add;
  byId('time-zones').append(...(Intl.supportedValuesOf?.('timeZone') ?? []).map((value) => make('option', { value })));
  byId('add-schedule-zone').value = Intl.DateTimeFormat().resolvedOptions().timeZone;
}

export function update(model) {
  const all = Object.entries(model.schedules ?? {});
  places = placesOf(model);
  byId('schedules-none').hidden = all.length > 0;
  byId('schedules-all').hidden = all.length === 0;
  rows(byId('schedules').tBodies[0], all.map(([key, schedule]) => ({ key, ...schedule })), (row, item) => {
    const times = make('td', {}, make('code', {}, item.cron), make('span', { className: 'sub' }, item.zone));
    cells(row, item.key, item.mission, times, condition(item), last(item), actions(item));
  });
  calendar(all);
}

function condition({ pause, next_ms: next, zone }) {
  if (pause) return make('td', {}, state('warn', 'paused'), make('span', { className: 'sub' }, `by ${pause.by}`));
  if (next === undefined) return make('td', {}, state('wait', 'ended'));
  return make('td', {}, state('good', 'active'), make('span', { className: 'sub' }, `next ${date(next, zone)}, ${time(next, zone)}`));
}

function last({ last: latest, zone }) {
  if (!latest) return '–';
  const button = make('button', { className: 'rowbutton', type: 'button' }, latest.mission);
  button.onclick = () => choose(latest.mission);
  return make('td', {}, button, make('span', { className: 'sub' }, `${date(latest.due_ms, zone)}, ${time(latest.due_ms, zone)}`));
}

const actions = ({ key, pause }) => make('td', { className: 'schedule-actions' }, [pause ? 'resume' : 'pause', 'remove'].map((action) => {
  const [word, effect, done] = ACTIONS[action];
  const label = { type: 'button', className: action === 'remove' ? 'danger' : 'quiet', 'aria-label': `${word} ${key}` };
  const button = make('button', label, word);
  button.dataset.action = action;
  button.onclick = () => confirmAndSend(button, `${word} ${key}? ${effect}`, path(key), { action }, `${key} is ${done}`);
  return button;
}));

const path = (schedule) => `/api/schedules/${encodeURIComponent(schedule)}`;

/** Draws the next occurrences by day. Days and times are those of the schedule's time zone, which is named if there are several. */
function calendar(all) {
  const days = new Map();
  for (const [schedule, { zone, upcoming_ms: upcoming = [] }] of all) {
    for (const ms of upcoming) {
      const day = format(ms, zone, { dateStyle: 'short' }, 'sv');
      days.set(day, [...(days.get(day) ?? []), { ms, schedule, zone, at: time(ms, zone) }]);
    }
  }
  const next = [...days].sort(([a], [b]) => a.localeCompare(b)).slice(0, DAYS);
  const hasZones = new Set(all.map(([, { zone }]) => zone)).size > 1;
  byId('calendar-none').hidden = next.length > 0;
  redraw(byId('calendar'), next.map(([, due]) => {
    const [first] = due.sort((a, b) => a.at.localeCompare(b.at) || a.ms - b.ms);
    const items = due.map(({ at, schedule, zone }) => make('li', {}, `${at} ${schedule}`, hasZones ? make('span', { className: 'muted' }, ` ${zone}`) : null));
    return make('section', {}, make('h4', {}, date(first.ms, first.zone)), make('ul', {}, items));
  }));
}

/** Formats a time in a time zone; in UTC if this browser does not know the time zone. */
function format(ms, zone, options, locale = []) {
  const instant = new Date(ms);
  try {
    return instant.toLocaleString(locale, { timeZone: zone, ...options });
  } catch {
    return instant.toLocaleString(locale, { timeZone: 'UTC', ...options });
  }
}

const time = (ms, zone) => format(ms, zone, { hour: '2-digit', minute: '2-digit', hourCycle: 'h23' });

const date = (ms, zone) => format(ms, zone, { weekday: 'short', day: 'numeric', month: 'short' });

function parameters() {
  byId('add-schedule-parameters').replaceChildren(...parameterFields(chosenMission(FORM)?.parameters ?? {}, places));
}

/** Adds the schedule of the form. The same schedule may be added again, so a request may be repeated. */
async function add(event) {
  event.preventDefault();
  const value = (field) => byId(`add-schedule-${field}`).value;
  const request = { action: 'add', cron: value('cron'), zone: value('zone'), missed: value('missed'), submit: givenMission(FORM) };
  if (value('until')) request.until = new Date(value('until')).toISOString();
  const added = await sendForm(FORM, path(value('name')), request, `${value('name')} is added`);
  if (added) byId('add-schedule-name').value = '';
}
