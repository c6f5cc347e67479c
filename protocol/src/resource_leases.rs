//! What the leases of chargers and of devices have in common: the actions of the coordinator, and their repetition.
//!
//! [`ChargerLeases`](crate::chargers::ChargerLeases) and [`DeviceLeases`](crate::devices::DeviceLeases) decide which robot
//! gets a resource, and when its lease ends.

use crate::ids::RobotId;
use crate::lease::Epoch;
use crate::ledger::{Resource, ResourceLease};
use crate::units::NodeTime;
use std::fmt;
use std::time::Duration;

/// Interval of the notices to a robot that has not claimed the leased resource, and of repeated proposals.
pub(crate) const REPEAT_INTERVAL: Duration = Duration::from_millis(500);

/// Time after the grant within which the robot must claim the resource. Raised: a charger is idle for longer if the robot
/// has meanwhile received a role. A guess: some notices may be lost.
pub(crate) const ANSWER_MAX: Duration = Duration::from_secs(10);

/// Time for which a robot must be gone before its lease ends. Raised: the resource of a lost robot is idle for longer. A
/// guess: a coordinator that has just started may lack its record.
pub(crate) const GONE_MAX: Duration = Duration::from_secs(5);

/// Cause of the end of a lease.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EndOfLease {
    /// The robot has claimed the resource, and no longer does.
    Done,
    /// The robot is down, or has left the fleet.
    Gone,
    /// The robot was on its way for too long.
    Late,
    /// The robot has not claimed the resource.
    NoAnswer,
}

impl fmt::Display for EndOfLease {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            EndOfLease::Done => "it no longer uses it",
            EndOfLease::Gone => "it is lost, or has left the fleet",
            EndOfLease::Late => "it did not come in time",
            EndOfLease::NoAnswer => "it did not claim it in time",
        })
    }
}

/// Action of the coordinator.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ResourceAction {
    /// Lease the resource to the robot.
    Lease {
        /// The charger or the device.
        resource: Resource,
        /// The robot.
        robot: RobotId,
    },
    /// Notify the robot of its lease.
    Notify {
        /// The charger or the device.
        resource: Resource,
        /// The robot.
        robot: RobotId,
        /// Position of the grant.
        epoch: Epoch,
    },
    /// End the lease.
    Free {
        /// The charger or the device.
        resource: Resource,
        /// The robot.
        robot: RobotId,
        /// Position of the grant.
        epoch: Epoch,
        /// Cause.
        cause: EndOfLease,
    },
}

/// What a lease needs.
#[derive(Debug, Clone, Copy)]
pub(crate) enum LeaseStep {
    Notify,
    End(EndOfLease),
}

impl LeaseStep {
    /// Returns the action for a lease.
    pub(crate) fn action(self, resource: Resource, lease: &ResourceLease) -> ResourceAction {
        let (robot, epoch) = (lease.robot.clone(), lease.epoch);
        match self {
            LeaseStep::Notify => ResourceAction::Notify { resource, robot, epoch },
            LeaseStep::End(cause) => ResourceAction::Free { resource, robot, epoch, cause },
        }
    }
}

/// The steps that a coordinator has last taken for a lease.
#[derive(Debug, Default)]
pub(crate) struct LeaseSteps {
    /// Time of the latest notice.
    notified_at: Option<NodeTime>,
    /// Time of the latest proposal to end it.
    ended_at: Option<NodeTime>,
}

impl LeaseSteps {
    /// Notifies the robot, unless that was done just before.
    pub(crate) fn notify(&mut self, now: NodeTime) -> Option<LeaseStep> {
        is_due(&mut self.notified_at, now).then_some(LeaseStep::Notify)
    }

    /// Proposes the end, unless that was done just before.
    pub(crate) fn end(&mut self, cause: EndOfLease, now: NodeTime) -> Option<LeaseStep> {
        is_due(&mut self.ended_at, now).then_some(LeaseStep::End(cause))
    }
}

/// Checks whether something is due that was last done at this time, and records that it is done now.
fn is_due(last: &mut Option<NodeTime>, now: NodeTime) -> bool {
    let due = last.is_none_or(|at| now.since(at) >= REPEAT_INTERVAL);
    if due {
        *last = Some(now);
    }
    due
}
