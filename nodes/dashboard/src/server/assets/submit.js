// Submitting, canceling and resolving missions.

import { confirmAndSend } from './action.js';
import { byId, enable, make, setText } from './dom.js';
import { addButtons, addOptions, chosenMission, givenMission, openForm, parameterFields, placesOf, sendForm, showProblem } from './mission_form.js';
import { lastKnownPlace } from './missions.js';
import { newRequest, send } from './request.js';
import { announce } from './status.js';

let places = [];
let request;
/** The chosen mission file, as the node has read it. */
let file;

export function start(onSubmitted) {
  startResolve();
  const dialog = byId('submit');
  addButtons('submit', 'Submit');
  addOptions('submit');
  byId('new-mission').onclick = () => openForm('submit', 'mission', parameters);
  byId('submit-mission').onchange = () => {
    file = undefined;
    byId('submit-file').value = '';
    parameters();
  };
  byId('submit-file').onchange = readFile;
  // A changed form is a new request; repeating the same request returns the same mission.
  byId('submit-form').oninput = () => { request = undefined; };
  byId('submit-form').onsubmit = async (event) => {
    event.preventDefault();
    showProblem('submit', '');
    const button = byId('submit-send');
    button.disabled = true;
    setText(button, 'Submitting …');
    request ??= newRequest();
    const body = { ...givenMission('submit'), request };
    if (file) body.mission = file.mission;
    const people = [...byId('submit-people').querySelectorAll('input:checked')].map((field) => field.value);
    if (file?.agents.length > 0) Object.assign(body, { name: file.name, people });
    const notBefore = byId('submit-not-before').value;
    if (notBefore) body.not_before = new Date(notBefore).toISOString();
    try {
      const { mission } = await send('POST', '/api/missions', body);
      request = undefined;
      dialog.close();
      announce(`${mission} is acknowledged`);
      onSubmitted(mission);
    } catch (problem) {
      showProblem('submit', problem.message);
    } finally {
      setText(button, 'Submit');
      enable(button);
    }
  };
}

export function setPlaces(model) {
  places = placesOf(model);
}

export const cancel = (button, id) => confirmAndSend(button, `Cancel ${id}? Its robots stop safely.`, `/api/missions/${encodeURIComponent(id)}/cancel`, {}, `${id} is canceled`);

/** Requests the name of the person who took care of robots' items, and resolves the mission. */
export function resolve(id, mission) {
  const dialog = byId('resolve');
  dialog.dataset.mission = id;
  setText(byId('resolve-head'), `Resolve ${id}`);
  setText(byId('resolve-cause'), mission.cause ?? '');
  byId('resolve-items').replaceChildren(...(mission.items ?? []).map((item) => make('li', {}, lastKnownPlace(item))));
  showProblem('resolve', '');
  dialog.showModal();
  byId('resolve-by').focus();
}

function startResolve() {
  addButtons('resolve', 'Resolve', 'Back');
  byId('resolve-form').onsubmit = (event) => {
    event.preventDefault();
    const { mission } = byId('resolve').dataset;
    sendForm('resolve', `/api/missions/${encodeURIComponent(mission)}/resolve`, { by: byId('resolve-by').value }, `${mission} is resolved`);
  };
}

/** Lets the node read the chosen file, and shows its parameters and agents, or what is wrong. */
async function readFile() {
  const [chosen] = byId('submit-file').files;
  file = undefined;
  request = undefined;
  showProblem('submit', '');
  if (chosen) {
    try {
      file = await send('POST', '/api/mission-file', { name: chosen.name, text: await chosen.text() });
    } catch (problem) {
      byId('submit-file').value = '';
      showProblem('submit', problem.message);
    }
  }
  parameters();
}

function parameters() {
  const chosen = file ?? chosenMission('submit');
  byId('submit-mission').disabled = file !== undefined;
  const agents = (file?.agents ?? []).map((agent) =>
    make('label', { className: 'field' }, make('input', { type: 'checkbox', value: agent }), ` ${agent}`));
  byId('submit-people').hidden = agents.length === 0;
  byId('submit-people').replaceChildren(byId('submit-people').firstElementChild, ...agents);
  setText(byId('submit-title'), chosen?.title ?? '');
  byId('submit-parameters').replaceChildren(...parameterFields(chosen?.parameters ?? {}, places));
}
