//! Where a scenario is played: first settings, then a world, and a fleet in it from when one is needed.

use super::book::{Look, Meaning};
use super::cast::Cast;
use super::phrase::{Deed, Doing, Verdict, Wrong};
use super::said::Said;
use super::story;
use crate::Fleet;
use crate::fleet::Staging;
use consort_protocol::ids::{MissionId, RobotId};
use consort_protocol::units::WorldTime;
use consort_sim::world::{JournalEntry, SharedWorld, World};
use consort_skills::actions::{BodyHost, GoalId};
use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

/// How long `When the fleet runs until …` waits, in seconds of world time.
const PATIENCE_S: f64 = 3600.0;

/// How long time may pass without a look, in seconds of world time.
const LOOK_S: f64 = 0.5;

/// Where a scenario is played.
pub(super) struct Stage {
    pub(super) cast: Cast,
    play: Option<Play>,
    /// What will be done once something is so.
    plans: Vec<Plan>,
    /// Missions by their requests' names, in the order in which they were asked for.
    pub(super) missions: Vec<(String, MissionId)>,
    /// The latest request that was refused.
    pub(super) refused: Option<Refusal>,
    /// The latest goal that the scenario itself gave a body, by robot.
    pub(super) goals: BTreeMap<RobotId, (GoalId, f64)>,
    /// Who coordinated before the latest deed against a coordinator.
    pub(super) former: Option<String>,
    /// Nodes that the scenario ended.
    pub(super) dead: Vec<String>,
}

/// A request that was refused.
pub(super) struct Refusal {
    pub(super) request: String,
    pub(super) why: String,
    /// Whether the scenario has asked about it: one that it did not expect fails it.
    pub(super) heeded: Cell<bool>,
}

impl Refusal {
    /// What to say where nobody has reckoned with it.
    pub(super) fn unheeded(&self) -> Option<String> {
        (!self.heeded.get()).then(|| format!("{} was refused: {}", self.request, self.why))
    }
}

/// What is played.
pub(super) struct Play {
    pub(super) world: SharedWorld,
    /// Nodes, from when one was needed.
    pub(super) fleet: Option<Fleet>,
    /// What happened in the world before there were nodes.
    journal: Vec<JournalEntry>,
    /// World time at which the nodes were started.
    nodes_since_s: f64,
}

struct Plan {
    deed: Deed,
    said: Said,
    once: Look,
}

impl Stage {
    /// Nothing but what a scenario begins with.
    pub(super) fn new(folder: PathBuf, seed: u64) -> Stage {
        Stage {
            cast: Cast::new(folder, seed),
            play: None,
            plans: vec![],
            missions: vec![],
            refused: None,
            goals: BTreeMap::new(),
            former: None,
            dead: vec![],
        }
    }

    /// Does what a step means.
    pub(super) async fn perform(&mut self, meaning: Meaning) -> Verdict {
        match meaning {
            Meaning::Set(setting, said) => {
                if self.play.is_some() {
                    return Err(Wrong::nonsense(
                        "it has begun already: what there is must be said before the first When",
                    ));
                }
                setting(&mut self.cast, &said)
            }
            Meaning::Arrange(deed, said, once) => {
                self.plans.push(Plan { deed, said, once: *once });
                Ok(())
            }
            Meaning::Do(deed, said) => {
                self.open()?;
                deed(self, &said).await
            }
            Meaning::Until(look) => {
                self.run().await?;
                self.within(PATIENCE_S, &look).await
            }
            Meaning::Now(look) => {
                self.open()?;
                self.look(&look)
            }
            Meaning::Not(look) => {
                self.open()?;
                self.not(&look)
            }
            Meaning::Within(seconds, look) => self.within(seconds, &look).await,
            Meaning::For(seconds, look) => {
                self.pass(seconds, |stage| stage.look(&look).map(|()| false)).await.map(drop)?;
                self.look(&look)
            }
            Meaning::Never(seconds, look) => {
                self.pass(seconds, |stage| stage.not(&look).map(|()| false)).await.map(drop)?;
                self.not(&look)
            }
        }
    }

    fn look(&self, look: &Look) -> Verdict {
        (look.fact)(self, &look.said)
    }

    fn not(&self, look: &Look) -> Verdict {
        match self.look(look) {
            Ok(()) => Err(Wrong::Instead("it is so".to_owned())),
            Err(Wrong::Instead(_)) => Ok(()),
            Err(nonsense) => Err(nonsense),
        }
    }

    async fn within(&mut self, seconds: f64, look: &Look) -> Verdict {
        let holds = |stage: &Stage| match stage.look(look) {
            Ok(()) => Ok(true),
            Err(Wrong::Instead(_)) => Ok(false),
            Err(nonsense) => Err(nonsense),
        };
        if self.pass(seconds, holds).await? {
            return Ok(());
        }
        self.look(look)
    }

    /// Makes a world of the settings, unless there is one.
    pub(super) fn open(&mut self) -> Result<(), Wrong> {
        if self.play.is_none() {
            let (world, journal) = (self.cast.world()?, vec![]);
            self.play = Some(Play { world, fleet: None, journal, nodes_since_s: 0.0 });
        }
        Ok(())
    }

    /// What is played.
    pub(super) fn play(&self) -> &Play {
        self.play.as_ref().expect("it was opened before anything is looked at")
    }

    /// The world, to look at or to change.
    pub(super) fn with_world<T>(&self, look: impl FnOnce(&mut World) -> T) -> T {
        self.play().world.with(look)
    }

    /// The fleet, to look at.
    pub(super) fn fleet(&self) -> Result<&Fleet, Wrong> {
        let none = "no node runs: nobody has asked the fleet for anything yet, or let it run";
        self.play().fleet.as_ref().ok_or_else(|| Wrong::Nonsense(none.to_owned()))
    }

    /// The fleet, with all its nodes started, if they were not.
    pub(super) async fn nodes(&mut self) -> Result<&mut Fleet, Wrong> {
        self.open()?;
        let play = self.play.as_mut().expect("just opened");
        if play.fleet.is_none() {
            if let Some(robot) = self.goals.keys().next() {
                let what = format!("{robot} was told by the scenario what to do: its node would call that off");
                return Err(Wrong::Nonsense(what));
            }
            let members: Vec<_> = self.cast.robots.iter().map(|part| part.member.clone()).collect();
            if members.is_empty() && self.cast.stations.is_empty() {
                return Err(Wrong::nonsense("there are no robots and no stations, so there is no fleet"));
            }
            let mut skills: Vec<String> = members.iter().flat_map(|member| member.skills.clone()).collect();
            skills.sort_unstable();
            skills.dedup();
            if skills.is_empty() {
                skills.push("navigation".to_owned());
            }
            let staging = Staging {
                seed: self.cast.seed,
                members,
                stations: self.cast.stations.clone(),
                world: play.world.clone(),
                speed: self.cast.speed,
                skills,
                adjust: Box::new(|_| ()),
                closed: false,
            };
            play.nodes_since_s = play.world.now().as_secs();
            play.fleet = Some(Fleet::staged(staging).await);
        }
        Ok(play.fleet.as_mut().expect("just started"))
    }

    /// Starts the nodes, if there are any to be started: robots that the scenario itself tells what to do have none.
    pub(super) async fn run(&mut self) -> Result<(), Wrong> {
        let any = !self.cast.robots.is_empty() || !self.cast.stations.is_empty();
        if any && self.goals.is_empty() { self.nodes().await.map(drop) } else { self.open() }
    }

    /// How long the world has run, in seconds.
    pub(super) fn now_s(&self) -> f64 {
        let Some(play) = &self.play else { return 0.0 };
        match &play.fleet {
            Some(fleet) => play.nodes_since_s + fleet.elapsed().as_secs_f64() * self.cast.speed,
            None => play.world.now().as_secs(),
        }
    }

    /// What happened in the world, in order.
    pub(super) fn journal(&self) -> impl Iterator<Item = &JournalEntry> {
        let play = self.play();
        play.journal.iter().chain(play.fleet.iter().flat_map(Fleet::journal))
    }

    /// Lets time pass, at most so many seconds, until `done` says so; does what was arranged when its time has come. Whether it
    /// was `done`.
    pub(super) async fn pass(
        &mut self,
        seconds: f64,
        mut done: impl FnMut(&Stage) -> Result<bool, Wrong>,
    ) -> Result<bool, Wrong> {
        self.open()?;
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
        let speed = self.cast.speed;
        let play = self.play.as_mut().expect("it was opened");
        match &mut play.fleet {
            Some(fleet) => fleet.watch(Duration::from_secs_f64((left_s / speed).min(LOOK_S / speed))).await,
            None => {
                let now = play.world.now().as_secs();
                let due = play.world.next_due().map_or(f64::MAX, |due| due.as_secs());
                play.world.advance(WorldTime::from_secs(due.min(now + left_s.min(LOOK_S)).max(now)));
                play.journal.extend(play.world.with(World::drain_journal));
            }
        }
    }

    async fn carry_out_plans(&mut self) -> Result<(), Wrong> {
        for index in (0..self.plans.len()).rev() {
            match self.look(&self.plans[index].once) {
                Ok(()) => {
                    let plan = self.plans.remove(index);
                    let doing: Doing<'_> = (plan.deed)(self, &plan.said);
                    doing.await?;
                }
                Err(Wrong::Instead(_)) => {}
                // Of missions and nodes nothing can be said before there are any.
                Err(Wrong::Nonsense(_)) if self.missions.is_empty() => {}
                Err(Wrong::Nonsense(what)) => {
                    let what = format!("what was arranged for when {}: {what}", self.plans[index].once.text);
                    return Err(Wrong::Nonsense(what));
                }
            }
        }
        Ok(())
    }

    /// What was arranged and did not come about.
    pub(super) fn left_over(&self) -> Option<String> {
        if let Some(unheeded) = self.refused.as_ref().and_then(Refusal::unheeded) {
            return Some(unheeded);
        }
        let plan = self.plans.first()?;
        Some(format!("it was said what happens when {}, and that has not come about", plan.once.text))
    }

    /// The robot of a name.
    pub(super) fn robot(&self, name: &str) -> Result<RobotId, Wrong> {
        let robots = self.play().world.robots();
        if let Some(robot) = robots.iter().find(|robot| robot.as_str() == name) {
            return Ok(robot.clone());
        }
        let known: Vec<&str> = robots.iter().map(RobotId::as_str).collect();
        Err(Wrong::Nonsense(format!("there is no robot {name}; there are: {}", known.join(", "))))
    }

    /// The mission that is meant: `the mission` is the one that was asked for last.
    pub(super) fn mission(&self, meant: &str) -> Result<MissionId, Wrong> {
        let name = meant.strip_prefix("mission ");
        let mut asked = self.missions.iter().rev();
        let found = asked.find(|(request, _)| name.is_none_or(|name| name == request));
        let known: Vec<&str> = self.missions.iter().map(|(request, _)| request.as_str()).collect();
        if let Some(unheeded) = self.refused.as_ref().and_then(Refusal::unheeded) {
            return Err(Wrong::Nonsense(unheeded));
        }
        found.map(|(_, mission)| mission.clone()).ok_or_else(|| {
            let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
            Wrong::Nonsense(format!("{meant} was not asked for; asked for: {known}"))
        })
    }

    /// What happened so far, a line each; the same several times in succession in one.
    pub(super) fn story(&self) -> Vec<String> {
        let Some(play) = &self.play else { return vec![] };
        let at = |elapsed: Duration| play.nodes_since_s + elapsed.as_secs_f64() * self.cast.speed;
        let mut lines: Vec<(f64, String)> =
            self.journal().filter_map(|entry| Some((entry.time.as_secs(), story::in_world(&entry.what)?))).collect();
        if let Some(fleet) = &play.fleet {
            let entries = fleet.chronicle.entries();
            lines.extend(entries.iter().filter_map(|(when, entry)| Some((at(*when), story::of_nodes(entry)?))));
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
