// Who looks. A closed fleet asks for a token, once; the browser then shows it with each request, and no script can read it.

import { byId, say } from './dom.js';
import { announce } from './status.js';

const HASH = '#token=';

/** Waiting for whoever is to be let in: the same promise, however many ask. */
let waiting;

/** Ends when the node lets this page in, or does not answer at all. */
export async function admitted() {
  let answer;
  try {
    answer = await fetch('/api/session');
  } catch {
    return;
  }
  const said = await answer.json().catch(() => ({}));
  if (answer.ok) return show(said);
  if (answer.status !== 401) return;
  waiting ??= ask(said.error).finally(() => { waiting = undefined; });
  await waiting;
}

/** Asks for a token until there is a good one; a link may have brought it along. */
async function ask(why) {
  const dialog = byId('admission');
  const brought = location.hash.startsWith(HASH) && location.hash.slice(HASH.length);
  if (brought) {
    history.replaceState(null, '', location.pathname + location.search);
    const problem = await begin(brought);
    if (!problem) return;
    why = problem;
  }
  say(byId('admission-why'), why ?? '');
  trouble('');
  dialog.oncancel = (event) => event.preventDefault();
  if (!dialog.open) dialog.showModal();
  byId('admission-token').focus();
  await new Promise((resolve) => {
    byId('admission-form').onsubmit = async (event) => {
      event.preventDefault();
      const send = byId('admission-send');
      send.disabled = true;
      const problem = await begin(byId('admission-token').value);
      send.disabled = false;
      trouble(problem ?? '');
      if (!problem) resolve();
    };
  });
  byId('admission-token').value = '';
  dialog.close();
}

/** Hands a token over; what is wrong with it, if anything. */
async function begin(token) {
  try {
    const options = { method: 'POST', headers: { 'content-type': 'application/json' }, body: JSON.stringify({ token }) };
    const answer = await fetch('/api/session', options);
    const said = await answer.json();
    if (!answer.ok) return said.error;
    show(said);
    announce(`You are ${said.name}`);
    return undefined;
  } catch {
    return 'This page’s node does not answer.';
  }
}

/** Shows whom the node takes this page for, and only what that lets them do. */
function show({ closed, name, scope }) {
  document.body.dataset.scope = closed ? scope : 'operate';
  const out = byId('sign-out');
  out.hidden = !closed;
  say(out, `Sign out ${name ?? ''}`);
  out.title = `may ${scope}`;
  out.onclick = async () => {
    await fetch('/api/session', { method: 'DELETE' }).catch(() => {});
    location.reload();
  };
}

function trouble(text) {
  byId('admission-problem').hidden = !text;
  say(byId('admission-problem'), text);
}
