// What has changed is drawn, once for each frame of the browser, and only the panel that is open.

import * as auctions from './auctions.js';
import { byId, tickAges } from './dom.js';
import * as fleet from './fleet.js';
import { open } from './line.js';
import * as log from './log.js';
import * as map from './map.js';
import * as missions from './missions.js';
import * as replay from './replay.js';
import * as robots from './robots.js';
import * as schedule from './schedule.js';
import * as session from './session.js';
import * as status from './status.js';
import * as submit from './submit.js';
import * as tabs from './tabs.js';
import * as theme from './theme.js';

/** Tables are brought up to date this often at most, in milliseconds: nobody reads faster. */
const TABLES = 400;

const chosen = { robot: undefined, mission: undefined };
const dirty = new Set();
let waiting = false;
let drawnAt = 0;

const chooseRobot = (robot) => {
  chosen.robot = chosen.robot === robot ? undefined : robot;
  map.choose(chosen.robot);
  touch('robots');
};

const chooseMission = (mission) => {
  chosen.mission = mission;
  touch('missions');
};

const line = open({
  onChange: (picture, patch) => {
    replay.update(line);
    if (!patch || patch.map) submit.setPlaces(picture);
    if (!patch || patch.robots || patch.people || patch.doors || patch.map) map.update(picture, patch);
    touch(...(patch ? Object.keys(patch) : Object.keys(picture)));
  },
  onLine: () => tick(),
  ready: session.admitted,
});

function touch(...sections) {
  for (const section of sections) dirty.add(section);
  if (waiting || !line.picture) return;
  waiting = true;
  setTimeout(() => requestAnimationFrame(draw), Math.max(0, drawnAt + TABLES - performance.now()));
}

const isOpen = (panel) => !byId(`panel-${panel}`).hidden;

function draw() {
  waiting = false;
  drawnAt = performance.now();
  const { picture } = line;
  const any = (...sections) => sections.some((section) => dirty.has(section));
  status.update(picture);
  if (any('log')) log.alarms(picture, replay.hasJumped());
  if (any('robots', 'people', 'doors')) robots.update(picture, chosen.robot, chooseRobot);
  if ((isOpen('missions') || isOpen('history')) && any('missions')) {
    missions.update(picture, line.now(), { mission: chosen.mission, choose: chooseMission, cancel: submit.cancel, rescue: submit.rescue });
    dirty.delete('missions');
  }
  if (isOpen('schedule') && any('missions', 'robots')) schedule.update(picture, line.now());
  if (isOpen('auctions') && any('auctions')) auctions.update(picture);
  if (isOpen('ensembles') && any('ensembles', 'nodes')) fleet.ensembles(picture);
  if (isOpen('coordination') && any('coordinator', 'takeovers', 'nodes', 'health')) fleet.coordination(picture);
  if (isOpen('log') && any('log')) log.update(picture);
  dirty.clear();
  tick();
}

function tick() {
  status.tick(line);
  replay.tick(line);
  map.setStale(document.body.classList.contains('stale'));
  tickAges(line.now());
}

/** What is opened shows how things are now, and not for a moment how they were when it was closed. */
const showAll = () => {
  if (!line.picture) return;
  for (const section of Object.keys(line.picture)) dirty.add(section);
  draw();
};

theme.start(() => map.repaint());
tabs.start(showAll);
map.start(chooseRobot);
auctions.start(showAll);
log.start(showAll);
const openMission = (mission) => {
  chosen.mission = mission;
  byId('tab-missions').click();
};
schedule.start(showAll, (mission) => {
  openMission(mission);
  byId('mission').focus();
});
submit.start(openMission);
byId('health').onclick = () => byId('tab-coordination').click();
setInterval(() => {
  tick();
  // A chart grows although nothing is heard.
  if (line.picture && (isOpen('missions') || isOpen('schedule')) && !document.body.classList.contains('stale')) touch('missions');
}, 1000);

// For tests: what the page knows, and how well it draws.
window.consort = { line, drawn: map.drawn };
