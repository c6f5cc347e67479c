// Small helpers: elements, words for numbers, and tables that change only where something has changed.

export const byId = (id) => document.getElementById(id);

/** Makes an element: `make('p', { className: 'muted' }, 'text', child)`. Text is text, never markup. */
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

/** Sets a text if it is another one: an unchanged node costs no layout, and a screen reader hears no echo. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Replaces what is in an element, and keeps the focus on what has the same data-key as before. */
export function redraw(element, ...children) {
  const key = element.contains(document.activeElement) ? document.activeElement.dataset.key : undefined;
  const open = new Set([...element.querySelectorAll('details[open]')].map((one) => one.dataset.key));
  element.replaceChildren(...children.flat().filter(Boolean));
  for (const one of element.querySelectorAll('details')) one.open = open.has(one.dataset.key);
  if (key) [...element.querySelectorAll('[data-key]')].find((one) => one.dataset.key === key)?.focus();
}

/** Rows out of sight are brought up to date so many at a time, and after so many milliseconds the next: none is left behind. */
const [UNSEEN, NEXT] = [10, 1000];
/** Rows that are not seen now. */
const unseen = new WeakSet();
const watch = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    if (!isIntersecting) unseen.add(target);
    else if (unseen.delete(target)) target.due?.();
  }
});

/**
 * Brings the rows of a table in line with `items`, which have a `key`. `fill(row, item)` makes or changes the row's cells and
 * is called only where the item is not equal to what was shown: at once for what is seen, and in turns for the rest, so that
 * hundreds of rows never hold up the map.
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
      if (isNew || !unseen.has(row)) change();
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
  // Where it ended last time, so that each has its turn although all change all the time.
  const after = waiting.findIndex((row) => row.dataset.row === body.last) + 1;
  const inTurn = waiting.slice(after).concat(waiting.slice(0, after));
  const go = () => {
    for (const row of inTurn.splice(0, UNSEEN)) {
      row.due?.();
      body.last = row.dataset.row;
    }
    if (inTurn.length) body.turn = setTimeout(go, NEXT);
  };
  go();
}

/** Cells of a row: the first is its head. Texts or elements. A cell that would be the same stays. */
export function cells(row, head, ...others) {
  const focused = row.contains(document.activeElement);
  const next = [make('th', { scope: 'row' }, head), ...others.map((one) => (one instanceof HTMLTableCellElement ? one : make('td', {}, one)))];
  for (const [index, cell] of next.entries()) {
    const before = row.cells[index];
    if (!before) row.append(cell);
    else if (before !== cell && !before.isEqualNode(cell)) before.replaceWith(cell);
  }
  if (focused && !row.contains(document.activeElement)) row.querySelector('button')?.focus();
}

export const numberCell = (...children) => make('td', { className: 'number' }, ...children);

/** A length of time in words, short. */
export function span(ms) {
  if (ms === undefined || ms === null) return '–';
  if (ms < 0) ms = 0;
  if (ms < 1000) return `${Math.round(ms)} ms`;
  const s = ms / 1000;
  if (s < 60) return `${s.toFixed(s < 10 ? 1 : 0)} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min ${Math.floor(s % 60)} s`;
  return `${Math.floor(s / 3600)} h ${Math.floor((s % 3600) / 60)} min`;
}

/** An age: whole seconds, so that it does not flicker. */
export const age = (ms) => (ms < 1000 ? 'now' : span(Math.floor(ms / 1000) * 1000).replace('.0', ''));

/** An element whose text is the age of an instant, kept up to date by `tickAges`. */
export const since = (instant, before = '', after = '') => {
  const element = make('span', {});
  Object.assign(element.dataset, { since: instant, before, after });
  return element;
};

/** Ages that are seen change each second; those out of sight in turns. */
let round = 0;
export function tickAges(now) {
  round += 1;
  for (const [index, one] of document.querySelectorAll('[data-since]').entries()) {
    if (one.textContent && unseen.has(one.closest('tr')) && (index + round) % 8) continue;
    say(one, one.dataset.before + age(now - Number(one.dataset.since)) + one.dataset.after);
  }
}

export const clock = (ms) => new Date(ms).toLocaleTimeString([], { hour: '2-digit', minute: '2-digit', second: '2-digit', hour12: false });

export const percent = (share, digits = 0) => `${(share * 100).toFixed(digits)} %`;

export const words = (text) => (text ?? '').replaceAll('_', ' ');

/** A state: a dot and a word, so that nothing is told by colour alone. */
export const state = (kind, text) => make('span', { className: `state ${kind}` }, text);

/** A bar with its number beside it. */
export function meter(share, text, kind = '') {
  const bar = make('b');
  bar.style.width = `${Math.min(Math.max(share, 0), 1) * 100}%`;
  return make('span', { className: `meter ${kind}` }, make('i', { 'aria-hidden': 'true' }, bar), text);
}
