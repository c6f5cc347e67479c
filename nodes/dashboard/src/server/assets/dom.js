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

/** A table with more rows than this has elements only for the visible rows, and for some rows beside them. */
const [ROWS_WHOLE, ROWS_BESIDE] = [200, 8];
/** Row height in pixels until one has been measured. */
const ROW_HEIGHT = 30;

/**
 * Updates the rows of a table to `items`, which have a `key`. `fill(row, shown)` creates or updates
 * the row's cells from `describe(item)`. It is called only for changed items: at once for visible rows, and in batches
 * for the rest, so that hundreds of rows never delay the map. A table of more rows in a scrolled box has only those
 * around the visible ones.
 */
export function rows(body, items, fill, describe = (item) => item) {
  const scroller = items.length > ROWS_WHOLE ? body.closest('.scroll') : null;
  body.table = { items, fill, describe };
  if (scroller) showOnScroll(body, scroller);
  const shown = scroller ? visible(body, scroller, items) : items.map((item) => ({ item }));
  updateRows(body, shown, fill, describe);
  if (!scroller) return body.parentElement.removeAttribute('aria-rowcount');
  body.parentElement.setAttribute('aria-rowcount', items.length + 1);
  if (!body.rowHeight) measureRows(body);
}

/** Notes the height of the lowest row so far: as many rows as fit if all are that low are shown. */
function measureRows(body) {
  const heights = [...body.rows].filter((row) => !row.classList.contains('gap')).map((row) => row.offsetHeight).filter(Boolean);
  if (heights.length) body.rowHeight = Math.min(body.rowHeight ?? Infinity, ...heights);
}

/** Shows other rows when the box around a table is scrolled. */
function showOnScroll(body, scroller) {
  if (body.followsScroll) return;
  body.followsScroll = true;
  let requested = false;
  scroller.addEventListener('scroll', () => {
    if (requested) return;
    requested = true;
    requestAnimationFrame(() => {
      requested = false;
      const { items, fill, describe } = body.table;
      if (items.length <= ROWS_WHOLE) return;
      measureRows(body);
      rows(body, items, fill, describe);
    });
  }, { passive: true });
}

/** Returns the visible items with their indices, the one with the focus, and the gaps between them. */
function visible(body, scroller, items) {
  const height = body.rowHeight ?? ROW_HEIGHT;
  const first = Math.max(Math.floor(scroller.scrollTop / height) - ROWS_BESIDE, 0);
  const end = Math.min(Math.ceil((scroller.scrollTop + scroller.clientHeight) / height) + ROWS_BESIDE, items.length);
  const indices = Array.from({ length: Math.max(end - first, 0) }, (_, index) => first + index);
  const focused = body.contains(document.activeElement) ? document.activeElement.closest('tr').dataset.row : undefined;
  const index = focused === undefined ? -1 : items.findIndex((item) => item.key === focused);
  if (index >= 0 && index < first) indices.unshift(index);
  else if (index >= end) indices.push(index);
  const shown = [];
  const columns = body.parentElement.tHead.rows[0].cells.length;
  let next = 0;
  const gapTo = (index) => {
    if (index > next) shown.push({ item: { key: `gap:${next}`, gap: (index - next) * height, columns } });
    next = index + 1;
  };
  for (const index of indices) {
    gapTo(index);
    shown.push({ item: items[index], index });
  }
  gapTo(items.length);
  return shown;
}

/** Fills a row that stands for rows that are not shown. */
function fillGap(row, { gap, columns }) {
  row.className = 'gap';
  row.setAttribute('aria-hidden', 'true');
  const cell = make('td', { colSpan: columns });
  cell.style.height = `${gap}px`;
  row.replaceChildren(cell);
}

function updateRows(body, items, fillItem, describe) {
  clearTimeout(body.turn);
  // Rows that end are removed first: a row that stays is then not moved, which would take its focus.
  const keys = new Set(items.map(({ item }) => item.key));
  for (const row of [...body.rows].filter((row) => !keys.has(row.dataset.row))) {
    watch.unobserve(row);
    row.remove();
  }
  const known = new Map([...body.rows].map((row) => [row.dataset.row, row]));
  let place = body.firstElementChild;
  const waiting = [];
  for (const { item, index } of items) {
    let row = known.get(item.key);
    const [described, fill] = item.gap ? [item, fillGap] : [describe(item), fillItem];
    const shown = JSON.stringify(described);
    const isNew = !row;
    if (isNew) {
      row = make('tr');
      row.dataset.row = item.key;
      watch.observe(row);
    }
    const number = index === undefined ? null : String(index + 2);
    if (row.ariaRowIndex !== number) row.ariaRowIndex = number;
    row.due = undefined;
    if (row.shown !== shown) {
      const change = () => {
        row.due = undefined;
        fill(row, described);
        row.shown = shown;
      };
      if (isNew || item.gap || !hidden.has(row)) change();
      else {
        row.due = change;
        waiting.push(row);
      }
    }
    if (row === place) place = place.nextElementSibling;
    else body.insertBefore(row, place);
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
