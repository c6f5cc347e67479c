//! Actions of a leader session, as values, and the state that they depend on.

use super::message::AwardedRole;
use super::rounds::Rounds;
use consort_protocol::cause::CauseClass;
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::lease::{Epoch, LeaseMonitor};
use consort_protocol::ledger::RoleReturn;
use consort_protocol::units::{NodeTime, Seconds};
use std::collections::BTreeMap;

/// Pending action of the coordinator.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum CoordinatorAction {
    /// Call for bids for a mission's open roles.
    CallForBids(MissionId),
    /// Notify a robot of its award.
    NotifyAward(AwardedRole),
    /// Award a promised role to its robot, which is free.
    AwardPromised(AwardedRole),
    /// Release a role with the cause: the lease of its robot has certainly expired, or the robot of a
    /// promise is out of service.
    ReleaseRole(AwardedRole, String),
    /// Ask a robot to return a role for another mission.
    AskToGiveWay {
        awarded: AwardedRole,
        to: MissionId,
        /// The robot gets the role again.
        for_now: bool,
    },
    /// Ask a robot to return a role that a person has reassigned.
    AskToReturn { awarded: AwardedRole, order: RoleReturn },
    /// Fail a mission.
    FailMission { mission: MissionId, cause: String, class: CauseClass },
}

/// Charge of a robot by its record, as a share of a full battery.
#[derive(Debug, Clone, Copy)]
pub(super) struct RecordedCharge {
    pub(super) charge: f64,
    /// Charge above the minimum that a role must leave.
    pub(super) spare: f64,
}

/// Session state that the pending actions depend on.
pub(super) struct SessionState<'a> {
    pub(super) lease_monitor: &'a LeaseMonitor,
    pub(super) rounds: &'a Rounds,
    pub(super) notified: &'a BTreeMap<(Epoch, RoleId), NodeTime>,
    /// Robots with promises that cannot take a role, with the reasons.
    pub(super) unfit: &'a BTreeMap<RobotId, String>,
    /// Charge of robots with promises.
    pub(super) charges: &'a BTreeMap<RobotId, RecordedCharge>,
    /// Maximum number of promises of a robot.
    pub(super) promises_max: u32,
    /// Time before the earliest start of a mission from which its roles are promised.
    pub(super) ahead: Seconds,
}
