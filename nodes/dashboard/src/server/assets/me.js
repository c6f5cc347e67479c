// The page for people: requests of missions, answers, missions of their own, and calls for robots.

import { byId, make, setText, readable, state as mark } from './dom.js';
import { givenParameters, parameterFields, placesOf } from './mission_form.js';
import { newRequest, send as requestOnce } from './request.js';
import { admitted } from './session.js';

/** Polling interval in milliseconds, and the time without a reply after which the page says so. */
const [POLL, SILENCE] = [1500, 5000];

/** Levels of alerts: the colour, and the tones that announce a new one. An alert without a tone is not notified. */
const LEVELS = { info: { colour: 'work', tones: 0 }, warning: { colour: 'warn', tones: 1 }, urgent: { colour: 'bad', tones: 3 } };
/** Tones that announce a new request that is no alert. */
const TONES = 1;

const store = {
  get: (key) => { try { return localStorage.getItem(`consort-${key}`) ?? ''; } catch { return ''; } },
  set: (key, value) => { try { localStorage.setItem(`consort-${key}`, value); } catch { /* private window */ } },
};

let state = { requests: [], missions: [], dashboards: store.get('dashboards').split(' ').filter(Boolean) };
/** Requests that were answered here: a node that lags behind may still show them as open. */
const answered = new Set();
let known;
let repliedAt = performance.now();
let offered = [];
let places = [];

const name = () => byId('name').value.trim();
const role = () => byId('role').value;
const isOpen = (request) => request.phase.open !== undefined;
const escalatedTo = (request) => (request.escalated_at_ms ? request.escalates_to : undefined);
const isMine = (request) => role() === '' || request.role === role() || escalatedTo(request) === role();
const levelOf = ({ parameters: { level } }) => (Object.hasOwn(LEVELS, level) ? level : undefined);
const time = (ms) => new Date(ms).toLocaleTimeString([], { hour: '2-digit', minute: '2-digit' });

/** Sends a request. If the token has expired, the page first asks for another one. */
async function send(...request) {
  try {
    return await requestOnce(...request);
  } catch (problem) {
    if (problem.status === 401) {
      await signIn();
      // Another person may submit other missions.
      loadCalls().catch(() => {});
    }
    throw problem;
  }
}

async function poll() {
  const reply = await send('GET', '/api/requests').catch(() => undefined);
  try {
    if (reply) use(reply);
  } finally {
    showConnection();
    setTimeout(poll, POLL);
  }
}

function use({ requests = [], missions = [], dashboards = [] }) {
  state = { requests, missions, dashboards };
  repliedAt = performance.now();
  store.set('dashboards', dashboards.join(' '));
  draw();
}

function showConnection() {
  const silent = performance.now() - repliedAt > SILENCE;
  const status = byId('connection');
  setText(status, silent ? 'no connection' : 'connected');
  status.className = `state ${silent ? 'bad' : 'good'}`;
  byId('banner').hidden = !silent;
  document.body.classList.toggle('stale', silent);
  if (!silent) return;
  setText(byId('banner-what'), `No connection since ${time(Date.now() - (performance.now() - repliedAt))}. Your answers are not sent.`);
  const others = state.dashboards.filter((address) => URL.canParse(address) && new URL(address).origin !== location.origin);
  const list = byId('elsewhere');
  list.hidden = others.length === 0;
  if (list.children.length !== others.length) {
    list.replaceChildren(...others.map((address) => make('li', {}, make('a', { href: `${address}/me` }, `Go on at ${address}`))));
  }
}

function draw() {
  const roles = [...new Set([...state.requests.flatMap((request) => [request.role, request.escalates_to]), store.get('role')])].filter(Boolean).sort();
  const choice = byId('role');
  if (choice.dataset.roles !== roles.join(' ')) {
    choice.dataset.roles = roles.join(' ');
    const chosen = choice.value || store.get('role');
    choice.replaceChildren(make('option', { value: '' }, 'all roles'), ...roles.map((value) => make('option', { value }, readable(value))));
    choice.value = roles.includes(chosen) ? chosen : '';
  }
  for (const request of state.requests) if (!isOpen(request)) answered.delete(request.request);
  const open = state.requests.filter((request) => isOpen(request) && isMine(request) && !answered.has(request.request));
  announceNew(open);
  byId('none').hidden = open.length > 0;
  drawOpen(open);
  const closed = state.requests.filter((request) => request.phase.answered && isMine(request)).slice(0, 5);
  drawList(byId('closed'), closed.map(({ request, task, phase: { answered: { answer, by, at_ms: at } } }) =>
    [request, `${readable(task)}: ${answer} by ${by}, ${time(at)}`]));
  const isFrom = ({ by }) => by === name() || by.startsWith(`${name()}, according to `) || by.startsWith(`${name()} through `);
  const mine = state.missions.filter((mission) => name() && isFrom(mission)).reverse().slice(0, 10);
  byId('no-missions').hidden = mine.length > 0;
  drawList(byId('mine'), mine.map(({ mission, state: word, done, steps, pending_reason: why }) =>
    [mission, `${mission}: ${readable(word)}, ${done} of ${steps} steps${word === 'pending' && why ? ` – ${why}` : ''}`]));
}

/** Keeps the cards of open requests, so that a half-filled form survives a redraw. */
function drawOpen(open) {
  const list = byId('open');
  const cards = new Map([...list.children].map((card) => [card.dataset.request, card]));
  for (const request of open) {
    const card = cards.get(request.request) ?? newCard(request);
    cards.delete(request.request);
    const { postponed } = request.phase.open;
    const until = postponed ? `Put off by ${postponed.by} until ${time(postponed.until_ms)}. ` : '';
    const others = escalatedTo(request);
    const escalated = others ? `Escalated to ${readable(others)} at ${time(request.escalated_at_ms)}. ` : '';
    const expires = request.expires_at_ms ? `Expires at ${time(request.expires_at_ms)}.` : '';
    setText(card.querySelector('.when'), `Asked at ${time(request.asked_at_ms)}. ${until}${escalated}${expires}`);
    setText(card.querySelector('.where'), request.place ?? '');
    card.firstElementChild.classList.toggle('urgent', levelOf(request) === 'urgent' || Boolean(others));
    if (!card.isConnected) list.append(card);
  }
  for (const gone of cards.values()) {
    const hadFocus = gone.contains(document.activeElement);
    gone.remove();
    if (hadFocus) byId('open-head').scrollIntoView();
  }
}

function newCard(request) {
  const { request: id, task, mission, robots, parameters, form, role: of } = request;
  const level = levelOf(request);
  const isShown = ([key, value]) => value !== request.place && !(value in robots) && !(level && key === 'level');
  const shown = Object.entries(parameters).filter(isShown);
  const fields = Object.entries(form).map(([result, kind]) => field(result, kind));
  const problem = make('p', { className: 'problem', role: 'alert', hidden: true });
  const note = make('input', { autocomplete: 'off', maxLength: 200 });
  const button = (text, answer, className) => {
    const element = make('button', { type: answer === 'done' ? 'submit' : 'button', className }, text);
    if (answer !== 'done') element.onclick = () => give(answer);
    return element;
  };
  const card = make('form', { className: 'card', 'data-request': id },
    make('h3', {}, readable(task)),
    level ? make('p', { className: 'level' }, mark(LEVELS[level].colour, `Level: ${level}`)) : null,
    make('p', { className: 'where' }),
    make('p', { className: 'muted' }, `${readable(of)} – ${mission}`,
      Object.keys(robots).length > 0 ? ` – with ${Object.values(robots).join(', ')}` : ''),
    shown.length > 0 ? make('p', {}, shown.map(([key, value]) => `${readable(key)}: ${value}`).join('; ')) : null,
    make('p', { className: 'when muted' }),
    fields,
    make('label', { className: 'field' }, 'Note (optional)', note),
    problem,
    make('div', { className: 'actions' },
      button('Done', 'done', 'primary'), button('Later', 'later', ''), button('Cannot', 'cannot', ''), button('Decline', 'declined', '')));
  const item = make('li', { 'data-request': id }, card);
  card.onsubmit = (event) => {
    event.preventDefault();
    give('done');
  };
  async function give(answer) {
    problem.hidden = true;
    if (!name()) {
      byId('name').focus();
      return fail('Say who you are, at the top of the page.');
    }
    if (answer === 'done' && !card.reportValidity()) return;
    const buttons = [...card.querySelectorAll('button')];
    for (const element of buttons) element.disabled = true;
    const results = answer === 'done' ? Object.fromEntries(Object.entries(form).map(([result, kind]) => [result, valueOf(card, result, kind)])) : {};
    try {
      await send('POST', `/api/requests/${encodeURIComponent(id)}/answer`, { answer, results, note: note.value, by: name() });
      say(answer === 'later' ? `${readable(task)}: put off` : `${readable(task)}: ${answer}. Thank you.`);
      if (answer !== 'later') {
        answered.add(id);
        item.remove();
      }
    } catch (failure) {
      fail(failure.message);
    } finally {
      for (const element of buttons) element.disabled = false;
    }
  }
  function fail(text) {
    problem.hidden = false;
    setText(problem, text);
    say(text);
  }
  return item;
}

/** Creates the field of a result from its kind. */
function field(result, kind) {
  const label = readable(result);
  const word = typeof kind === 'string' ? kind : Object.keys(kind)[0];
  const range = kind[word] ?? {};
  let input;
  if (word === 'bool') {
    input = make('select', { required: true }, make('option', { value: '' }, 'choose'), make('option', { value: 'true' }, 'yes'), make('option', { value: 'false' }, 'no'));
  } else if (word === 'one_of') {
    input = make('select', { required: true }, make('option', { value: '' }, 'choose'), ...range.map((value) => make('option', { value }, value)));
  } else if (['integer', 'number', 'seconds'].includes(word)) {
    input = make('input', { type: 'number', inputMode: 'decimal', step: word === 'integer' ? '1' : 'any', required: true, autocomplete: 'off' });
    if (typeof range.minimum === 'number') input.min = range.minimum;
    if (typeof range.maximum === 'number') input.max = range.maximum;
  } else {
    input = make('input', { required: true, maxLength: 200, autocomplete: 'off' });
  }
  input.dataset.result = result;
  return make('label', { className: 'field' }, label, input);
}

function valueOf(card, result, kind) {
  const word = typeof kind === 'string' ? kind : Object.keys(kind)[0];
  const { value } = card.querySelector(`[data-result="${CSS.escape(result)}"]`);
  if (word === 'bool') return value === 'true';
  return ['integer', 'number', 'seconds'].includes(word) ? Number(value) : value;
}

function drawList(list, lines) {
  const text = JSON.stringify(lines);
  if (list.dataset.text === text) return;
  list.dataset.text = text;
  list.replaceChildren(...lines.map(([key, line]) => make('li', { 'data-key': key }, line)));
}

function say(text) {
  setText(byId('announce'), text);
}

/** Announces new requests: to screen readers, and as their level demands by a sound, and by a notification if allowed. */
function announceNew(open) {
  const ids = new Set(open.map((request) => request.request));
  const fresh = known ? open.filter((request) => !known.has(request.request)) : [];
  known = ids;
  document.title = open.length > 0 ? `(${open.length}) Requests – Consort` : 'Requests – Consort';
  const announced = fresh.map((request) => {
    const level = levelOf(request);
    const title = level ? `New request, ${level}` : 'New request';
    const body = `${readable(request.task)}${request.place ? ` at ${request.place}` : ''}`;
    const tones = level ? LEVELS[level].tones : TONES;
    if (tones > 0 && globalThis.Notification?.permission === 'granted') {
      new Notification(title, { body, tag: request.request, requireInteraction: level === 'urgent' });
    }
    return { text: `${title}: ${body}`, tones };
  });
  if (announced.length > 0) say(announced.map(({ text }) => text).join('; '));
  if (sound) beep(Math.max(0, ...announced.map(({ tones }) => tones)));
}

let sound;

function beep(tones) {
  for (let number = 0; number < tones; number += 1) {
    const tone = sound.createOscillator();
    const gain = sound.createGain();
    const start = sound.currentTime + number * 0.4;
    gain.gain.value = 0.1;
    tone.frequency.value = 880;
    tone.connect(gain).connect(sound.destination);
    tone.start(start);
    tone.stop(start + 0.25);
  }
}

byId('notify').onclick = async () => {
  // A browser plays sound only after a press.
  sound ??= new AudioContext();
  const allowed = globalThis.Notification ? await Notification.requestPermission() : 'denied';
  setText(byId('notify'), allowed === 'granted' ? 'Notified' : 'Sound only');
};

byId('call-send').disabled = true;
{
  const form = byId('call');
  let request;
  form.oninput = () => { request = undefined; };
  form.onsubmit = async (event) => {
    event.preventDefault();
    const problem = byId('call-problem');
    problem.hidden = true;
    byId('call-send').disabled = true;
    request ??= newRequest();
    const parameters = givenParameters(byId('call-parameters'));
    const body = { mission: byId('call-mission').value, request, by: name() || undefined, parameters };
    try {
      const { mission } = await send('POST', '/api/missions', body);
      request = undefined;
      say(`${mission} is acknowledged`);
    } catch (failure) {
      problem.hidden = false;
      setText(problem, failure.message);
    } finally {
      byId('call-send').disabled = false;
    }
  };
}

async function startCalls() {
  await loadCalls().catch(() => setTimeout(startCalls, POLL));
}

/** Offers the missions that this person may submit. */
async function loadCalls() {
  offered = (await send('GET', '/api/named-missions')).missions;
  places = placesOf(await send('GET', '/api/fleet'));
  byId('call').hidden = offered.length === 0;
  byId('no-calls').hidden = offered.length > 0;
  byId('call-mission').replaceChildren(...offered.map(({ mission, title }) => make('option', { value: mission, title }, readable(mission))));
  byId('call-mission').onchange = showParameters;
  showParameters();
  byId('call-send').disabled = false;
}

function showParameters() {
  const chosen = offered.find((template) => template.mission === byId('call-mission').value);
  setText(byId('call-title'), chosen?.title ?? '');
  byId('call-parameters').replaceChildren(...parameterFields(chosen?.parameters ?? {}, places));
}

for (const key of ['name', 'role']) {
  byId(key).value = store.get(key);
  byId(key).oninput = () => {
    store.set(key, byId(key).value);
    if (key === 'role') known = undefined;
    draw();
  };
}
byId('person').onsubmit = (event) => event.preventDefault();
/** Signs in, if the fleet is closed, and shows what the token permits. */
async function signIn() {
  await admitted();
  const session = await fetch('/api/session').then((reply) => reply.json()).catch(() => ({}));
  if (!session.closed) return;
  // The coordinator records the name in the token, whatever the page says.
  byId('name').value = session.name;
  byId('name').readOnly = true;
  document.body.classList.toggle('reads', session.scope === 'read');
  byId('call').closest('section').hidden = session.scope === 'read';
}

await signIn();
poll();
startCalls();
setInterval(showConnection, 1000);

// For tests.
window.consort = { state: () => state };
