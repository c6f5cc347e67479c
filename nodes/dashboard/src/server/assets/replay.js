// The playback bar of a recording: the shown instant, and controls for seeking. All clients show
// the same instant: the page sends commands to its server, and shows the server's state.

import { byId, clock, make, setText, readable } from './dom.js';
import { announce } from './status.js';

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16, 32];
const GLYPHS = { coordinator: '◆', completed: '✓', ended: '✕' };
const STEP = 5000;
const SMALL = 1000;

let recording;
let built;
let held = false;
let seeks;
let seeked = false;
let now = () => 0;

/** Shows the state of the recording; there is no bar without a recording. */
export function update(connection) {
  recording = connection.model.recording;
  byId('replay').hidden = !recording;
  document.body.classList.toggle('recorded', Boolean(recording));
  if (!recording) return;
  now = connection.now;
  if (seeks !== recording.seeks) {
    seeked = seeks !== undefined;
    seeks = recording.seeks;
  }
  const name = `${recording.from_ms}-${recording.to_ms}`;
  if (built !== name) {
    built = name;
    build(connection.model.fleet);
  }
  // Before the first election of the recording there is no coordinator.
  if (!connection.model.coordinator) setText(byId('coordinator'), 'none yet');
  setText(byId('replay-play'), recording.playing ? 'Pause' : 'Play');
  const speed = byId('replay-speed');
  if (document.activeElement !== speed) {
    if (![...speed.options].some((entry) => Number(entry.value) === recording.speed)) speed.append(option(recording.speed));
    speed.value = String(recording.speed);
  }
  place();
}

/** Returns true after a seek since the last call. */
export function hasSeeked() {
  const result = seeked;
  seeked = false;
  return result;
}

/** Updates the bar as time passes. */
export function tick(connection) {
  if (!recording) return;
  const badge = byId('connection');
  if (connection.state === 'open' && badge.textContent === 'live') {
    badge.className = 'state wait';
    setText(badge, 'recording');
  }
  place();
}

const bounded = (ms) => Math.min(Math.max(ms, recording.from_ms), recording.to_ms);

const duration = (ms) => {
  const s = Math.floor(ms / 1000);
  const two = (number) => String(number).padStart(2, '0');
  return s >= 3600 ? `${Math.floor(s / 3600)}:${two(Math.floor(s / 60) % 60)}:${two(s % 60)}` : `${Math.floor(s / 60)}:${two(s % 60)}`;
};

/** Shows the position on the bar. */
function place() {
  const slider = byId('replay-slider');
  const shown = held ? recording.from_ms + Number(slider.value) : bounded(now());
  const [into, whole] = [duration(shown - recording.from_ms), duration(recording.to_ms - recording.from_ms)];
  if (!held) slider.value = String(Math.round(shown - recording.from_ms));
  const text = `${clock(shown)}, ${into} of ${whole}`;
  if (slider.getAttribute('aria-valuetext') !== text) slider.setAttribute('aria-valuetext', text);
  setText(byId('replay-at'), `${clock(shown)} · ${into} / ${whole}`);
}

const option = (speed) => make('option', { value: String(speed) }, `${speed} ×`);

function build(fleet) {
  const { from_ms: from, to_ms: to, marks = [], damage } = recording;
  const begun = new Date(from).toLocaleString([], { dateStyle: 'long', timeStyle: 'medium', hour12: false });
  const head = make('h2', { id: 'replay-head' }, `Recording of ${fleet}, begun on ${begun} `, make('span', { className: 'muted' }, `${duration(to - from)} long; a recorded fleet accepts no requests `));
  if (damage) head.append(make('span', { className: 'cut' }, `Incomplete: ${damage}.`));
  const button = (id, text, label, onclick) => make('button', { type: 'button', id, onclick, title: label, 'aria-label': label }, text);
  const keys = make(
    'div',
    { className: 'keys' },
    make('button', { type: 'button', id: 'replay-play', className: 'primary', onclick: toggle, title: 'Space' }, 'Pause'),
    button('replay-before', '◂◆', 'To the previous mark', () => seekToMark(-1)),
    button('replay-next', '◆▸', 'To the next mark', () => seekToMark(1)),
  );
  const slider = make('input', { type: 'range', id: 'replay-slider', min: '0', max: String(Math.max(to - from, 1)), step: '1', 'aria-label': 'Time in the recording' });
  slider.oninput = () => {
    held = true;
    place();
    send({ at_ms: from + Number(slider.value) });
  };
  slider.onchange = () => { held = false; };
  const shown = marks.map((mark) => {
    const item = make('li', { className: mark.kind, title: spoken(mark), onclick: () => seekTo(mark.at_ms) }, GLYPHS[mark.kind]);
    item.style.left = `${((mark.at_ms - from) / Math.max(to - from, 1)) * 100}%`;
    return item;
  });
  // The marks are for the pointer. For screen readers, the two buttons seek between marks and
  // announce them.
  const track = make('div', { className: 'track' }, make('ul', { className: 'marks', 'aria-hidden': 'true' }, shown), slider);
  const speed = make('select', { id: 'replay-speed' }, SPEEDS.map(option));
  speed.onchange = () => send({ speed: Number(speed.value) });
  const when = make('div', { className: 'when' }, make('span', { id: 'replay-at' }), make('label', {}, 'Speed', speed));
  byId('replay').replaceChildren(head, keys, track, when);
  document.onkeydown = press;
}

const spoken = (mark) => `${readable(mark.text)}, at ${duration(mark.at_ms - recording.from_ms)}`;

const toggle = () => send({ playing: !recording.playing });

let aimed = { ms: 0, at: -Infinity };

/** Returns the shown instant, or the target of a pending seek, so that key presses accumulate. */
const at = () => (performance.now() - aimed.at < 300 ? aimed.ms : now());

const seekTo = (ms) => {
  aimed = { ms: Math.round(bounded(ms)), at: performance.now() };
  return send({ at_ms: aimed.ms });
};

function seekToMark(direction) {
  const marks = recording.marks ?? [];
  const from = at();
  // While playing, a mark that has just passed does not count as the previous mark.
  const mark = direction > 0 ? marks.find((entry) => entry.at_ms > from) : marks.findLast((entry) => entry.at_ms < from - (recording.playing ? 1500 : 0));
  announce(mark ? spoken(mark) : direction > 0 ? 'No mark after this' : 'No mark before this');
  seekTo(mark?.at_ms ?? (direction > 0 ? recording.to_ms : recording.from_ms));
}

/** Handles keys, unless the focused element handles them. */
function press(event) {
  if (!recording || event.ctrlKey || event.altKey || event.metaKey || byId('submit').open) return;
  const on = event.target;
  const slider = on.id === 'replay-slider';
  if (!slider && on.closest('input, select, textarea, [role="tab"]')) return;
  const busy = on.closest('button, a, summary, [tabindex="0"]');
  const by = event.shiftKey ? SMALL : STEP;
  const act = {
    ' ': busy && !slider ? undefined : toggle,
    ArrowLeft: () => seekTo(at() - by),
    ArrowRight: () => seekTo(at() + by),
    Home: () => seekTo(recording.from_ms),
    End: () => seekTo(recording.to_ms),
    ',': () => seekToMark(-1),
    '.': () => seekToMark(1),
  }[event.key];
  // Scrolling elements keep Home and End.
  if (!act || (busy && !slider && ['Home', 'End'].includes(event.key))) return;
  event.preventDefault();
  act();
}

let sending = false;
let waiting;

/**
 * Sends commands to the server sequentially, and of waiting commands only the last of each kind.
 */
async function send(command) {
  waiting = { ...waiting, ...command };
  if (sending) return;
  sending = true;
  while (waiting) {
    const body = JSON.stringify(waiting);
    waiting = undefined;
    try {
      const reply = await fetch('/api/replay', { method: 'POST', headers: { 'content-type': 'application/json' }, body });
      if (!reply.ok) announce((await reply.json()).error);
    } catch {
      announce('The server of this recording does not reply.');
    }
  }
  sending = false;
}
