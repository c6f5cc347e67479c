//! What is done to a fleet and when, as plain data: written to a file, cut down, and done again.

use super::chaos_fleet::{ARM, ChaosFleet, MISSIONS, ROOMS};
use crate::disk::UnsyncedWrites;
use serde::{Deserialize, Serialize};
use std::fmt::{self, Display};
use std::time::Duration;

/// All that is done to one fleet, in order of time.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Schedule {
    /// What is done.
    pub steps: Vec<ScheduledAction>,
}

/// One thing that is done, faults with the time for which they last.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScheduledAction {
    /// When, in milliseconds since the fleet was started.
    pub at_ms: u64,
    /// What.
    #[serde(flatten)]
    pub action: ChaosAction,
}

/// Something that is done. Nodes are named; `coordinator` is whoever coordinates at that instant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "act", rename_all = "snake_case")]
pub enum ChaosAction {
    /// A client asks for the sample of a room, again and again until it is acknowledged.
    Submit {
        /// The request's own name.
        request: String,
        /// Whether the client keeps that name to itself. Each time that it asks is a request of its own then, so that what it
        /// asked for may be done more than once.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        unnamed: bool,
        /// What is asked for.
        #[serde(default = "plain")]
        mission: String,
        /// The room.
        room: String,
        /// How urgent it is: higher is served first.
        #[serde(default)]
        priority: i64,
        /// In how many seconds it should be done.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        deadline_s: Option<u32>,
    },
    /// A client withdraws what was asked for, once it was acknowledged, again and again until it is answered.
    Cancel {
        /// Under which name it was asked for.
        request: String,
    },
    /// A node is killed, and started again after a while.
    Crash {
        /// Which.
        node: String,
        /// What its disk is then.
        disk: DiskAfterCrash,
        /// For how long it is down, in milliseconds.
        for_ms: u64,
    },
    /// All nodes are killed at one instant, and started again after a while.
    Blackout {
        /// What their disks are then.
        disk: DiskAfterCrash,
        /// For how long they are down, in milliseconds.
        for_ms: u64,
    },
    /// Nothing goes into or out of a node; afterwards all of it arrives. On the virtual bus its own timers go on, which a
    /// process that is stopped (SIGSTOP) does not know: that is tried on real processes.
    Pause {
        /// Which.
        node: String,
        /// For how long, in milliseconds.
        for_ms: u64,
    },
    /// Only nodes of one group hear one another.
    Partition {
        /// The groups. `client` is whoever makes requests.
        groups: Vec<Vec<String>>,
        /// For how long, in milliseconds.
        for_ms: u64,
    },
    /// One does not hear the other any more, but is heard by it.
    Cut {
        /// Who is not heard; `*` for everybody.
        from: String,
        /// Who does not hear; `*` for everybody.
        to: String,
        /// For how long, in milliseconds.
        for_ms: u64,
    },
    /// All links are bad.
    Weather {
        /// Share of messages that are lost.
        loss: f64,
        /// Share of publications that arrive twice.
        duplication: f64,
        /// Share of publications that are overtaken.
        reordering: f64,
        /// Longest time that a message is under way, in milliseconds.
        delay_ms: u64,
        /// For how long, in milliseconds.
        for_ms: u64,
    },
    /// A node's disk takes long for each write.
    SlowDisk {
        /// Which node's.
        node: String,
        /// How long at most, in milliseconds.
        write_ms: u64,
        /// For how long, in milliseconds.
        for_ms: u64,
    },
    /// A node's clock runs fast or slow, from its first start on.
    Drift {
        /// Which node's.
        node: String,
        /// Seconds that it counts in one.
        rate: f64,
    },
    /// A robot's battery falls to the share at which it stops dead.
    Battery {
        /// Whose.
        robot: String,
    },
    /// A robot's skills go wrong when they are next begun.
    Skill {
        /// Whose.
        robot: String,
        /// How.
        how: SkillFault,
        /// How often, one after the other.
        times: u32,
    },
}

fn plain() -> String {
    MISSIONS[0].to_owned()
}

/// What a crash leaves of a disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DiskAfterCrash {
    /// All that was written, acknowledged or not.
    Kept,
    /// All that was acknowledged, and by chance some of what was not.
    Torn,
    /// Nothing: the node comes back with an empty disk.
    Empty,
}

impl DiskAfterCrash {
    /// What becomes of writes under way.
    pub fn unsynced_writes(self) -> UnsyncedWrites {
        match self {
            DiskAfterCrash::Kept => UnsyncedWrites::AllKept,
            DiskAfterCrash::Torn | DiskAfterCrash::Empty => UnsyncedWrites::SomeLost,
        }
    }
}

/// How a skill goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SkillFault {
    /// It fails.
    Fails,
    /// It panics.
    Panics,
    /// It does nothing for half a minute, and then goes on.
    Hangs,
}

/// The kinds of faults, as the scoreboard lists them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[expect(missing_docs, reason = "each is described at the act that it is a kind of")]
pub enum FaultKind {
    None,
    Crash,
    CrashTorn,
    CrashEmpty,
    CoordinatorCrash,
    Blackout,
    Pause,
    Partition,
    OneWayCut,
    Loss,
    Duplication,
    Reordering,
    Delay,
    SlowDisk,
    Drift,
    Battery,
    Skill,
}

impl FaultKind {
    /// All of them but none at all.
    pub const FAULTS: [FaultKind; 16] = [
        FaultKind::Crash,
        FaultKind::CrashTorn,
        FaultKind::CrashEmpty,
        FaultKind::CoordinatorCrash,
        FaultKind::Blackout,
        FaultKind::Pause,
        FaultKind::Partition,
        FaultKind::OneWayCut,
        FaultKind::Loss,
        FaultKind::Duplication,
        FaultKind::Reordering,
        FaultKind::Delay,
        FaultKind::SlowDisk,
        FaultKind::Drift,
        FaultKind::Battery,
        FaultKind::Skill,
    ];

    /// Its name, as commands take it.
    pub fn name(self) -> &'static str {
        match self {
            FaultKind::None => "none",
            FaultKind::Crash => "crash",
            FaultKind::CrashTorn => "crash-torn",
            FaultKind::CrashEmpty => "crash-empty",
            FaultKind::CoordinatorCrash => "coordinator-crash",
            FaultKind::Blackout => "blackout",
            FaultKind::Pause => "pause",
            FaultKind::Partition => "partition",
            FaultKind::OneWayCut => "one-way-cut",
            FaultKind::Loss => "loss",
            FaultKind::Duplication => "duplication",
            FaultKind::Reordering => "reordering",
            FaultKind::Delay => "delay",
            FaultKind::SlowDisk => "slow-disk",
            FaultKind::Drift => "drift",
            FaultKind::Battery => "battery",
            FaultKind::Skill => "skill",
        }
    }
}

impl std::str::FromStr for FaultKind {
    type Err = String;

    fn from_str(name: &str) -> Result<FaultKind, String> {
        let known = || [FaultKind::None].into_iter().chain(FaultKind::FAULTS);
        known().find(|kind| kind.name() == name).ok_or_else(|| {
            let names: Vec<_> = known().map(FaultKind::name).collect();
            format!("no kind of fault is called {name:?}; there are {}", names.join(", "))
        })
    }
}

impl ChaosAction {
    /// For how long it lasts, in milliseconds; `None` for what happens once.
    pub fn for_ms(&self) -> Option<u64> {
        match self {
            ChaosAction::Crash { for_ms, .. }
            | ChaosAction::Blackout { for_ms, .. }
            | ChaosAction::Pause { for_ms, .. }
            | ChaosAction::Partition { for_ms, .. }
            | ChaosAction::Cut { for_ms, .. }
            | ChaosAction::Weather { for_ms, .. }
            | ChaosAction::SlowDisk { for_ms, .. } => Some(*for_ms),
            ChaosAction::Submit { .. }
            | ChaosAction::Cancel { .. }
            | ChaosAction::Drift { .. }
            | ChaosAction::Battery { .. }
            | ChaosAction::Skill { .. } => None,
        }
    }

    /// The request that it makes, if it is one.
    pub fn submitted_request(&self) -> Option<String> {
        if let ChaosAction::Submit { request, .. } = self { Some(request.clone()) } else { None }
    }

    /// The same, for another time.
    #[must_use]
    pub fn with_duration_ms(&self, ms: u64) -> ChaosAction {
        let mut act = self.clone();
        match &mut act {
            ChaosAction::Crash { for_ms, .. }
            | ChaosAction::Blackout { for_ms, .. }
            | ChaosAction::Pause { for_ms, .. }
            | ChaosAction::Partition { for_ms, .. }
            | ChaosAction::Cut { for_ms, .. }
            | ChaosAction::Weather { for_ms, .. }
            | ChaosAction::SlowDisk { for_ms, .. } => *for_ms = ms,
            ChaosAction::Submit { .. }
            | ChaosAction::Cancel { .. }
            | ChaosAction::Drift { .. }
            | ChaosAction::Battery { .. }
            | ChaosAction::Skill { .. } => {}
        }
        act
    }
}

impl Schedule {
    /// Whether everybody and everything that it names is there.
    ///
    /// # Errors
    /// What is not, and what there is, in words.
    pub fn check(&self, cast: &ChaosFleet) -> Result<(), String> {
        let nodes = cast.nodes();
        let robots: Vec<&str> = cast.carriers.iter().copied().chain([ARM]).collect();
        let one_of = |step: &ScheduledAction, name: &str, known: &[&str], extra: &[&str]| {
            let known: Vec<&str> = known.iter().chain(extra).copied().collect();
            if known.contains(&name) {
                return Ok(());
            }
            Err(format!("at {} ms: {name:?} is not known; there are {}", step.at_ms, known.join(", ")))
        };
        for step in &self.steps {
            match &step.action {
                ChaosAction::Submit { room, mission, .. } => {
                    one_of(step, room, &ROOMS, &[])?;
                    one_of(step, mission, &MISSIONS, &[])?;
                }
                ChaosAction::Cancel { .. } | ChaosAction::Blackout { .. } => {}
                ChaosAction::Crash { node, .. } => one_of(step, node, &nodes, &["coordinator"])?,
                ChaosAction::Pause { node, .. } | ChaosAction::SlowDisk { node, .. } => {
                    one_of(step, node, &nodes, &[])?
                }
                ChaosAction::Partition { groups, .. } => {
                    groups.iter().flatten().try_for_each(|node| one_of(step, node, &nodes, &["client"]))?;
                }
                ChaosAction::Cut { from, to, .. } => {
                    one_of(step, from, &nodes, &["client", "*"])?;
                    one_of(step, to, &nodes, &["client", "*"])?;
                }
                ChaosAction::Weather { loss, duplication, reordering, .. } => {
                    if ![loss, duplication, reordering].into_iter().all(|share| (0.0..=1.0).contains(share)) {
                        return Err(format!("at {} ms: a share lies between 0 and 1", step.at_ms));
                    }
                }
                ChaosAction::Drift { node, rate } => {
                    one_of(step, node, &nodes, &[])?;
                    if !(0.5..=2.0).contains(rate) {
                        return Err(format!("at {} ms: a clock counts 0.5 to 2 s in one", step.at_ms));
                    }
                }
                ChaosAction::Battery { robot } | ChaosAction::Skill { robot, .. } => one_of(step, robot, &robots, &[])?,
            }
        }
        Ok(())
    }

    /// Puts the steps in order of time; those of one instant stay as they are.
    #[must_use]
    pub fn in_order(mut self) -> Schedule {
        self.steps.sort_by_key(|step| step.at_ms);
        self
    }
}

impl Display for Schedule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.steps.iter().try_for_each(|step| writeln!(f, "{step}"))
    }
}

impl Display for ScheduledAction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at = Duration::from_millis(self.at_ms).as_secs_f64();
        write!(f, "{at:8.3}  {}", self.action)
    }
}

/// Milliseconds as people read them.
struct For(u64);

impl Display for For {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "for {:.3} s", Duration::from_millis(self.0).as_secs_f64())
    }
}

impl Display for ChaosAction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let fate = |disk: &DiskAfterCrash| match disk {
            DiskAfterCrash::Kept => "its disk kept",
            DiskAfterCrash::Torn => "its last unsynced writes lost",
            DiskAfterCrash::Empty => "its disk lost",
        };
        match self {
            ChaosAction::Submit { request, unnamed, mission, room, priority, deadline_s } => {
                let unnamed = if *unnamed { ", which is not named" } else { "" };
                write!(f, "request {request}{unnamed}: {mission} from {room}, priority {priority}")?;
                deadline_s.map_or(Ok(()), |seconds| write!(f, ", within {seconds} s"))
            }
            ChaosAction::Cancel { request } => write!(f, "request {request} is withdrawn"),
            ChaosAction::Crash { node, disk, for_ms } => {
                write!(f, "{node} crashes, {}, down {}", fate(disk), For(*for_ms))
            }
            ChaosAction::Blackout { disk, for_ms } => {
                write!(f, "every node crashes, {}, down {}", fate(disk), For(*for_ms))
            }
            ChaosAction::Pause { node, for_ms } => write!(f, "{node} is paused {}", For(*for_ms)),
            ChaosAction::Partition { groups, for_ms } => {
                let groups: Vec<_> = groups.iter().map(|group| group.join(" ")).collect();
                write!(f, "partition {} {}", groups.join(" | "), For(*for_ms))
            }
            ChaosAction::Cut { from, to, for_ms } => write!(f, "{to} does not hear {from} {}", For(*for_ms)),
            ChaosAction::Weather { loss, duplication, reordering, delay_ms, for_ms } => write!(
                f,
                "bad links: {loss:.2} lost, {duplication:.2} repeated, {reordering:.2} overtaken, up to {delay_ms} ms {}",
                For(*for_ms)
            ),
            ChaosAction::SlowDisk { node, write_ms, for_ms } => {
                write!(f, "the disk of {node} takes up to {write_ms} ms a write {}", For(*for_ms))
            }
            ChaosAction::Drift { node, rate } => write!(f, "the clock of {node} counts {rate:.4} s a second"),
            ChaosAction::Battery { robot } => write!(f, "the battery of {robot} runs down"),
            ChaosAction::Skill { robot, how, times } => {
                let how = match how {
                    SkillFault::Fails => "fails",
                    SkillFault::Panics => "panics",
                    SkillFault::Hangs => "hangs",
                };
                write!(f, "the skill of {robot} {how}, {times} in a row")
            }
        }
    }
}
