// Actions of a person that need a confirmation.

import { enable } from './dom.js';
import { send } from './request.js';
import { announce } from './status.js';

/**
 * Asks `question`, and sends a request if the answer is yes. `done` announces its success, or is a function that returns
 * the announcement for a reply and throws what was not done.
 */
export async function confirmAndSend(button, question, path, value, done) {
  if (!confirm(question)) return;
  button.disabled = true;
  try {
    const reply = await send('POST', path, value);
    announce(typeof done === 'function' ? done(reply) : done);
  } catch (problem) {
    announce(problem.message);
    alert(problem.message);
  } finally {
    enable(button);
  }
}
