// Helpers: elements, number formats, and tables that update only changed cells.

export const byId = (id) => document.getElementById(id);

/**
 * Creates an element: `make('p', { className: 'muted' }, 'text', child)`. Text is never parsed as
 * markup.
 */
export function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === undefined || value === null) continue;
    if (name.includes('-') || name === 'role' || name === 'scope') element.setAttribute(name, value);
    else element[name] = value;
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return element;
}

/**
 * Sets a text if it differs: an unchanged node causes no layout, and no announcement by a screen
 * reader.
 */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Enables a button again, and returns the focus that it lost when it was disabled. */
export function enable(button) {
  button.disabled = false;
  if (document.activeElement === document.body) button.focus();
}

/** Replaces the content of an element, and keeps the focus on the child with the same data-key. */
export function redraw(element, ...children) {
  const key = element.contains(document.activeElement) ? document.activeElement.dataset.key : undefined;
  const open = new Set([...element.querySelectorAll('details[open]')].map((details) => details.dataset.key));
  element.replaceChildren(...children.flat().filter(Boolean));
  for (const details of element.querySelectorAll('details')) details.open = open.has(details.dataset.key);
  if (key) [...element.querySelectorAll('[data-key]')].find((child) => child.dataset.key === key)?.focus();
}

/** Size of the batches in which hidden rows are updated, and their interval in milliseconds. */
const [BATCH, BATCH_DELAY] = [10, 1000];
/** Rows that are not visible now. */
const hidden = new WeakSet();
const watch = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    if (!isIntersecting) hidden.add(target);
    else if (hidden.delete(target)) target.due?.();
  }
});

/**
 * Updates the rows of a table to `items`, which have a `key`. `fill(row, item)` creates or updates
 * the row's cells. It is called only for changed items: at once for visible rows, and in batches
 * for the rest, so that hundreds of rows never delay the map.
 */
export function rows(body, items, fill) {
  clearTimeout(body.turn);
  const known = new Map([...body.rows].map((row) => [row.dataset.row, row]));
  let place = body.firstElementChild;
  const waiting = [];
  for (const item of items) {
    let row = known.get(item.key);
    const shown = JSON.stringify(item);
    const isNew = !row;
    if (isNew) {
      row = make('tr');
      row.dataset.row = item.key;
      watch.observe(row);
    }
    known.delete(item.key);
    row.due = undefined;
    if (row.shown !== shown) {
      const change = () => {
        row.due = undefined;
        fill(row, item);
        row.shown = shown;
      };
      if (isNew || !hidden.has(row)) change();
      else {
        row.due = change;
        waiting.push(row);
      }
    }
    if (row === place) place = place.nextElementSibling;
    else body.insertBefore(row, place);
  }
  for (const row of known.values()) {
    watch.unobserve(row);
    row.remove();
  }
  // Continues after the last updated row, so that constant changes delay no row forever.
  const after = waiting.findIndex((row) => row.dataset.row === body.last) + 1;
  const inTurn = waiting.slice(after).concat(waiting.slice(0, after));
  const nextBatch = () => {
    for (const row of inTurn.splice(0, BATCH)) {
      row.due?.();
      body.last = row.dataset.row;
    }
    if (inTurn.length) body.turn = setTimeout(nextBatch, BATCH_DELAY);
  };
  nextBatch();
}

/**
 * Sets the cells of a row: texts or elements. The first cell is the row's header. Unchanged cells
 * are kept.
 */
export function cells(row, head, ...others) {
  const focused = row.contains(document.activeElement);
  const next = [make('th', { scope: 'row' }, head), ...others.map((content) => (content instanceof HTMLTableCellElement ? content : make('td', {}, content)))];
  for (const [index, cell] of next.entries()) {
    const before = row.cells[index];
    if (!before) row.append(cell);
    else if (before !== cell && !before.isEqualNode(cell)) before.replaceWith(cell);
  }
  if (focused && !row.contains(document.activeElement)) row.querySelector('button')?.focus();
}

export const numberCell = (...children) => make('td', { className: 'number' }, ...children);

/** Formats a duration, short. */
export function span(ms) {
  if (ms === undefined || ms === null) return '–';
  if (ms < 0) ms = 0;
  if (ms < 1000) return `${Math.round(ms)} ms`;
  const s = ms / 1000;
  if (s < 60) return `${s.toFixed(s < 10 ? 1 : 0)} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min ${Math.floor(s % 60)} s`;
  return `${Math.floor(s / 3600)} h ${Math.floor((s % 3600) / 60)} min`;
}

/** Formats an age: whole seconds, so that it does not flicker. */
export const age = (ms) => (ms < 1000 ? 'now' : span(Math.floor(ms / 1000) * 1000).replace('.0', ''));

/** Creates an element with the age of an instant, updated by `tickAges`. */
export const since = (instant, before = '', after = '') => {
  const element = make('span', {});
  Object.assign(element.dataset, { since: instant, before, after });
  return element;
};

/** Updates visible ages each second, and hidden ages in turns. */
let round = 0;
export function tickAges(now) {
  round += 1;
  for (const [index, element] of document.querySelectorAll('[data-since]').entries()) {
    if (element.textContent && hidden.has(element.closest('tr')) && (index + round) % 8) continue;
    setText(element, element.dataset.before + age(now - Number(element.dataset.since)) + element.dataset.after);
  }
}

export const clock = (ms) => new Date(ms).toLocaleTimeString([], { hour: '2-digit', minute: '2-digit', second: '2-digit', hour12: false });

/** Formats an instant of the next hours. */
export const hour = (ms) => new Date(ms).toLocaleTimeString([], { hour: '2-digit', minute: '2-digit', hourCycle: 'h23' });

/** Formats an instant with its day, for instants that may be days away. */
export const moment = (ms) => new Date(ms).toLocaleString([], { dateStyle: 'short', timeStyle: 'short', hourCycle: 'h23' });

export const percent = (share, digits = 0) => `${(share * 100).toFixed(digits)} %`;

export const readable = (text) => (text ?? '').replaceAll('_', ' ');

/** A value of a reading, a feedback or a result, short. */
export const brief = (value) => String(typeof value === 'number' ? Math.round(value * 100) / 100 : value);

/** A name with its value, in a list of notes. */
export const note = (name, ...values) => make('div', {}, make('dt', {}, name), values.map((value) => make('dd', {}, value)));

/** A state: a dot and a word, so that no information depends on colour alone. */
export const state = (kind, text) => make('span', { className: `state ${kind}` }, text);

/** A bar with its number. */
export function meter(share, text, kind = '') {
  const bar = make('b');
  bar.style.width = `${Math.min(Math.max(share, 0), 1) * 100}%`;
  return make('span', { className: `meter ${kind}` }, make('i', { 'aria-hidden': 'true' }, bar), text);
}
