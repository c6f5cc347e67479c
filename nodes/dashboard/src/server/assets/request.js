// Requests of the pages to their node.

/** Limits of a read and of a request in milliseconds. The node itself gives up on a request after 8 s. */
const [READ_LIMIT, REQUEST_LIMIT] = [4000, 12000];

/** Sends a request. Returns the reply; throws an error with a text for people, and the status of the reply. */
export async function send(method, path, value) {
  const options = { method, signal: AbortSignal.timeout(method === 'GET' ? READ_LIMIT : REQUEST_LIMIT) };
  if (value !== undefined) Object.assign(options, { body: JSON.stringify(value), headers: { 'content-type': 'application/json' } });
  let reply;
  try {
    reply = await fetch(path, options);
  } catch {
    throw new Error('This page’s node does not reply.');
  }
  const content = await reply.json().catch(() => ({}));
  if (!reply.ok) throw Object.assign(new Error(content.error ?? `The node replies with status ${reply.status}.`), { status: reply.status });
  return content;
}

/** Returns a new name for a request: a repeated request with the same name is executed once. */
export const newRequest = () => `page-${Date.now().toString(36)}-${Math.random().toString(36).slice(2, 8)}`;
