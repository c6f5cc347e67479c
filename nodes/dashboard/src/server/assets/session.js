// Authentication. A closed fleet requires a token once. The browser then sends the token with each
// request, and no script can read it.

import { byId, setText } from './dom.js';
import { announce } from './status.js';

const HASH = '#token=';

/** Pending sign-in: a single promise for all callers. */
let pending;

/** Resolves when the node admits this page, or does not reply at all. */
export async function admitted() {
  let reply;
  try {
    reply = await fetch('/api/session');
  } catch {
    return;
  }
  const session = await reply.json().catch(() => ({}));
  if (reply.ok) return show(session);
  if (reply.status !== 401) return;
  pending ??= askForToken(session.error).finally(() => { pending = undefined; });
  await pending;
}

/** Requests a token until it is valid. The link to the page may contain a token. */
async function askForToken(reason) {
  const dialog = byId('admission');
  const linkToken = location.hash.startsWith(HASH) && location.hash.slice(HASH.length);
  if (linkToken) {
    history.replaceState(null, '', location.pathname + location.search);
    const problem = await signIn(linkToken);
    if (!problem) return;
    reason = problem;
  }
  setText(byId('admission-reason'), reason ?? '');
  showProblem('');
  dialog.oncancel = (event) => event.preventDefault();
  if (!dialog.open) dialog.showModal();
  byId('admission-token').focus();
  await new Promise((resolve) => {
    byId('admission-form').onsubmit = async (event) => {
      event.preventDefault();
      const send = byId('admission-send');
      send.disabled = true;
      const problem = await signIn(byId('admission-token').value);
      send.disabled = false;
      showProblem(problem ?? '');
      if (!problem) resolve();
    };
  });
  byId('admission-token').value = '';
  dialog.close();
}

/** Sends a token; returns the problem, if any. */
async function signIn(token) {
  try {
    const options = { method: 'POST', headers: { 'content-type': 'application/json' }, body: JSON.stringify({ token }) };
    const reply = await fetch('/api/session', options);
    const session = await reply.json();
    if (!reply.ok) return session.error;
    show(session);
    announce(`Signed in as ${session.name}`);
    return undefined;
  } catch {
    return 'This page’s node does not reply.';
  }
}

/** Shows the signed-in person, and only the permitted actions. */
function show({ closed, name, scope }) {
  document.body.dataset.scope = closed ? scope : 'operate';
  const out = byId('sign-out');
  out.hidden = !closed;
  setText(out, `Sign out ${name ?? ''}`);
  out.title = `may ${scope}`;
  out.onclick = async () => {
    await fetch('/api/session', { method: 'DELETE' }).catch(() => {});
    location.reload();
  };
}

function showProblem(text) {
  byId('admission-problem').hidden = !text;
  setText(byId('admission-problem'), text);
}
