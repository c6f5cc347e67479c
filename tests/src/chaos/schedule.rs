//! What is done to a fleet and when, as plain data: written to a file, cut down, and done again.

use super::cast::{ARM, Cast, MISSIONS, ROOMS};
use crate::disk::Torn;
use serde::{Deserialize, Serialize};
use std::fmt::{self, Display};
use std::time::Duration;

/// All that is done to one fleet, in order of time.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Schedule {
    /// What is done.
    pub steps: Vec<Step>,
}

/// One thing that is done, faults with the time for which they last.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// When, in milliseconds since the fleet was started.
    pub at_ms: u64,
    /// What.
    #[serde(flatten)]
    pub act: Act,
}

/// Something that is done. Nodes are named; `coordinator` is whoever coordinates at that instant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "act", rename_all = "snake_case")]
pub enum Act {
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
        disk: Fate,
        /// For how long it is down, in milliseconds.
        for_ms: u64,
    },
    /// All nodes are killed at one instant, and started again after a while.
    Blackout {
        /// What their disks are then.
        disk: Fate,
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
        how: Mishap,
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
pub enum Fate {
    /// All that was written, acknowledged or not.
    Kept,
    /// All that was acknowledged, and by chance some of what was not.
    Torn,
    /// Nothing: the node comes back with an empty disk.
    Empty,
}

impl Fate {
    /// What becomes of writes under way.
    pub fn torn(self) -> Torn {
        match self {
            Fate::Kept => Torn::Nothing,
            Fate::Torn | Fate::Empty => Torn::ByChance,
        }
    }
}

/// How a skill goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mishap {
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
pub enum Kind {
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

impl Kind {
    /// All of them but none at all.
    pub const FAULTS: [Kind; 16] = [
        Kind::Crash,
        Kind::CrashTorn,
        Kind::CrashEmpty,
        Kind::CoordinatorCrash,
        Kind::Blackout,
        Kind::Pause,
        Kind::Partition,
        Kind::OneWayCut,
        Kind::Loss,
        Kind::Duplication,
        Kind::Reordering,
        Kind::Delay,
        Kind::SlowDisk,
        Kind::Drift,
        Kind::Battery,
        Kind::Skill,
    ];

    /// Its name, as commands take it.
    pub fn name(self) -> &'static str {
        match self {
            Kind::None => "none",
            Kind::Crash => "crash",
            Kind::CrashTorn => "crash-torn",
            Kind::CrashEmpty => "crash-empty",
            Kind::CoordinatorCrash => "coordinator-crash",
            Kind::Blackout => "blackout",
            Kind::Pause => "pause",
            Kind::Partition => "partition",
            Kind::OneWayCut => "one-way-cut",
            Kind::Loss => "loss",
            Kind::Duplication => "duplication",
            Kind::Reordering => "reordering",
            Kind::Delay => "delay",
            Kind::SlowDisk => "slow-disk",
            Kind::Drift => "drift",
            Kind::Battery => "battery",
            Kind::Skill => "skill",
        }
    }
}

impl std::str::FromStr for Kind {
    type Err = String;

    fn from_str(name: &str) -> Result<Kind, String> {
        let known = || [Kind::None].into_iter().chain(Kind::FAULTS);
        known().find(|kind| kind.name() == name).ok_or_else(|| {
            let names: Vec<_> = known().map(Kind::name).collect();
            format!("no kind of fault is called {name:?}; there are {}", names.join(", "))
        })
    }
}

impl Act {
    /// For how long it lasts, in milliseconds; `None` for what happens once.
    pub fn for_ms(&self) -> Option<u64> {
        match self {
            Act::Crash { for_ms, .. }
            | Act::Blackout { for_ms, .. }
            | Act::Pause { for_ms, .. }
            | Act::Partition { for_ms, .. }
            | Act::Cut { for_ms, .. }
            | Act::Weather { for_ms, .. }
            | Act::SlowDisk { for_ms, .. } => Some(*for_ms),
            Act::Submit { .. } | Act::Cancel { .. } | Act::Drift { .. } | Act::Battery { .. } | Act::Skill { .. } => {
                None
            }
        }
    }

    /// The request that it makes, if it is one.
    pub fn submits(&self) -> Option<String> {
        if let Act::Submit { request, .. } = self { Some(request.clone()) } else { None }
    }

    /// The same, for another time.
    #[must_use]
    pub fn lasting(&self, ms: u64) -> Act {
        let mut act = self.clone();
        match &mut act {
            Act::Crash { for_ms, .. }
            | Act::Blackout { for_ms, .. }
            | Act::Pause { for_ms, .. }
            | Act::Partition { for_ms, .. }
            | Act::Cut { for_ms, .. }
            | Act::Weather { for_ms, .. }
            | Act::SlowDisk { for_ms, .. } => *for_ms = ms,
            Act::Submit { .. } | Act::Cancel { .. } | Act::Drift { .. } | Act::Battery { .. } | Act::Skill { .. } => {}
        }
        act
    }
}

impl Schedule {
    /// Whether everybody and everything that it names is there.
    ///
    /// # Errors
    /// What is not, and what there is, in words.
    pub fn check(&self, cast: &Cast) -> Result<(), String> {
        let nodes = cast.nodes();
        let robots: Vec<&str> = cast.carriers.iter().copied().chain([ARM]).collect();
        let one_of = |step: &Step, name: &str, known: &[&str], extra: &[&str]| {
            let known: Vec<&str> = known.iter().chain(extra).copied().collect();
            if known.contains(&name) {
                return Ok(());
            }
            Err(format!("at {} ms: {name:?} is not known; there are {}", step.at_ms, known.join(", ")))
        };
        for step in &self.steps {
            match &step.act {
                Act::Submit { room, mission, .. } => {
                    one_of(step, room, &ROOMS, &[])?;
                    one_of(step, mission, &MISSIONS, &[])?;
                }
                Act::Cancel { .. } | Act::Blackout { .. } => {}
                Act::Crash { node, .. } => one_of(step, node, &nodes, &["coordinator"])?,
                Act::Pause { node, .. } | Act::SlowDisk { node, .. } => one_of(step, node, &nodes, &[])?,
                Act::Partition { groups, .. } => {
                    groups.iter().flatten().try_for_each(|node| one_of(step, node, &nodes, &["client"]))?;
                }
                Act::Cut { from, to, .. } => {
                    one_of(step, from, &nodes, &["client", "*"])?;
                    one_of(step, to, &nodes, &["client", "*"])?;
                }
                Act::Weather { loss, duplication, reordering, .. } => {
                    if ![loss, duplication, reordering].into_iter().all(|share| (0.0..=1.0).contains(share)) {
                        return Err(format!("at {} ms: a share lies between 0 and 1", step.at_ms));
                    }
                }
                Act::Drift { node, rate } => {
                    one_of(step, node, &nodes, &[])?;
                    if !(0.5..=2.0).contains(rate) {
                        return Err(format!("at {} ms: a clock counts 0.5 to 2 s in one", step.at_ms));
                    }
                }
                Act::Battery { robot } | Act::Skill { robot, .. } => one_of(step, robot, &robots, &[])?,
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

impl Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at = Duration::from_millis(self.at_ms).as_secs_f64();
        write!(f, "{at:8.3}  {}", self.act)
    }
}

/// Milliseconds as people read them.
struct For(u64);

impl Display for For {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "for {:.3} s", Duration::from_millis(self.0).as_secs_f64())
    }
}

impl Display for Act {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let fate = |disk: &Fate| match disk {
            Fate::Kept => "its disk kept",
            Fate::Torn => "its last unsynced writes lost",
            Fate::Empty => "its disk lost",
        };
        match self {
            Act::Submit { request, unnamed, mission, room, priority, deadline_s } => {
                let unnamed = if *unnamed { ", which is not named" } else { "" };
                write!(f, "request {request}{unnamed}: {mission} from {room}, priority {priority}")?;
                deadline_s.map_or(Ok(()), |seconds| write!(f, ", within {seconds} s"))
            }
            Act::Cancel { request } => write!(f, "request {request} is withdrawn"),
            Act::Crash { node, disk, for_ms } => write!(f, "{node} crashes, {}, down {}", fate(disk), For(*for_ms)),
            Act::Blackout { disk, for_ms } => write!(f, "every node crashes, {}, down {}", fate(disk), For(*for_ms)),
            Act::Pause { node, for_ms } => write!(f, "{node} is paused {}", For(*for_ms)),
            Act::Partition { groups, for_ms } => {
                let groups: Vec<_> = groups.iter().map(|group| group.join(" ")).collect();
                write!(f, "partition {} {}", groups.join(" | "), For(*for_ms))
            }
            Act::Cut { from, to, for_ms } => write!(f, "{to} does not hear {from} {}", For(*for_ms)),
            Act::Weather { loss, duplication, reordering, delay_ms, for_ms } => write!(
                f,
                "bad links: {loss:.2} lost, {duplication:.2} repeated, {reordering:.2} overtaken, up to {delay_ms} ms {}",
                For(*for_ms)
            ),
            Act::SlowDisk { node, write_ms, for_ms } => {
                write!(f, "the disk of {node} takes up to {write_ms} ms a write {}", For(*for_ms))
            }
            Act::Drift { node, rate } => write!(f, "the clock of {node} counts {rate:.4} s a second"),
            Act::Battery { robot } => write!(f, "the battery of {robot} runs down"),
            Act::Skill { robot, how, times } => {
                let how = match how {
                    Mishap::Fails => "fails",
                    Mishap::Panics => "panics",
                    Mishap::Hangs => "hangs",
                };
                write!(f, "the skill of {robot} {how}, {times} in a row")
            }
        }
    }
}
