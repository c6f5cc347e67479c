// The bar of a recording: which instant of it is shown, and how to go to another. All who look see the same instant: the page
// asks its server, and shows what that says.

import { byId, clock, make, say, words } from './dom.js';
import { announce } from './status.js';

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16, 32];
const GLYPHS = { coordinator: '◆', completed: '✓', ended: '✕' };
const STEP = 5000;
const SMALL = 1000;

let recording;
let built;
let held = false;
let jumps;
let jumped = false;
let now = () => 0;

/** Shows what the picture says of the recording; there is no bar if it says nothing. */
export function update(line) {
  recording = line.picture.recording;
  byId('replay').hidden = !recording;
  document.body.classList.toggle('recorded', Boolean(recording));
  if (!recording) return;
  now = line.now;
  if (jumps !== recording.jumps) {
    jumped = jumps !== undefined;
    jumps = recording.jumps;
  }
  const name = `${recording.from_ms}-${recording.to_ms}`;
  if (built !== name) {
    built = name;
    build(line.picture.fleet);
  }
  // Whoever goes back to before anybody coordinated sees nobody.
  if (!line.picture.coordinator) say(byId('coordinator'), 'not heard yet');
  say(byId('replay-play'), recording.playing ? 'Pause' : 'Play');
  const speed = byId('replay-speed');
  if (document.activeElement !== speed) {
    if (![...speed.options].some((one) => Number(one.value) === recording.speed)) speed.append(option(recording.speed));
    speed.value = String(recording.speed);
  }
  place();
}

/** Whether somebody went elsewhere since this was asked last. */
export function hasJumped() {
  const has = jumped;
  jumped = false;
  return has;
}

/** Time passes. */
export function tick(line) {
  if (!recording) return;
  const connection = byId('connection');
  if (line.state === 'open' && connection.textContent === 'live') {
    connection.className = 'state wait';
    say(connection, 'recording');
  }
  place();
}

const bounded = (ms) => Math.min(Math.max(ms, recording.from_ms), recording.to_ms);

const length = (ms) => {
  const s = Math.floor(ms / 1000);
  const two = (number) => String(number).padStart(2, '0');
  return s >= 3600 ? `${Math.floor(s / 3600)}:${two(Math.floor(s / 60) % 60)}:${two(s % 60)}` : `${Math.floor(s / 60)}:${two(s % 60)}`;
};

/** Where the recording is, on the bar. */
function place() {
  const slider = byId('replay-slider');
  const shown = held ? recording.from_ms + Number(slider.value) : bounded(now());
  const [into, whole] = [length(shown - recording.from_ms), length(recording.to_ms - recording.from_ms)];
  if (!held) slider.value = String(Math.round(shown - recording.from_ms));
  const text = `${clock(shown)}, ${into} of ${whole}`;
  if (slider.getAttribute('aria-valuetext') !== text) slider.setAttribute('aria-valuetext', text);
  say(byId('replay-at'), `${clock(shown)} · ${into} / ${whole}`);
}

const option = (speed) => make('option', { value: String(speed) }, `${speed} ×`);

function build(fleet) {
  const { from_ms: from, to_ms: to, marks = [], problem } = recording;
  const begun = new Date(from).toLocaleString([], { dateStyle: 'long', timeStyle: 'medium', hour12: false });
  const head = make('h2', { id: 'replay-head' }, `Recording of ${fleet}, begun on ${begun} `, make('span', { className: 'muted' }, `${length(to - from)} long; nothing can be asked of this fleet `));
  if (problem) head.append(make('span', { className: 'cut' }, `Not whole: ${problem}.`));
  const button = (id, text, label, onclick) => make('button', { type: 'button', id, onclick, title: label, 'aria-label': label }, text);
  const keys = make(
    'div',
    { className: 'keys' },
    make('button', { type: 'button', id: 'replay-play', className: 'primary', onclick: toggle, title: 'Space' }, 'Pause'),
    button('replay-before', '◂◆', 'To the mark before', () => toMark(-1)),
    button('replay-next', '◆▸', 'To the next mark', () => toMark(1)),
  );
  const slider = make('input', { type: 'range', id: 'replay-slider', min: '0', max: String(Math.max(to - from, 1)), step: '1', 'aria-label': 'Time in the recording' });
  slider.oninput = () => {
    held = true;
    place();
    ask({ at_ms: from + Number(slider.value) });
  };
  slider.onchange = () => { held = false; };
  const shown = marks.map((mark) => {
    const one = make('li', { className: mark.kind, title: spoken(mark), onclick: () => toTime(mark.at_ms) }, GLYPHS[mark.kind]);
    one.style.left = `${((mark.at_ms - from) / Math.max(to - from, 1)) * 100}%`;
    return one;
  });
  // The marks are for eyes and a pointer; the two buttons go from one to the next, and say what it is.
  const track = make('div', { className: 'track' }, make('ul', { className: 'marks', 'aria-hidden': 'true' }, shown), slider);
  const speed = make('select', { id: 'replay-speed' }, SPEEDS.map(option));
  speed.onchange = () => ask({ speed: Number(speed.value) });
  const when = make('div', { className: 'when' }, make('span', { id: 'replay-at' }), make('label', {}, 'Speed', speed));
  byId('replay').replaceChildren(head, keys, track, when);
  document.onkeydown = press;
}

const spoken = (mark) => `${words(mark.text)}, at ${length(mark.at_ms - recording.from_ms)}`;

const toggle = () => ask({ playing: !recording.playing });

let aimed = { ms: 0, at: -Infinity };

/** What is shown, or will be at once: whoever presses a key twice goes twice as far. */
const at = () => (performance.now() - aimed.at < 300 ? aimed.ms : now());

const toTime = (ms) => {
  aimed = { ms: Math.round(bounded(ms)), at: performance.now() };
  return ask({ at_ms: aimed.ms });
};

function toMark(direction) {
  const marks = recording.marks ?? [];
  const from = at();
  // While it plays, the mark that has just gone by is not the one before.
  const mark = direction > 0 ? marks.find((one) => one.at_ms > from) : marks.findLast((one) => one.at_ms < from - (recording.playing ? 1500 : 0));
  announce(mark ? spoken(mark) : direction > 0 ? 'No mark after this' : 'No mark before this');
  toTime(mark?.at_ms ?? (direction > 0 ? recording.to_ms : recording.from_ms));
}

/** Keys work wherever nothing else takes them. */
function press(event) {
  if (!recording || event.ctrlKey || event.altKey || event.metaKey || byId('order').open) return;
  const on = event.target;
  const slider = on.id === 'replay-slider';
  if (!slider && on.closest('input, select, textarea, [role="tab"]')) return;
  const busy = on.closest('button, a, summary, [tabindex="0"]');
  const by = event.shiftKey ? SMALL : STEP;
  const act = {
    ' ': busy && !slider ? undefined : toggle,
    ArrowLeft: () => toTime(at() - by),
    ArrowRight: () => toTime(at() + by),
    Home: () => toTime(recording.from_ms),
    End: () => toTime(recording.to_ms),
    ',': () => toMark(-1),
    '.': () => toMark(1),
  }[event.key];
  // What scrolls, scrolls.
  if (!act || (busy && !slider && ['Home', 'End'].includes(event.key))) return;
  event.preventDefault();
  act();
}

let asking = false;
let waiting;

/** Asks the server, one thing after the other; of several that wait, what was asked last of each kind. */
async function ask(command) {
  waiting = { ...waiting, ...command };
  if (asking) return;
  asking = true;
  while (waiting) {
    const body = JSON.stringify(waiting);
    waiting = undefined;
    try {
      const answer = await fetch('/api/replay', { method: 'POST', headers: { 'content-type': 'application/json' }, body });
      if (!answer.ok) announce((await answer.json()).error);
    } catch {
      announce('The server of this recording does not answer.');
    }
  }
  asking = false;
}
