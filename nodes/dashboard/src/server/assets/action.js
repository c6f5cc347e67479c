// Actions of a person that need a confirmation.

import { enable } from './dom.js';
import { send } from './request.js';
import { announce } from './status.js';

/** Asks `question`, and sends a request if the answer is yes. `done` announces its success. */
export async function confirmAndSend(button, question, path, value, done) {
  if (!confirm(question)) return;
  button.disabled = true;
  try {
    await send('POST', path, value);
    announce(done);
  } catch (problem) {
    announce(problem.message);
    alert(problem.message);
  } finally {
    enable(button);
  }
}
