//! Awards as leases with an epoch (after Gray and Cheriton 1989; the epoch is a fencing token).
//!
//! An award names a mission, a role, a robot and an [`Epoch`], which only grows. The robot renews
//! it by reporting. The robot counts the lease from the time at which it *sent* the request for
//! renewal; the coordinator counts from the time at which it *replied*. So the robot stops before
//! the role is awarded to another robot, however long the network delays a message:
//!
//! ```text
//! robot        sends report ──────────────────────────── lease ───────────────▶ suspends
//! coordinator          replies ──────────────────────────────── lease + grace ─────────▶ may release
//! ```
//!
//! [`RoleLease`] is the robot's side, [`LeaseMonitor`] the coordinator's.

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
/// Serves as a fencing token.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct Epoch {
    /// Term of the coordinator.
    pub term: u64,
    /// Index in the ledger's log.
    pub index: u64,
}

impl fmt::Display for Epoch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.term, self.index)
    }
}

/// Role awarded to a robot, with all data needed to start.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Award {
    /// The mission.
    pub mission: MissionId,
    /// The role in it.
    pub role: RoleId,
    /// Robot that gets the role.
    pub robot: RobotId,
    /// Epoch of this award.
    pub epoch: Epoch,
    /// Local plan to execute.
    pub plan: LocalPlan,
    /// Holders of the mission's managed roles.
    pub holders: BTreeMap<RoleId, RoleHolder>,
}

/// Holder of a role, and the epoch of its award. Signals sent under an older epoch are ignored.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RoleHolder {
    /// The robot.
    pub robot: RobotId,
    /// Epoch of the award.
    pub epoch: Epoch,
}

impl RoleHolder {
    /// Returns the robots without the epochs.
    pub fn robots(holders: &BTreeMap<RoleId, RoleHolder>) -> BTreeMap<RoleId, RobotId> {
        holders.iter().map(|(role, holder)| (role.clone(), holder.robot.clone())).collect()
    }
}

/// Duration of a lease without contact. Fleet-wide: all nodes must use the same values.
///
/// # Clocks
///
/// Leases are measured by each node's monotonic clock. Clocks need not agree on the time. They may
/// even run at different rates, within a bound ([`drift_max`](LeaseTerms::drift_max)). Let the
/// fastest clock of the fleet count `1 + d` seconds while the slowest counts 1 second, and measure
/// all times below in seconds of the slowest clock. That is the worst case for the clocks of the
/// robot and of the first coordinator. `L` is the lease, `G` the grace, and `r` the robot's
/// reaction: the time from the end of its lease until it has come to rest (its control period and
/// its stopping time).
///
/// - The robot sends a report at `s`. If the report is answered and no later report is, the robot
///   is at rest by `s + L + r`.
/// - The coordinator replies at `a`, and `a >= s`. A majority had followed it at most `G / 2`
///   before.
/// - A later coordinator was elected by a majority. At least one node of that majority had followed
///   the first coordinator at that moment, and voted afterwards. So the later coordinator takes
///   over no earlier than `a - G / 2`, and counts from then on. On the fastest clock it has counted
///   `L + G` after `(L + G) / (1 + d)`. It releases the role no earlier than
///   `a - G / 2 + (L + G) / (1 + d)`.
///
/// No other robot acts in the role before this robot is at rest if, in the worst case `s = a`,
///
/// ```text
/// L + r <= (L + G) / (1 + d) - G / 2      that is      d <= (G / 2 - r) / (L + G / 2 + r)
/// ```
///
/// With the defaults and a reaction of 0.5 s this is 9 %; real clocks differ by less than 0.1 %. A
/// coordinator that stays leader counts from `a`, which allows `d <= (G - r) / (L + r)`: 33 %.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeaseTerms {
    /// The robot suspends this long after it sent the last report that was answered. Raised: the
    /// robot keeps moving through longer blackouts, but lost robots are replaced later. Default 4
    /// s: several times the duration of a takeover.
    pub lease: Duration,
    /// Additional wait of the coordinator. It covers clock drift and the maximum age of the
    /// coordinator's last contact with a quorum. Default 2 s.
    pub grace: Duration,
}

impl Default for LeaseTerms {
    fn default() -> Self {
        LeaseTerms { lease: Duration::from_secs(4), grace: Duration::from_secs(2) }
    }
}

impl LeaseTerms {
    /// Returns the largest relative clock drift between the slowest and the fastest clock at which
    /// leases are safe; see the derivation above. `reaction` is the time from the end of a lease
    /// until the robot is at rest. Returns 0 if the grace does not even cover the reaction.
    pub fn drift_max(&self, reaction: Duration) -> f64 {
        let (lease, half, reaction) =
            (self.lease.as_secs_f64(), self.grace.as_secs_f64() / 2.0, reaction.as_secs_f64());
        ((half - reaction) / (lease + half + reaction)).max(0.0)
    }

    /// Returns the maximum age of a coordinator's last contact with a quorum for it to renew
    /// leases: half the grace. The other half is for drift.
    pub fn leadership_age_max(&self) -> Duration {
        self.grace / 2
    }
}

/// Input of the lease state machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// An award for this robot was received. The plan starts only after the coordinator has
    /// confirmed the award.
    AwardReceived(Box<Award>),
    /// The coordinator replied to a report that was sent at `sent`.
    Renewed {
        /// Epoch of the award concerned.
        epoch: Epoch,
        /// Time at which the report was sent.
        sent: NodeTime,
        /// Steps that have ended according to the ledger.
        ended: BTreeSet<StepIndex>,
    },
    /// The coordinator revoked the role.
    Revoked {
        /// Epoch of the award concerned.
        epoch: Epoch,
        /// Reason.
        reason: EndReason,
    },
    /// The plan was completed or one of its tasks failed, and the ledger has recorded it.
    Settled {
        /// Epoch of the award concerned.
        epoch: Epoch,
    },
    /// Time has passed.
    Tick,
}

/// Reason for which a role ended without being completed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EndReason {
    /// The mission was canceled.
    Canceled,
    /// The mission failed elsewhere.
    Failed,
    /// The mission has ended.
    Over,
    /// Another award has replaced this one.
    Replaced,
    /// The role was released; another robot will take it over.
    Released,
    /// The mission waits for a person, since a robot still has an item.
    #[serde(alias = "rescue")]
    NeedsIntervention,
}

/// Action for the robot to perform, in the order given.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Action {
    /// Send a report now, to have the coordinator confirm the award.
    Report,
    /// Start the plan; the given steps have ended already.
    Start(Box<Award>, BTreeSet<StepIndex>),
    /// Stop safely and keep the progress in the plan: the lease has run out.
    Suspend,
    /// Continue the plan.
    Resume,
    /// Stop safely and drop the plan.
    Halt(EndReason),
}

/// Reason for which a robot declines an award.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum DeclineReason {
    /// The robot holds another role. A robot holds at most 1 role.
    #[error("holds {role} of {mission}")]
    Busy {
        /// Mission of the role that it holds.
        mission: MissionId,
        /// Role that it holds.
        role: RoleId,
    },
    /// The robot has received a later award of the same role; common when messages overtake each
    /// other.
    #[error("has already received epoch {known}")]
    Stale {
        /// Epoch of the later award.
        known: Epoch,
    },
    /// The award is for another robot.
    #[error("is not {robot}, to which the award was made")]
    WrongRobot {
        /// Robot named in the award.
        robot: RobotId,
    },
    /// The robot accepts no new role, since it is about to leave the fleet.
    #[error("is leaving the fleet")]
    Leaving,
}

/// Robot's side of a lease. A robot has at most 1 award at a time.
#[derive(Debug, Clone)]
pub struct RoleLease {
    robot: RobotId,
    terms: LeaseTerms,
    held: Option<Held>,
    /// Latest epoch received for each role, so that an award that was overtaken is not started.
    latest: BTreeMap<(MissionId, RoleId), Epoch>,
}

#[derive(Debug, Clone)]
struct Held {
    award: Award,
    phase: Phase,
    /// End of the lease. Before the first confirmation: the time at which the award is dropped.
    until: NodeTime,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Received, not confirmed.
    Received,
    /// Restored after a restart, not confirmed since. Kept until the coordinator has replied.
    Restored,
    Active,
    Suspended,
}

/// Maximum number of roles for which the latest epoch is stored. An award that is older than all of
/// them has left every queue long ago.
const LATEST_KEPT: usize = 512;

impl RoleLease {
    /// Creates a lease without an award.
    pub fn new(robot: RobotId, terms: LeaseTerms) -> Self {
        RoleLease { robot, terms, held: None, latest: BTreeMap::new() }
    }

    /// Restores an award that the robot's node had stored before a restart. The plan starts only
    /// after the coordinator has confirmed the award. Until the coordinator has replied, the award
    /// is neither dropped nor replaced by an award of another role.
    pub fn restore(robot: RobotId, terms: LeaseTerms, award: Award) -> Self {
        let latest = BTreeMap::from([((award.mission.clone(), award.role.clone()), award.epoch)]);
        let held = Some(Held { award, phase: Phase::Restored, until: NodeTime::ZERO });
        RoleLease { robot, terms, held, latest }
    }

    /// Drops the latest epochs of all roles, except for the role that it holds: epochs of another
    /// cluster are counted anew.
    pub fn clear_latest_epochs(&mut self) {
        let held = self.held.as_ref().map(|held| (held.award.mission.clone(), held.award.role.clone()));
        self.latest.retain(|role, _| Some(role) == held.as_ref());
    }

    /// Returns the award, confirmed or not.
    pub fn award(&self) -> Option<&Award> {
        self.held.as_ref().map(|held| &held.award)
    }

    /// Checks whether the robot may act at this instant: the award is confirmed and the lease has
    /// not run out.
    pub fn may_act(&self, now: NodeTime) -> bool {
        self.held.as_ref().is_some_and(|held| {
            held.phase == Phase::Active && (now < held.until || mutants::is_active(Mutant::LeaseNotChecked))
        })
    }

    /// Checks whether the plan is suspended: the lease has run out, or the award was restored after
    /// a restart and is not confirmed yet.
    pub fn is_suspended(&self) -> bool {
        self.held.as_ref().is_some_and(|held| matches!(held.phase, Phase::Suspended | Phase::Restored))
    }

    /// Returns the end of the lease. `None` without an award, or if the award was restored after a
    /// restart and is not confirmed yet.
    pub fn expires_at(&self) -> Option<NodeTime> {
        self.held.as_ref().filter(|held| held.phase != Phase::Restored).map(|held| held.until)
    }

    /// Checks whether the robot can accept an award.
    ///
    /// # Errors
    /// [`DeclineReason`], which is sent to the coordinator.
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

    /// Handles an event and returns the resulting actions.
    pub fn handle(&mut self, event: Event, now: NodeTime) -> Vec<Action> {
        match event {
            Event::AwardReceived(award) => self.receive_award(*award, now),
            Event::Renewed { epoch, sent, ended } => self.renew(epoch, sent, ended, now),
            Event::Revoked { epoch, reason } => self.revoke(epoch, reason),
            Event::Settled { epoch } => self.settle(epoch),
            Event::Tick => self.expire(now),
        }
    }

    fn receive_award(&mut self, award: Award, now: NodeTime) -> Vec<Action> {
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
            Some(held) if held.phase != Phase::Received => actions.push(Action::Halt(EndReason::Replaced)),
            Some(_) => {}
            None if known == Some(award.epoch) => return vec![], // a duplicate of an award that has ended
            None => {}
        }
        self.held = Some(Held { award, phase: Phase::Received, until: now + self.terms.lease });
        actions.push(Action::Report);
        actions
    }

    fn renew(&mut self, epoch: Epoch, sent: NodeTime, ended: BTreeSet<StepIndex>, now: NodeTime) -> Vec<Action> {
        let Some(held) = self.held.as_mut().filter(|held| held.award.epoch == epoch) else {
            return vec![]; // an award that has ended since the report was sent
        };
        let until = sent + self.terms.lease;
        if until <= now {
            return vec![]; // the reply took longer than the lease
        }
        match held.phase {
            Phase::Received | Phase::Restored => {
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

    /// A robot that never started the plan has nothing to halt and nothing to report: it has
    /// published no start.
    fn revoke(&mut self, epoch: Epoch, reason: EndReason) -> Vec<Action> {
        match self.held.take_if(|held| held.award.epoch == epoch) {
            Some(held) if held.phase == Phase::Received => vec![],
            Some(_) => vec![Action::Halt(reason)],
            None => vec![],
        }
    }

    fn settle(&mut self, epoch: Epoch) -> Vec<Action> {
        self.held.take_if(|held| held.award.epoch == epoch);
        vec![]
    }

    fn expire(&mut self, now: NodeTime) -> Vec<Action> {
        if mutants::is_active(Mutant::LeaseNotChecked) {
            return vec![];
        }
        let Some(held) = self.held.as_mut().filter(|held| held.until <= now) else { return vec![] };
        match held.phase {
            Phase::Received => {
                // The award was not confirmed and nothing was started: if it is received again, it
                // counts as new.
                if let Some(held) = self.held.take() {
                    self.latest.remove(&(held.award.mission, held.award.role));
                }
                vec![]
            }
            Phase::Active => {
                held.phase = Phase::Suspended;
                vec![Action::Suspend]
            }
            Phase::Suspended | Phase::Restored => vec![],
        }
    }
}

#[cfg(test)]
mod tests;
