//! Awards as leases with an epoch (after Gray and Cheriton 1989; the epoch is a fencing token).
//!
//! An award names a mission, a role, a robot and an [`Epoch`], which only grows. The robot renews it by reporting. Time
//! is counted from when the *request* for renewal was sent on the robot's side, and from when the *answer* was given on
//! the coordinator's, so that whatever the network delays, the robot stops before the role is given to another:
//!
//! ```text
//! robot        sends report ──────────────────────────── lease ───────────────▶ suspends
//! coordinator          answers ──────────────────────────────── lease + grace ─────────▶ may release
//! ```
//!
//! [`Tenure`] is the robot's side. The coordinator's is [`Watch`].

mod monitor;

pub use monitor::LeaseMonitor;

use crate::ids::{MissionId, RobotId, RoleId};
use crate::mutants::{self, Mutant};
use crate::plan::{LocalPlan, StepIndex};
use crate::units::NodeTime;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::time::Duration;

/// Position of an award in the history of the fleet: term and index of its entry in the ledger.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct Epoch {
    /// The coordinator's term.
    pub term: u64,
    /// Place in the ledger's log.
    pub index: u64,
}

impl fmt::Display for Epoch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.term, self.index)
    }
}

/// A role given to a robot, with all that it needs in order to begin.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Award {
    /// The mission.
    pub mission: MissionId,
    /// The role in it.
    pub role: RoleId,
    /// Who gets it.
    pub robot: RobotId,
    /// Which award this is.
    pub epoch: Epoch,
    /// What to do.
    pub plan: LocalPlan,
    /// Who holds the mission's managed roles.
    pub holders: BTreeMap<RoleId, RoleHolder>,
}

/// Who holds a role, and by which award: what is said in that role under an older one is not listened to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RoleHolder {
    /// The robot.
    pub robot: RobotId,
    /// The award.
    pub epoch: Epoch,
}

impl RoleHolder {
    /// The robots alone.
    pub fn robots(holders: &BTreeMap<RoleId, RoleHolder>) -> BTreeMap<RoleId, RobotId> {
        holders.iter().map(|(role, holding)| (role.clone(), holding.robot.clone())).collect()
    }
}

/// How long an award lasts without contact. Fleet-wide: all nodes must agree.
///
/// # Clocks
///
/// Leases are measured by each node's monotonic clock. Clocks need not agree on the time; they may even run at different
/// rates, within a bound ([`drift_max`](LeaseTerms::drift_max)). Let the fastest clock of the fleet count `1 + d` seconds
/// while the slowest counts one, and tell all times below in seconds of the slowest, which is the worst that the robot's
/// and the first coordinator's can be. With lease `L`, grace `G`, and `r` for the robot's reaction (the time from the end of
/// its lease until its body has come to rest: its beat, and its body's way to stop):
///
/// - The robot sends a report at `s`. If it is answered, and no later one is, it is at rest by `s + L + r`.
/// - The coordinator answers at `a`, and `a >= s`. A majority had followed it at most `G / 2` before.
/// - A later coordinator has been elected by a majority, one of whom had followed the former at that moment and voted
///   afterwards: it takes over no earlier than `a - G / 2`, and counts from then on. On the fastest clock it has counted
///   `L + G` after `(L + G) / (1 + d)`. It gives the role away no earlier than `a - G / 2 + (L + G) / (1 + d)`.
///
/// Nobody else acts in the role before the robot is at rest if, at worst with `s = a`,
///
/// ```text
/// L + r <= (L + G) / (1 + d) - G / 2      that is      d <= (G / 2 - r) / (L + G / 2 + r)
/// ```
///
/// With the defaults and a reaction of half a second this is 9 %; clocks in use differ by less than 0.1 %. A coordinator
/// that stays counts from `a`, which leaves `d <= (G - r) / (L + r)`: 33 %.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeaseTerms {
    /// The robot suspends this long after it sent the last report that was answered. Raised: longer blackouts are
    /// survived in motion, lost robots are replaced later. Default 4 s: several takeovers long.
    pub lease: Duration,
    /// The coordinator waits this much longer. It covers clock drift and the age to which a coordinator may still
    /// believe in its own leadership. Default 2 s.
    pub grace: Duration,
}

impl Default for LeaseTerms {
    fn default() -> Self {
        LeaseTerms { lease: Duration::from_secs(4), grace: Duration::from_secs(2) }
    }
}

impl LeaseTerms {
    /// By which part a fleet's fastest clock may be faster than its slowest, given a robot's reaction: how long after the
    /// end of its lease its body is at rest. The derivation stands above. Nothing when the grace does not even cover the
    /// reaction.
    pub fn drift_max(&self, reaction: Duration) -> f64 {
        let (lease, half, reaction) =
            (self.lease.as_secs_f64(), self.grace.as_secs_f64() / 2.0, reaction.as_secs_f64());
        ((half - reaction) / (lease + half + reaction)).max(0.0)
    }

    /// How old a coordinator's last contact with a quorum may be for it to renew leases: half the grace. The other half
    /// is for drift.
    pub fn leadership_age_max(&self) -> Duration {
        self.grace / 2
    }
}

/// Something the holder has learned.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// An award for this robot was heard. It is not begun before the coordinator has confirmed it.
    AwardReceived(Box<Award>),
    /// The coordinator answered a report that was sent at `sent`.
    Renewed {
        /// The award it is about.
        epoch: Epoch,
        /// When the report had been sent.
        sent: NodeTime,
        /// Steps that the ledger knows as ended.
        ended: BTreeSet<StepIndex>,
    },
    /// The coordinator said that the role is no longer this robot's.
    Revoked {
        /// The award it is about.
        epoch: Epoch,
        /// Why.
        reason: EndReason,
    },
    /// The plan was carried out to its end, or a task of it failed, and the ledger knows.
    Settled {
        /// The award it is about.
        epoch: Epoch,
    },
    /// Time has passed.
    Tick,
}

/// Why a role ended otherwise than by being carried out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EndReason {
    /// The mission was canceled.
    Canceled,
    /// The mission failed elsewhere.
    Failed,
    /// The mission is over.
    Over,
    /// Another award has replaced this one.
    Replaced,
    /// The role was given up; another robot will take it over.
    Released,
    /// The mission waits for a person: something was left in a robot's hands.
    Rescue,
}

/// Something for the holder to carry out, in the order given.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Action {
    /// Ask the coordinator to confirm the award: send a report now.
    Report,
    /// Begin the plan; the steps named have ended already.
    Start(Box<Award>, BTreeSet<StepIndex>),
    /// Stop safely and keep the place in the plan: the lease has run out.
    Suspend,
    /// Go on.
    Resume,
    /// Stop safely and forget the plan.
    Halt(EndReason),
}

/// Why a robot does not take an award that it was told of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum DeclineReason {
    /// It holds another role. One robot, one role.
    #[error("holds {role} of {mission}")]
    Busy {
        /// The mission it is at work for.
        mission: MissionId,
        /// Its role there.
        role: RoleId,
    },
    /// It has heard of a later award of the same role; ordinary when messages overtake one another.
    #[error("has heard of epoch {known}")]
    Stale {
        /// The later epoch.
        known: Epoch,
    },
    /// The award is for somebody else.
    #[error("is not {robot}")]
    WrongRobot {
        /// For whom it is.
        robot: RobotId,
    },
    /// The robot takes nothing new: it is about to leave the fleet.
    #[error("leaves the fleet")]
    Leaving,
}

/// The robot's side of an award: at most one at a time.
#[derive(Debug, Clone)]
pub struct RoleLease {
    robot: RobotId,
    terms: LeaseTerms,
    held: Option<Held>,
    /// The latest epoch heard of each role, so that an overtaken award is not begun.
    latest: BTreeMap<(MissionId, RoleId), Epoch>,
}

#[derive(Debug, Clone)]
struct Held {
    award: Award,
    phase: Phase,
    /// The end of the lease; before the first confirmation, when to forget about the award.
    until: NodeTime,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Heard, not confirmed.
    Heard,
    /// Known from a former life, not confirmed in this one. Kept until the coordinator has said something.
    Recalled,
    Active,
    Suspended,
}

/// Of so many roles the latest epoch is remembered. An award that is older than them all has left every queue long ago.
const LATEST_KEPT: usize = 512;

impl RoleLease {
    /// No award yet.
    pub fn new(robot: RobotId, terms: LeaseTerms) -> Self {
        RoleLease { robot, terms, held: None, latest: BTreeMap::new() }
    }

    /// Takes up an award that a former life of the robot's node had written down. Nothing is done under it before the
    /// coordinator has confirmed it; until it has answered, the award is neither forgotten nor exchanged for another role's.
    pub fn restore(robot: RobotId, terms: LeaseTerms, award: Award) -> Self {
        let latest = BTreeMap::from([((award.mission.clone(), award.role.clone()), award.epoch)]);
        let held = Some(Held { award, phase: Phase::Recalled, until: NodeTime::ZERO });
        RoleLease { robot, terms, held, latest }
    }

    /// Forgets which awards it has heard of, but for the one it holds: those of another cluster are counted anew.
    pub fn clear_latest_epochs(&mut self) {
        let held = self.held.as_ref().map(|held| (held.award.mission.clone(), held.award.role.clone()));
        self.latest.retain(|role, _| Some(role) == held.as_ref());
    }

    /// The award held or about to be, if any.
    pub fn award(&self) -> Option<&Award> {
        self.held.as_ref().map(|held| &held.award)
    }

    /// Whether the plan may be acted on at this instant: confirmed, and the lease has not run out.
    pub fn may_act(&self, now: NodeTime) -> bool {
        self.held.as_ref().is_some_and(|held| {
            held.phase == Phase::Active && (now < held.until || mutants::is_active(Mutant::LeaseNotChecked))
        })
    }

    /// Whether the plan is held up: the lease has run out, or the award is a former life's and nobody has confirmed it yet.
    pub fn is_suspended(&self) -> bool {
        self.held.as_ref().is_some_and(|held| matches!(held.phase, Phase::Suspended | Phase::Recalled))
    }

    /// When the lease ends; `None` without an award, or with one of a former life that nobody has confirmed yet.
    pub fn expires_at(&self) -> Option<NodeTime> {
        self.held.as_ref().filter(|held| held.phase != Phase::Recalled).map(|held| held.until)
    }

    /// Whether an award could be taken, and if not, why.
    ///
    /// # Errors
    /// [`Declined`], for the coordinator to hear.
    pub fn check_award(&self, award: &Award) -> Result<(), DeclineReason> {
        if award.robot != self.robot {
            return Err(DeclineReason::WrongRobot { robot: award.robot.clone() });
        }
        let key = (award.mission.clone(), award.role.clone());
        if let Some(&known) = self.latest.get(&key).filter(|&&known| known > award.epoch) {
            return Err(DeclineReason::Stale { known });
        }
        match &self.held {
            Some(held) if held.award.mission != award.mission || held.award.role != award.role => {
                Err(DeclineReason::Busy { mission: held.award.mission.clone(), role: held.award.role.clone() })
            }
            _ => Ok(()),
        }
    }

    /// What follows from an event at an instant.
    pub fn handle(&mut self, event: Event, now: NodeTime) -> Vec<Action> {
        match event {
            Event::AwardReceived(award) => self.hear(*award, now),
            Event::Renewed { epoch, sent, ended } => self.renew(epoch, sent, ended, now),
            Event::Revoked { epoch, reason } => self.revoke(epoch, reason),
            Event::Settled { epoch } => self.settle(epoch),
            Event::Tick => self.lapse(now),
        }
    }

    fn hear(&mut self, award: Award, now: NodeTime) -> Vec<Action> {
        if self.check_award(&award).is_err() {
            return vec![];
        }
        let known = self.latest.insert((award.mission.clone(), award.role.clone()), award.epoch);
        while self.latest.len() > LATEST_KEPT {
            let oldest = self.latest.iter().min_by_key(|(_, epoch)| **epoch).map(|(role, _)| role.clone());
            oldest.and_then(|role| self.latest.remove(&role));
        }
        let mut actions = vec![];
        match &self.held {
            Some(held) if held.award.epoch == award.epoch => return vec![Action::Report],
            Some(held) if held.phase != Phase::Heard => actions.push(Action::Halt(EndReason::Replaced)),
            Some(_) => {}
            None if known == Some(award.epoch) => return vec![], // an echo of an award that has ended
            None => {}
        }
        self.held = Some(Held { award, phase: Phase::Heard, until: now + self.terms.lease });
        actions.push(Action::Report);
        actions
    }

    fn renew(&mut self, epoch: Epoch, sent: NodeTime, ended: BTreeSet<StepIndex>, now: NodeTime) -> Vec<Action> {
        let Some(held) = self.held.as_mut().filter(|held| held.award.epoch == epoch) else {
            return vec![]; // an award that has ended since the report was sent
        };
        let until = sent + self.terms.lease;
        if until <= now {
            return vec![]; // the answer took longer than the lease
        }
        match held.phase {
            Phase::Heard | Phase::Recalled => {
                held.phase = Phase::Active;
                held.until = until;
                vec![Action::Start(Box::new(held.award.clone()), ended)]
            }
            Phase::Active => {
                held.until = held.until.max(until);
                vec![]
            }
            Phase::Suspended => {
                held.phase = Phase::Active;
                held.until = until;
                vec![Action::Resume]
            }
        }
    }

    /// A robot that never acted has nothing to halt, and nothing to tell: it had told nobody that it began.
    fn revoke(&mut self, epoch: Epoch, reason: EndReason) -> Vec<Action> {
        match self.held.take_if(|held| held.award.epoch == epoch) {
            Some(held) if held.phase == Phase::Heard => vec![],
            Some(_) => vec![Action::Halt(reason)],
            None => vec![],
        }
    }

    fn settle(&mut self, epoch: Epoch) -> Vec<Action> {
        self.held.take_if(|held| held.award.epoch == epoch);
        vec![]
    }

    fn lapse(&mut self, now: NodeTime) -> Vec<Action> {
        if mutants::is_active(Mutant::LeaseNotChecked) {
            return vec![];
        }
        let Some(held) = self.held.as_mut().filter(|held| held.until <= now) else { return vec![] };
        match held.phase {
            Phase::Heard => {
                // Nobody has confirmed it, and nothing was begun: should it be told again, it is as good as new.
                if let Some(held) = self.held.take() {
                    self.latest.remove(&(held.award.mission, held.award.role));
                }
                vec![]
            }
            Phase::Active => {
                held.phase = Phase::Suspended;
                vec![Action::Suspend]
            }
            Phase::Suspended | Phase::Recalled => vec![],
        }
    }
}

#[cfg(test)]
mod tests;
