//! Fixture of a scenario: first the settings, then a world, and a fleet once a step needs it.

use super::event_text;
use super::scenario_setup::ScenarioSetup;
use super::step_result::{StepFailure, StepResult};
use crate::Fleet;
use crate::fleet::{FleetSetup, NodeOptions};
use crate::ward::logistics;
use consort_protocol::ids::{MissionId, RobotId};
use consort_protocol::units::WorldTime;
use consort_skills::actions::{GoalId, RobotBackend};
use consort_skills::extensions::Extensions;
use consort_world::SharedWorld;
use consort_world::world::{LoggedEvent, World};
use futures::future::LocalBoxFuture;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

/// Longest time between two checks, in seconds of world time.
const CHECK_INTERVAL_S: f64 = 0.5;

/// Fixture of a scenario.
pub struct Fixture {
    pub(super) setup: ScenarioSetup,
    running: Option<RunningScenario>,
    planned: Vec<PlannedAction>,
    /// Missions with the names of their requests, in the order of the requests.
    pub(super) missions: Vec<(String, MissionId)>,
    /// The latest rejected request.
    pub(super) refused: Option<RefusedRequest>,
    /// The latest goal that the scenario sent to a robot, with its start time, by robot.
    pub(super) goals: BTreeMap<RobotId, (GoalId, f64)>,
    /// Coordinator before the latest action against a coordinator.
    pub(super) former_coordinator: Option<String>,
    /// Nodes that the scenario stopped.
    pub(super) stopped_nodes: Vec<String>,
}

/// A rejected request.
pub(super) struct RefusedRequest {
    pub(super) request: String,
    pub(super) why: String,
    /// A step of the scenario has checked the rejection. An unchecked rejection fails the scenario.
    pub(super) checked: Cell<bool>,
}

impl RefusedRequest {
    /// Returns the failure text of an unchecked rejection.
    pub(super) fn unchecked_text(&self) -> Option<String> {
        (!self.checked.get()).then(|| format!("{} was refused: {}", self.request, self.why))
    }
}

/// World and fleet of a running scenario.
pub(super) struct RunningScenario {
    pub(super) world: SharedWorld,
    /// The nodes, once a step needed them.
    pub(super) fleet: Option<Fleet>,
    /// World events before the start of the nodes.
    journal: Vec<LoggedEvent>,
    /// World time at the start of the nodes.
    nodes_since_s: f64,
}

type PlannedFn = Box<dyn for<'a> FnOnce(&'a mut Fixture) -> LocalBoxFuture<'a, StepResult>>;

/// Action that is executed once a fact holds.
pub(super) struct PlannedAction {
    /// Text of the fact.
    pub(super) fact: String,
    /// Checks the fact.
    pub(super) check: Box<dyn Fn(&Fixture) -> StepResult>,
    /// Executes the action.
    pub(super) execute: PlannedFn,
}

impl Fixture {
    /// Creates the fixture of an empty scenario.
    pub(super) fn new(folder: PathBuf, seed: u64, extensions: Extensions) -> Fixture {
        Fixture {
            setup: ScenarioSetup::new(folder, seed, extensions),
            running: None,
            planned: vec![],
            missions: vec![],
            refused: None,
            goals: BTreeMap::new(),
            former_coordinator: None,
            stopped_nodes: vec![],
        }
    }

    /// Plans an action for the moment at which a fact holds.
    pub(super) fn plan(&mut self, action: PlannedAction) {
        self.planned.push(action);
    }

    /// Returns whether the world exists: its settings cannot change any more.
    pub(super) fn has_begun(&self) -> bool {
        self.running.is_some()
    }

    /// Creates the world from the settings, if it does not exist.
    pub(super) fn ensure_world(&mut self) -> Result<(), StepFailure> {
        if self.running.is_none() {
            let (world, journal) = (self.setup.world()?, vec![]);
            self.running = Some(RunningScenario { world, fleet: None, journal, nodes_since_s: 0.0 });
        }
        Ok(())
    }

    /// Returns the running scenario.
    pub(super) fn running(&self) -> &RunningScenario {
        self.running.as_ref().expect("the world is created before any check")
    }

    /// Calls a function with the world.
    ///
    /// # Panics
    /// In a setting: the world is created after all settings.
    pub fn with_world<T>(&self, check: impl FnOnce(&mut World) -> T) -> T {
        self.running().world.with(check)
    }

    /// Returns the running fleet.
    pub(super) fn fleet(&self) -> Result<&Fleet, StepFailure> {
        let none = "no node runs: no step has sent a request to the fleet or run it yet";
        self.running().fleet.as_ref().ok_or_else(|| StepFailure::Invalid(none.to_owned()))
    }

    /// Returns the fleet and starts its nodes if necessary.
    pub(super) async fn ensure_fleet(&mut self) -> Result<&mut Fleet, StepFailure> {
        self.ensure_world()?;
        let running = self.running.as_mut().expect("created before");
        if running.fleet.is_none() {
            if let Some(robot) = self.goals.keys().next() {
                let what = format!("the scenario sent a goal to {robot}: its node would cancel that");
                return Err(StepFailure::Invalid(what));
            }
            let members: Vec<_> = self.setup.robots.iter().map(|robot| robot.setup.clone()).collect();
            if members.is_empty() && self.setup.stations.is_empty() {
                return Err(StepFailure::invalid("there are no robots and no stations, so there is no fleet"));
            }
            let ensembles = if self.setup.ensembles.is_empty() {
                let skills = members.iter().flat_map(|member| member.skills.iter().map(String::as_str));
                vec![logistics(&skills.chain(["navigation"]).collect::<Vec<_>>())]
            } else {
                self.setup.ensembles.clone()
            };
            let fleet_setup = FleetSetup {
                seed: self.setup.seed,
                members,
                stations: self.setup.stations.clone(),
                world: running.world.clone(),
                speed: self.setup.speed,
                ensembles,
                options: NodeOptions { extensions: self.setup.extensions, ..NodeOptions::default() },
            };
            running.nodes_since_s = running.world.now().as_secs();
            running.fleet = Some(Fleet::from_setup(fleet_setup).await);
        }
        Ok(running.fleet.as_mut().expect("started before"))
    }

    /// Starts the nodes, if there are any. Robots that receive goals from the scenario itself have
    /// no nodes.
    pub(super) async fn start_nodes(&mut self) -> Result<(), StepFailure> {
        let any = !self.setup.robots.is_empty() || !self.setup.stations.is_empty();
        if any && self.goals.is_empty() { self.ensure_fleet().await.map(drop) } else { self.ensure_world() }
    }

    /// Returns the run time of the world in seconds.
    pub fn now_s(&self) -> f64 {
        let Some(running) = &self.running else { return 0.0 };
        match &running.fleet {
            Some(fleet) => running.nodes_since_s + fleet.elapsed().as_secs_f64() * self.setup.speed,
            None => running.world.now().as_secs(),
        }
    }

    /// Returns the journal of the world in order.
    pub(super) fn journal(&self) -> impl Iterator<Item = &LoggedEvent> {
        let running = self.running();
        running.journal.iter().chain(running.fleet.iter().flat_map(Fleet::journal))
    }

    /// Lets at most `seconds` pass until `done` returns true, and executes planned actions when
    /// their time comes. Returns whether `done` returned true.
    pub(super) async fn advance(
        &mut self,
        seconds: f64,
        mut done: impl FnMut(&Fixture) -> Result<bool, StepFailure>,
    ) -> Result<bool, StepFailure> {
        self.ensure_world()?;
        let end = self.now_s() + seconds;
        loop {
            self.execute_due_actions().await?;
            if done(self)? {
                return Ok(true);
            }
            let left = end - self.now_s();
            if left <= 1e-6 {
                return Ok(false);
            }
            self.step(left).await;
        }
    }

    async fn step(&mut self, left_s: f64) {
        let speed = self.setup.speed;
        let running = self.running.as_mut().expect("created before");
        match &mut running.fleet {
            Some(fleet) => fleet.step(Duration::from_secs_f64((left_s / speed).min(CHECK_INTERVAL_S / speed))).await,
            None => {
                let now = running.world.now().as_secs();
                let due = running.world.next_due().map_or(f64::MAX, |due| due.as_secs());
                running.world.advance(WorldTime::from_secs(due.min(now + left_s.min(CHECK_INTERVAL_S)).max(now)));
                running.journal.extend(running.world.with(World::drain_event_log));
            }
        }
    }

    async fn execute_due_actions(&mut self) -> Result<(), StepFailure> {
        for index in (0..self.planned.len()).rev() {
            match (self.planned[index].check)(self) {
                Ok(()) => {
                    let due = self.planned.remove(index);
                    (due.execute)(self).await?;
                }
                Err(StepFailure::NotMet(_)) => {}
                // Before the first mission, a fact about missions or nodes is invalid.
                Err(StepFailure::Invalid(_)) if self.missions.is_empty() => {}
                Err(StepFailure::Invalid(reason)) => {
                    let reason = format!("an action is planned for when {}: {reason}", self.planned[index].fact);
                    return Err(StepFailure::Invalid(reason));
                }
            }
        }
        Ok(())
    }

    /// Returns the failure text of a planned action that was not executed.
    pub(super) fn unfinished(&self) -> Option<String> {
        if let Some(unchecked) = self.refused.as_ref().and_then(RefusedRequest::unchecked_text) {
            return Some(unchecked);
        }
        let planned = self.planned.first()?;
        Some(format!("an action is planned for when {}, but that has not happened", planned.fact))
    }

    /// Returns the robot of a name.
    ///
    /// # Errors
    /// [`StepFailure::Invalid`] if there is none.
    pub fn robot(&self, name: &str) -> Result<RobotId, StepFailure> {
        let robots = self.running().world.robots();
        if let Some(robot) = robots.iter().find(|robot| robot.as_str() == name) {
            return Ok(robot.clone());
        }
        let known: Vec<&str> = robots.iter().map(RobotId::as_str).collect();
        Err(StepFailure::Invalid(format!("there is no robot {name}; there are: {}", known.join(", "))))
    }

    /// Returns the named mission; `the mission` is the latest request.
    pub(super) fn mission(&self, reference: &str) -> Result<MissionId, StepFailure> {
        let name = reference.strip_prefix("mission ");
        let mut latest_first = self.missions.iter().rev();
        let found = latest_first.find(|(request, _)| name.is_none_or(|name| name == request));
        let known: Vec<&str> = self.missions.iter().map(|(request, _)| request.as_str()).collect();
        if let Some(unchecked) = self.refused.as_ref().and_then(RefusedRequest::unchecked_text) {
            return Err(StepFailure::Invalid(unchecked));
        }
        found.map(|(_, mission)| mission.clone()).ok_or_else(|| {
            let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
            StepFailure::Invalid(format!("{reference} was not requested; requested were: {known}"))
        })
    }

    /// Formats the events so far, with a line per event; repeated lines are merged with a count.
    pub(super) fn event_text(&self) -> Vec<String> {
        let Some(running) = &self.running else { return vec![] };
        let at = |elapsed: Duration| running.nodes_since_s + elapsed.as_secs_f64() * self.setup.speed;
        let mut lines: Vec<(f64, String)> = self
            .journal()
            .filter_map(|entry| Some((entry.time.as_secs(), event_text::world_event(&entry.event)?)))
            .collect();
        if let Some(fleet) = &running.fleet {
            let entries = fleet.event_log.entries();
            lines.extend(
                entries.iter().filter_map(|(when, entry)| Some((at(*when), event_text::node_observation(entry)?))),
            );
        }
        lines.sort_by(|a, b| a.0.total_cmp(&b.0));
        let runs = lines.chunk_by(|one, next| one.1 == next.1).map(|run| {
            let (time, line) = &run[0];
            let again = if run.len() > 1 { format!(" ({} times)", run.len()) } else { String::new() };
            format!("{time:8.1} s  {line}{again}")
        });
        runs.collect()
    }
}
