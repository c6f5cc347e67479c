//! Commands of the ledger and their outcomes.

use super::alarm::AlarmChange;
use super::branch::Branch;
use super::closure::ClosureChange;
use super::command_error::CommandError;
use super::history_limits::HistoryLimits;
use super::map_part::MapPart;
use super::mission_order::{MissionCancelation, MissionChange};
use super::person_request::{PersonAnswer, PersonRequestId, TaskQuestion};
use super::resource_lease::Resource;
use super::robot_order::OrderRequest;
use super::schedule::{Schedule, SchedulePause};
use super::speed_limit::SpeedLimitChange;
use super::submission::Submission;
use crate::auction::AuctionRecord;
use crate::cause::CauseClass;
use crate::ids::{ClusterId, MissionId, PlaceId, RobotId, RoleId, ScheduleId};
use crate::lease::Epoch;
use crate::mission::TaskOutcomes;
use crate::plan::StepIndex;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Command that the coordinator proposes to the log.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Command {
    /// Sets the identity of the ledger: the first command in every log.
    Bootstrap {
        /// Cluster id, different from that of every other ledger under this fleet name.
        cluster: ClusterId,
    },
    /// Adds a mission requested by a client.
    Submit(Box<Submission>),
    /// Awards or promises roles after an auction.
    Award {
        /// The mission.
        mission: MissionId,
        /// Branch of the roles: a role may have the same name in both branches.
        branch: Branch,
        /// Robot of each open role. Only in a mission with open roles of spread loops some may be left out.
        holders: BTreeMap<RoleId, RobotId>,
        /// Record of the auction. Its promised roles are promised to their robots, and not awarded yet.
        auction: AuctionRecord,
    },
    /// Records an auction that could not fill the open roles. The mission stays pending.
    Defer {
        /// The mission.
        mission: MissionId,
        /// Branch of the roles.
        branch: Branch,
        /// Record of the auction.
        auction: AuctionRecord,
    },
    /// Records that the holder has confirmed a role.
    Accept {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// Epoch of the award.
        epoch: Epoch,
        /// Incarnation of the robot's node that confirms.
        incarnation: u64,
        /// True if that incarnation restored the plan from a checkpoint.
        from_checkpoint: bool,
    },
    /// Records that steps of a role have ended.
    Progress {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// Epoch of the award; the default for an unmanaged role, which has none.
        epoch: Epoch,
        /// Branch of the plan, for an unmanaged role, which has the same name in both branches. For
        /// a managed role the default, since the epoch identifies the branch.
        branch: Branch,
        /// All steps that have ended so far.
        ended: BTreeSet<StepIndex>,
        /// Outcomes of tasks that the ledger may lack.
        outcomes: TaskOutcomes,
    },
    /// Releases a role from its holder.
    Release {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// Epoch of the award.
        epoch: Epoch,
        /// Cause, as text.
        cause: String,
        /// Class of the cause if the robot failed at the role; `None` if it was lost, or gave the role
        /// back.
        class: Option<CauseClass>,
        /// True if the robot has certainly moved no item in steps that it has not reported as ended.
        moved_nothing: bool,
        /// Last known place of the robot.
        place: Option<PlaceId>,
        /// True if the robot returned the role to give way, although it could have gone on.
        gave_way: bool,
    },
    /// Fails a mission that cannot be completed.
    Fail {
        /// The mission.
        mission: MissionId,
        /// Cause, as text.
        cause: String,
        /// Branch for which this holds; `None` for any branch, as for a deadline.
        branch: Option<Branch>,
        /// Last known places of its robots.
        places: BTreeMap<RobotId, PlaceId>,
        /// Class of the cause.
        class: CauseClass,
    },
    /// Cancels a mission at a client's request.
    Cancel {
        /// The mission.
        mission: MissionId,
        /// Person or client that cancels.
        by: String,
        /// Last known places of its robots.
        places: BTreeMap<RobotId, PlaceId>,
        /// Time of the request in milliseconds since 1970; 0 if it is unknown.
        at_ms: u64,
    },
    /// Closes a mission that needs intervention: a person has taken care of the items that robots
    /// had.
    Resolve {
        /// The mission.
        mission: MissionId,
        /// Person that resolved it.
        by: String,
        /// Time of the request in milliseconds since 1970; 0 if it is unknown.
        at_ms: u64,
    },
    /// Requests a task of an unmanaged role from a person.
    AskPerson {
        /// The mission.
        mission: MissionId,
        /// Branch of the task.
        branch: Branch,
        /// Role of the person.
        role: RoleId,
        /// Step of its plan.
        step: StepIndex,
        /// Time of the request in milliseconds since 1970.
        asked_ms: u64,
    },
    /// Records the answer of a person to a request.
    AnswerPerson {
        /// The request.
        request: PersonRequestId,
        /// The answer.
        answer: PersonAnswer,
        /// Last known places of the robots of the mission.
        places: BTreeMap<RobotId, PlaceId>,
    },
    /// Closes a request that nobody has answered in time, and fails its mission, unless a robot asked.
    ExpirePersonRequest {
        /// The request.
        request: PersonRequestId,
        /// Time that a majority of the voters confirms, in milliseconds since 1970.
        now_ms: u64,
        /// Last known places of the robots of the mission.
        places: BTreeMap<RobotId, PlaceId>,
    },
    /// Raises the wire version that the fleet writes. From now on the ledger may contain what this
    /// version adds. The proposer has checked that every node can read it; the version is never
    /// lowered.
    RaiseWireVersion {
        /// New wire version.
        wire: u8,
        /// Person that requests it; empty for the version of a new ledger.
        by: String,
        /// Time of the request in milliseconds since 1970; 0 if it is unknown.
        at_ms: u64,
    },
    /// Changes the limits of the history. It has no effect before wire version 3.
    SetHistoryLimits(HistoryLimits),
    /// Replaces or withdraws the open question of the robot that holds a role.
    SetQuestion {
        /// The mission.
        mission: MissionId,
        /// Role of the robot.
        role: RoleId,
        /// Epoch of its award.
        epoch: Epoch,
        /// The question.
        question: TaskQuestion,
        /// Time of the question in milliseconds since 1970.
        asked_ms: u64,
    },
    /// Adds a schedule.
    AddSchedule {
        /// The schedule.
        schedule: Box<Schedule>,
        /// Time after which its occurrences count, in milliseconds since 1970.
        from_ms: u64,
    },
    /// Removes a schedule. Its missions go on.
    RemoveSchedule {
        /// The schedule.
        schedule: ScheduleId,
        /// Person that removes it.
        by: String,
        /// Time in milliseconds since 1970.
        at_ms: u64,
    },
    /// Pauses a schedule.
    PauseSchedule {
        /// The schedule.
        schedule: ScheduleId,
        /// The pause.
        pause: SchedulePause,
    },
    /// Resumes a paused schedule.
    ResumeSchedule {
        /// The schedule.
        schedule: ScheduleId,
        /// Time in milliseconds since 1970.
        at_ms: u64,
        /// Person that resumes it.
        by: String,
    },
    /// Submits the mission of an occurrence.
    SubmitOccurrence {
        /// The schedule.
        schedule: ScheduleId,
        /// Time up to which the schedule was handled, in milliseconds since 1970.
        after_ms: u64,
        /// Time of the occurrence, in milliseconds since 1970.
        due_ms: u64,
        /// Time of submission, in milliseconds since 1970.
        at_ms: u64,
    },
    /// Leaves out missed occurrences.
    SkipOccurrences {
        /// The schedule.
        schedule: ScheduleId,
        /// Time up to which the schedule was handled, in milliseconds since 1970.
        after_ms: u64,
        /// Time up to which its occurrences are left out, in milliseconds since 1970.
        until_ms: u64,
    },
    /// Awards a promised role to its robot.
    AwardPromised {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// Epoch of the promise.
        epoch: Epoch,
    },
    /// Turns a held role, which cannot start yet, into a promise to its robot.
    Postpone {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// Epoch of the award.
        epoch: Epoch,
    },
    /// Marks a request that nobody has answered in time as escalated: people with another role are asked,
    /// too.
    EscalatePersonRequest {
        /// The request.
        request: PersonRequestId,
        /// Time that a majority of the voters confirms, in milliseconds since 1970.
        now_ms: u64,
    },
    /// Changes the orders of people to robots, of all or of none.
    OrderRobots {
        /// The robots.
        robots: BTreeSet<RobotId>,
        /// The change of the orders, with the person who requests it.
        order: OrderRequest,
    },
    /// Ends the orders, closures and speed limits that have expired.
    ExpireOrders {
        /// Time that a majority of the voters confirms, in milliseconds since 1970.
        now_ms: u64,
    },
    /// Closes or opens zones, places and lanes, all or none.
    ChangeClosures {
        /// The zones, places and lanes.
        parts: BTreeSet<MapPart>,
        /// The change of the closures, with the person who requests it.
        order: OrderRequest<ClosureChange>,
    },
    /// Ends the orders to robots that have left the fleet.
    EndOrders {
        /// The robots.
        robots: BTreeSet<RobotId>,
    },
    /// Moves the promise of a role to another robot.
    MovePromise(Box<PromiseMove>),
    /// Sets or clears speed limits, all or none.
    ChangeSpeedLimits {
        /// The zones, places and lanes.
        parts: BTreeSet<MapPart>,
        /// The change of the limits, with the person who requests it.
        order: OrderRequest<SpeedLimitChange>,
    },
    /// Raises or clears alarms.
    ChangeAlarms {
        /// The change of the alarms, with the person who requests it.
        order: OrderRequest<AlarmChange>,
    },
    /// Cancels missions at the request of a person, all in one entry of the log.
    CancelMissions {
        /// The missions, with the person who requests it.
        order: OrderRequest<MissionCancelation>,
    },
    /// Changes a mission at the request of a person.
    ChangeMission {
        /// The mission.
        mission: MissionId,
        /// The change, with the person who requests it.
        order: OrderRequest<MissionChange>,
    },
    /// Leases a charger or a device to a robot.
    LeaseResource {
        /// The charger or the device.
        resource: Resource,
        /// The robot.
        robot: RobotId,
        /// Time of the grant in milliseconds since 1970; 0 if it is unknown.
        at_ms: u64,
    },
    /// Ends the lease of a charger or a device.
    FreeResource {
        /// The charger or the device.
        resource: Resource,
        /// Position of the grant.
        epoch: Epoch,
    },
}

/// Move of a promise to another robot, after an auction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PromiseMove {
    /// The mission.
    pub mission: MissionId,
    /// The role.
    pub role: RoleId,
    /// Epoch of the promise.
    pub epoch: Epoch,
    /// The other robot.
    pub robot: RobotId,
    /// Cause, as text.
    pub cause: String,
    /// Record of the auction. The role is awarded to the robot, unless it is among the promised roles of the record.
    pub auction: AuctionRecord,
}

impl Command {
    /// Returns the command that sets the wire version of a new ledger, which no person requests.
    pub fn first_wire_version(wire: u8) -> Command {
        Command::RaiseWireVersion { wire, by: String::new(), at_ms: 0 }
    }

    /// Returns the existing mission that the command concerns.
    pub fn mission(&self) -> Option<&MissionId> {
        match self {
            Command::Award { mission, .. }
            | Command::Defer { mission, .. }
            | Command::Accept { mission, .. }
            | Command::Progress { mission, .. }
            | Command::Release { mission, .. }
            | Command::Fail { mission, .. }
            | Command::Cancel { mission, .. }
            | Command::Resolve { mission, .. }
            | Command::ChangeMission { mission, .. }
            | Command::AskPerson { mission, .. }
            | Command::SetQuestion { mission, .. }
            | Command::AwardPromised { mission, .. }
            | Command::Postpone { mission, .. } => Some(mission),
            Command::MovePromise(change) => Some(&change.mission),
            Command::AnswerPerson { request, .. }
            | Command::EscalatePersonRequest { request, .. }
            | Command::ExpirePersonRequest { request, .. } => Some(&request.mission),
            Command::Bootstrap { .. }
            | Command::Submit(_)
            | Command::AddSchedule { .. }
            | Command::RemoveSchedule { .. }
            | Command::PauseSchedule { .. }
            | Command::ResumeSchedule { .. }
            | Command::SubmitOccurrence { .. }
            | Command::SkipOccurrences { .. }
            | Command::OrderRobots { .. }
            | Command::ExpireOrders { .. }
            | Command::EndOrders { .. }
            | Command::CancelMissions { .. }
            | Command::ChangeClosures { .. }
            | Command::ChangeSpeedLimits { .. }
            | Command::ChangeAlarms { .. }
            | Command::LeaseResource { .. }
            | Command::FreeResource { .. }
            | Command::RaiseWireVersion { .. }
            | Command::SetHistoryLimits(_) => None,
        }
    }
}

/// Outcome of a command.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum CommandOutcome {
    /// The request was accepted as this mission.
    Submitted {
        /// Id of the mission.
        mission: MissionId,
        /// True if the request had been made before.
        again: bool,
    },
    /// The roles were awarded under this epoch.
    Awarded {
        /// Epoch of the award.
        epoch: Epoch,
    },
    /// The command was applied, now or before.
    Done,
    /// The command does not fit the ledger, which is unchanged.
    Refused(CommandError),
}

/// Cause of a release.
pub(super) struct ReleaseCause {
    pub(super) cause: String,
    pub(super) class: Option<CauseClass>,
    pub(super) moved_nothing: bool,
    pub(super) place: Option<PlaceId>,
    pub(super) gave_way: bool,
}
