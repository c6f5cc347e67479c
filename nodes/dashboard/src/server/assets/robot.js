// The panel of the selected robot: its task with the feedback of the action in progress, its charge, and the roles that it
// gets later.

import { chargingText } from './chargers.js';
import { brief, byId, clock, note, percent, readable } from './dom.js';
import { forecastText } from './robots.js';

/** Shows a robot, or nothing. Unchanged notes stay as they are. */
export function update(model, robot) {
  const list = byId('robot-notes');
  const notes = notesOf(model.robots?.[robot]);
  const shown = JSON.stringify(notes);
  if (list.shown === shown) return;
  list.shown = shown;
  list.hidden = notes.length === 0;
  list.replaceChildren(...notes.map((values) => note(...values)));
}

/** Returns the notes of a robot: a name, and its values. */
function notesOf(robot) {
  if (!robot) return [];
  const notes = [];
  if (robot.task) notes.push(['task', `${readable(robot.task)}${robot.destination ? ` → ${robot.destination}` : ''}`]);
  for (const [name, value] of Object.entries(robot.feedback ?? {})) notes.push([`feedback: ${readable(name)}`, brief(value)]);
  const charge = [percent(robot.battery ?? 0), robot.forecast && forecastText(robot.forecast), chargingText(robot.charging ?? {})];
  notes.push(['charge', charge.filter(Boolean).join(', ')]);
  (robot.next ?? []).forEach(({ mission, role, start_ms: start }, index) => {
    notes.push([`later, ${index + 1}`, `${role} of ${mission}, planned for ${clock(start)}`]);
  });
  return notes;
}
