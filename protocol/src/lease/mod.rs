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
//! [`RoleLease`] is the robot's side, [`LeaseMonitor`] the coordinator's. The end of the lease
//! reaches the robot's motors by [`keep_for`].

mod acting_time;
mod award;
mod monitor;
mod terms;

pub use acting_time::{keep_for, stop_at};
pub use award::{Award, DeclineReason, EndReason, Epoch, RoleHolder};
pub use monitor::LeaseMonitor;
pub use terms::{CLOCK_DRIFT_MAX, LEASE_REACTION, LeaseTerms, stop_lead};

use crate::ids::{MissionId, RobotId, RoleId};
use crate::plan::StepIndex;
use crate::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};

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
    /// Time has passed. While goals that stop slowly are in progress, the robot passes a time that is later by their
    /// [lead](stop_lead), so that they are stopped before the lease ends.
    Tick,
}

/// Action for the robot to perform, in the order given.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Action {
    /// Send a report now, to have the coordinator confirm the award.
    Report,
    /// Start the plan; the given steps have ended already.
    Start(Box<Award>, BTreeSet<StepIndex>),
    /// Stop safely and keep the progress in the plan: the lease has run out by the time of the [tick](Event::Tick).
    Suspend {
        /// End of the lease.
        until: NodeTime,
    },
    /// Continue the plan.
    Resume,
    /// Stop safely and drop the plan.
    Halt(EndReason),
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
        self.acts_until().is_some_and(|until| now < until)
    }

    /// Returns the time until which the robot may act, if the award is confirmed and not suspended.
    pub fn acts_until(&self) -> Option<NodeTime> {
        self.held.as_ref().filter(|held| held.phase == Phase::Active).map(|held| held.until)
    }

    /// Checks whether the plan is suspended: the lease has run out, or the award was restored after
    /// a restart and is not confirmed yet.
    pub fn is_suspended(&self) -> bool {
        self.held.as_ref().is_some_and(|held| matches!(held.phase, Phase::Suspended | Phase::Restored))
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
                vec![Action::Suspend { until: held.until }]
            }
            Phase::Suspended | Phase::Restored => vec![],
        }
    }
}

#[cfg(test)]
mod tests;
