//! Where a scenario is played: first settings, then a world, and a fleet in it from when one is needed.

use super::event_text;
use super::scenario_setup::ScenarioSetup;
use super::step_arguments::StepArguments;
use super::step_pattern::{ActionFn, ActionFuture, StepFailure, StepResult};
use super::step_registry::{FactCheck, StepMeaning};
use crate::Fleet;
use crate::fleet::FleetSetup;
use consort_protocol::ids::{MissionId, RobotId};
use consort_protocol::units::WorldTime;
use consort_sim::world::{LoggedEvent, SharedWorld, World};
use consort_skills::actions::{GoalId, RobotBackend};
use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

/// How long `When the fleet runs until …` waits, in seconds of world time.
const PATIENCE_S: f64 = 3600.0;

/// How long time may pass without a look, in seconds of world time.
const LOOK_S: f64 = 0.5;

/// Where a scenario is played.
pub(super) struct Fixture {
    pub(super) setup: ScenarioSetup,
    play: Option<RunningScenario>,
    /// What will be done once something is so.
    plans: Vec<Plan>,
    /// Missions by their requests' names, in the order in which they were asked for.
    pub(super) missions: Vec<(String, MissionId)>,
    /// The latest request that was refused.
    pub(super) refused: Option<RefusedRequest>,
    /// The latest goal that the scenario itself gave a body, by robot.
    pub(super) goals: BTreeMap<RobotId, (GoalId, f64)>,
    /// Who coordinated before the latest deed against a coordinator.
    pub(super) former_coordinator: Option<String>,
    /// Nodes that the scenario ended.
    pub(super) stopped_nodes: Vec<String>,
}

/// A request that was refused.
pub(super) struct RefusedRequest {
    pub(super) request: String,
    pub(super) why: String,
    /// Whether the scenario has asked about it: one that it did not expect fails it.
    pub(super) checked: Cell<bool>,
}

impl RefusedRequest {
    /// What to say where nobody has reckoned with it.
    pub(super) fn unchecked_text(&self) -> Option<String> {
        (!self.checked.get()).then(|| format!("{} was refused: {}", self.request, self.why))
    }
}

/// What is played.
pub(super) struct RunningScenario {
    pub(super) world: SharedWorld,
    /// Nodes, from when one was needed.
    pub(super) fleet: Option<Fleet>,
    /// What happened in the world before there were nodes.
    journal: Vec<LoggedEvent>,
    /// World time at which the nodes were started.
    nodes_since_s: f64,
}

struct Plan {
    deed: ActionFn,
    said: StepArguments,
    once: FactCheck,
}

impl Fixture {
    /// Nothing but what a scenario begins with.
    pub(super) fn new(folder: PathBuf, seed: u64) -> Fixture {
        Fixture {
            setup: ScenarioSetup::new(folder, seed),
            play: None,
            plans: vec![],
            missions: vec![],
            refused: None,
            goals: BTreeMap::new(),
            former_coordinator: None,
            stopped_nodes: vec![],
        }
    }

    /// Does what a step means.
    pub(super) async fn perform(&mut self, meaning: StepMeaning) -> StepResult {
        match meaning {
            StepMeaning::Configure(setting, said) => {
                if self.play.is_some() {
                    return Err(StepFailure::invalid(
                        "it has begun already: what there is must be said before the first When",
                    ));
                }
                setting(&mut self.setup, &said)
            }
            StepMeaning::DoWhen(deed, said, once) => {
                self.plans.push(Plan { deed, said, once: *once });
                Ok(())
            }
            StepMeaning::DoNow(deed, said) => {
                self.ensure_world()?;
                deed(self, &said).await
            }
            StepMeaning::WaitUntil(look) => {
                self.start_nodes().await?;
                self.within(PATIENCE_S, &look).await
            }
            StepMeaning::Holds(look) => {
                self.ensure_world()?;
                self.look(&look)
            }
            StepMeaning::DoesNotHold(look) => {
                self.ensure_world()?;
                self.not(&look)
            }
            StepMeaning::HoldsWithin(seconds, look) => self.within(seconds, &look).await,
            StepMeaning::HoldsFor(seconds, look) => {
                self.advance(seconds, |stage| stage.look(&look).map(|()| false)).await.map(drop)?;
                self.look(&look)
            }
            StepMeaning::NeverHolds(seconds, look) => {
                self.advance(seconds, |stage| stage.not(&look).map(|()| false)).await.map(drop)?;
                self.not(&look)
            }
        }
    }

    fn look(&self, look: &FactCheck) -> StepResult {
        (look.fact)(self, &look.arguments)
    }

    fn not(&self, look: &FactCheck) -> StepResult {
        match self.look(look) {
            Ok(()) => Err(StepFailure::NotMet("it is so".to_owned())),
            Err(StepFailure::NotMet(_)) => Ok(()),
            Err(nonsense) => Err(nonsense),
        }
    }

    async fn within(&mut self, seconds: f64, look: &FactCheck) -> StepResult {
        let holds = |stage: &Fixture| match stage.look(look) {
            Ok(()) => Ok(true),
            Err(StepFailure::NotMet(_)) => Ok(false),
            Err(nonsense) => Err(nonsense),
        };
        if self.advance(seconds, holds).await? {
            return Ok(());
        }
        self.look(look)
    }

    /// Makes a world of the settings, unless there is one.
    pub(super) fn ensure_world(&mut self) -> Result<(), StepFailure> {
        if self.play.is_none() {
            let (world, journal) = (self.setup.world()?, vec![]);
            self.play = Some(RunningScenario { world, fleet: None, journal, nodes_since_s: 0.0 });
        }
        Ok(())
    }

    /// What is played.
    pub(super) fn running(&self) -> &RunningScenario {
        self.play.as_ref().expect("it was opened before anything is looked at")
    }

    /// The world, to look at or to change.
    pub(super) fn with_world<T>(&self, look: impl FnOnce(&mut World) -> T) -> T {
        self.running().world.with(look)
    }

    /// The fleet, to look at.
    pub(super) fn fleet(&self) -> Result<&Fleet, StepFailure> {
        let none = "no node runs: nobody has asked the fleet for anything yet, or let it run";
        self.running().fleet.as_ref().ok_or_else(|| StepFailure::Invalid(none.to_owned()))
    }

    /// The fleet, with all its nodes started, if they were not.
    pub(super) async fn ensure_fleet(&mut self) -> Result<&mut Fleet, StepFailure> {
        self.ensure_world()?;
        let play = self.play.as_mut().expect("just opened");
        if play.fleet.is_none() {
            if let Some(robot) = self.goals.keys().next() {
                let what = format!("{robot} was told by the scenario what to do: its node would call that off");
                return Err(StepFailure::Invalid(what));
            }
            let members: Vec<_> = self.setup.robots.iter().map(|part| part.setup.clone()).collect();
            if members.is_empty() && self.setup.stations.is_empty() {
                return Err(StepFailure::invalid("there are no robots and no stations, so there is no fleet"));
            }
            let mut skills: Vec<String> = members.iter().flat_map(|member| member.skills.clone()).collect();
            skills.sort_unstable();
            skills.dedup();
            if skills.is_empty() {
                skills.push("navigation".to_owned());
            }
            let staging = FleetSetup {
                seed: self.setup.seed,
                members,
                stations: self.setup.stations.clone(),
                world: play.world.clone(),
                speed: self.setup.speed,
                skills,
                adjust: Box::new(|_| ()),
                closed: false,
            };
            play.nodes_since_s = play.world.now().as_secs();
            play.fleet = Some(Fleet::from_setup(staging).await);
        }
        Ok(play.fleet.as_mut().expect("just started"))
    }

    /// Starts the nodes, if there are any to be started: robots that the scenario itself tells what to do have none.
    pub(super) async fn start_nodes(&mut self) -> Result<(), StepFailure> {
        let any = !self.setup.robots.is_empty() || !self.setup.stations.is_empty();
        if any && self.goals.is_empty() { self.ensure_fleet().await.map(drop) } else { self.ensure_world() }
    }

    /// How long the world has run, in seconds.
    pub(super) fn now_s(&self) -> f64 {
        let Some(play) = &self.play else { return 0.0 };
        match &play.fleet {
            Some(fleet) => play.nodes_since_s + fleet.elapsed().as_secs_f64() * self.setup.speed,
            None => play.world.now().as_secs(),
        }
    }

    /// What happened in the world, in order.
    pub(super) fn journal(&self) -> impl Iterator<Item = &LoggedEvent> {
        let play = self.running();
        play.journal.iter().chain(play.fleet.iter().flat_map(Fleet::journal))
    }

    /// Lets time pass, at most so many seconds, until `done` says so; does what was arranged when its time has come. Whether it
    /// was `done`.
    pub(super) async fn advance(
        &mut self,
        seconds: f64,
        mut done: impl FnMut(&Fixture) -> Result<bool, StepFailure>,
    ) -> Result<bool, StepFailure> {
        self.ensure_world()?;
        let end = self.now_s() + seconds;
        loop {
            self.carry_out_plans().await?;
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
        let play = self.play.as_mut().expect("it was opened");
        match &mut play.fleet {
            Some(fleet) => fleet.step(Duration::from_secs_f64((left_s / speed).min(LOOK_S / speed))).await,
            None => {
                let now = play.world.now().as_secs();
                let due = play.world.next_due().map_or(f64::MAX, |due| due.as_secs());
                play.world.advance(WorldTime::from_secs(due.min(now + left_s.min(LOOK_S)).max(now)));
                play.journal.extend(play.world.with(World::drain_event_log));
            }
        }
    }

    async fn carry_out_plans(&mut self) -> Result<(), StepFailure> {
        for index in (0..self.plans.len()).rev() {
            match self.look(&self.plans[index].once) {
                Ok(()) => {
                    let plan = self.plans.remove(index);
                    let doing: ActionFuture<'_> = (plan.deed)(self, &plan.said);
                    doing.await?;
                }
                Err(StepFailure::NotMet(_)) => {}
                // Of missions and nodes nothing can be said before there are any.
                Err(StepFailure::Invalid(_)) if self.missions.is_empty() => {}
                Err(StepFailure::Invalid(what)) => {
                    let what = format!("what was arranged for when {}: {what}", self.plans[index].once.text);
                    return Err(StepFailure::Invalid(what));
                }
            }
        }
        Ok(())
    }

    /// What was arranged and did not come about.
    pub(super) fn unfinished(&self) -> Option<String> {
        if let Some(unheeded) = self.refused.as_ref().and_then(RefusedRequest::unchecked_text) {
            return Some(unheeded);
        }
        let plan = self.plans.first()?;
        Some(format!("it was said what happens when {}, and that has not come about", plan.once.text))
    }

    /// The robot of a name.
    pub(super) fn robot(&self, name: &str) -> Result<RobotId, StepFailure> {
        let robots = self.running().world.robots();
        if let Some(robot) = robots.iter().find(|robot| robot.as_str() == name) {
            return Ok(robot.clone());
        }
        let known: Vec<&str> = robots.iter().map(RobotId::as_str).collect();
        Err(StepFailure::Invalid(format!("there is no robot {name}; there are: {}", known.join(", "))))
    }

    /// The mission that is meant: `the mission` is the one that was asked for last.
    pub(super) fn mission(&self, meant: &str) -> Result<MissionId, StepFailure> {
        let name = meant.strip_prefix("mission ");
        let mut asked = self.missions.iter().rev();
        let found = asked.find(|(request, _)| name.is_none_or(|name| name == request));
        let known: Vec<&str> = self.missions.iter().map(|(request, _)| request.as_str()).collect();
        if let Some(unheeded) = self.refused.as_ref().and_then(RefusedRequest::unchecked_text) {
            return Err(StepFailure::Invalid(unheeded));
        }
        found.map(|(_, mission)| mission.clone()).ok_or_else(|| {
            let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
            StepFailure::Invalid(format!("{meant} was not asked for; asked for: {known}"))
        })
    }

    /// What happened so far, a line each; the same several times in succession in one.
    pub(super) fn event_text(&self) -> Vec<String> {
        let Some(play) = &self.play else { return vec![] };
        let at = |elapsed: Duration| play.nodes_since_s + elapsed.as_secs_f64() * self.setup.speed;
        let mut lines: Vec<(f64, String)> = self
            .journal()
            .filter_map(|entry| Some((entry.time.as_secs(), event_text::world_event(&entry.event)?)))
            .collect();
        if let Some(fleet) = &play.fleet {
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
