// Entry point: draws changed sections at most once per browser frame, and only in the open panel.

import * as alarms from './alarms.js';
import * as auctions from './auctions.js';
import * as audit from './audit.js';
import * as calendar from './calendar.js';
import * as chargers from './chargers.js';
import * as closures from './closures.js';
import { byId, tickAges } from './dom.js';
import * as fleet from './fleet.js';
import { open } from './connection.js';
import * as log from './log.js';
import * as map from './map.js';
import * as missionOrders from './mission_orders.js';
import * as missions from './missions.js';
import * as orderForm from './order_form.js';
import * as orders from './orders.js';
import * as replay from './replay.js';
import * as robot from './robot.js';
import * as robots from './robots.js';
import * as schedule from './schedule.js';
import * as session from './session.js';
import * as status from './status.js';
import * as submit from './submit.js';
import * as tabs from './tabs.js';
import * as theme from './theme.js';

/** Minimum time between table updates, in milliseconds: faster updates cannot be read. */
const TABLE_INTERVAL = 400;

/** Sections that the map shows. */
const ON_MAP = ['robots', 'people', 'doors', 'closures', 'speed_limits', 'alarms', 'zones', 'charging', 'map'];

const selected = { robot: undefined, part: undefined, mission: undefined };
const dirty = new Set();
let scheduled = false;
let drawnAt = 0;

const updateRobot = () => {
  orders.update(connection.model, selected.robot);
  robot.update(connection.model, selected.robot);
};

const selectRobot = (name, focus) => {
  selected.robot = selected.robot === name ? undefined : name;
  map.choose(selected.robot);
  updateRobot();
  if (focus) orders.focus();
  markDirty('robots');
};

const selectPart = (part) => {
  selected.part = part;
  map.choosePart(part);
  closures.update(connection.model, part);
};

const selectMission = (mission) => {
  selected.mission = mission;
  markDirty('missions');
};

const connection = open({
  onChange: (model, patch) => {
    replay.update(connection);
    if (!patch || patch.map) submit.setPlaces(model);
    if (!patch || patch.map || patch.zones) closures.setParts(model);
    if (!patch || ON_MAP.some((section) => patch[section])) map.update(model, patch);
    markDirty(...(patch ? Object.keys(patch) : Object.keys(model)));
  },
  onState: () => tick(),
  ready: session.admitted,
});

function markDirty(...sections) {
  for (const section of sections) dirty.add(section);
  if (scheduled || !connection.model) return;
  scheduled = true;
  setTimeout(() => requestAnimationFrame(draw), Math.max(0, drawnAt + TABLE_INTERVAL - performance.now()));
}

const isOpen = (panel) => !byId(`panel-${panel}`).hidden;

function draw() {
  scheduled = false;
  drawnAt = performance.now();
  const { model } = connection;
  const isDirty = (...sections) => sections.some((section) => dirty.has(section));
  status.update(model);
  missionOrders.update(model);
  if (isDirty('log')) log.alarms(model, replay.hasSeeked());
  if (isDirty('robots', 'people', 'doors')) {
    robots.update(model, selected.robot, selectRobot);
    updateRobot();
  }
  if (isDirty('robots', 'charging', 'map')) chargers.update(model);
  if (isDirty('alarms', 'declared_alarms')) alarms.update(model);
  if (isDirty('closures', 'speed_limits', 'alarms', 'zones', 'map')) closures.update(model, selected.part);
  if ((isOpen('missions') || isOpen('history')) && isDirty('missions')) {
    missions.update(model, connection.now(), { mission: selected.mission, select: selectMission, actions: { cancel: submit.cancel, resolve: submit.resolve, ...missionOrders } });
    dirty.delete('missions');
  }
  if (isOpen('schedule') && isDirty('missions', 'robots')) schedule.update(model, connection.now());
  if (isOpen('auctions') && isDirty('auctions')) auctions.update(model);
  if (isOpen('ensembles') && isDirty('ensembles', 'nodes')) fleet.ensembles(model);
  if (isOpen('coordination') && isDirty('coordinator', 'takeovers', 'nodes', 'health')) fleet.coordination(model);
  if (isOpen('calendar') && isDirty('schedules', 'map')) calendar.update(model);
  if (isOpen('log') && isDirty('log')) log.update(model);
  dirty.clear();
  tick();
}

function tick() {
  status.tick(connection);
  replay.tick(connection);
  map.setStale(document.body.classList.contains('stale'));
  tickAges(connection.now());
}

/** Redraws everything, so that an opened panel shows current data at once. */
const redrawAll = () => {
  if (!connection.model) return;
  for (const section of Object.keys(connection.model)) dirty.add(section);
  draw();
};

theme.start(() => map.repaint());
tabs.start(() => {
  redrawAll();
  if (isOpen('audit')) audit.read();
});
map.start(selectRobot, (part) => selectPart(part === selected.part ? undefined : part));
auctions.start(redrawAll);
log.start(redrawAll);
orderForm.start();
orders.start();
missionOrders.start();
alarms.start();
missions.start(() => markDirty('missions'));
closures.start(selectPart);
audit.start(() => isOpen('audit'));
const openMission = (mission) => {
  selected.mission = mission;
  byId('tab-missions').click();
};
const lookAtMission = (mission) => {
  openMission(mission);
  byId('mission').focus();
};
schedule.start(redrawAll, lookAtMission);
calendar.start(lookAtMission);
submit.start(openMission);
byId('health').onclick = () => byId('tab-coordination').click();
setInterval(() => {
  tick();
  // A chart grows even without new messages.
  if (connection.model && (isOpen('missions') || isOpen('schedule')) && !document.body.classList.contains('stale')) markDirty('missions');
}, 1000);

// For tests: the connection with its model, drawing statistics, and the positions of places on the map.
window.consort = { connection, drawStats: map.drawStats, positionOf: map.positionOf };
