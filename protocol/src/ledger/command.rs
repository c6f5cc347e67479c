//! Commands of the ledger and their outcomes.

use super::alarm::AlarmChange;
use super::branch::Branch;
use super::closure::{CLOSURES_BYTES_MAX, ClosureChange};
use super::entry::MissionState;
use super::history_limits::HistoryLimits;
use super::map_part::MapPart;
use super::person_request::{PersonAnswer, PersonRequestId, TaskQuestion};
use super::robot_order::{ORDERS_BYTES_MAX, OrderRequest};
use super::schedule::{Schedule, SchedulePause};
use super::speed_limit::{SPEED_LIMITS_BYTES_MAX, SpeedLimitChange};
use super::submission::Submission;
use crate::auction::AuctionRecord;
use crate::cause::CauseClass;
use crate::ids::{ClusterId, ItemId, MissionId, PlaceId, RequestId, RobotId, RoleId, ScheduleId};
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
    /// Passes a promised role to another robot.
    Reassign(Box<Reassignment>),
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
}

/// Change of the robot of a promised role, after an auction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reassignment {
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
            | Command::AskPerson { mission, .. }
            | Command::SetQuestion { mission, .. }
            | Command::AwardPromised { mission, .. }
            | Command::Postpone { mission, .. } => Some(mission),
            Command::Reassign(change) => Some(&change.mission),
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
            | Command::ChangeClosures { .. }
            | Command::ChangeSpeedLimits { .. }
            | Command::ChangeAlarms { .. }
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

/// Error: a command does not fit the ledger.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum CommandError {
    /// There is no such mission; common for a mission that ended long ago.
    #[error("there is no mission {mission}")]
    NoMission {
        /// Id of the mission.
        mission: MissionId,
    },
    /// The mission has ended.
    #[error("mission {mission} is {}", .state.as_str())]
    MissionEnded {
        /// Id of the mission.
        mission: MissionId,
        /// Final state.
        state: MissionState,
    },
    /// The mission has no such role.
    #[error("mission {mission} has no role {role}")]
    NoRole {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
    },
    /// The role is held under another award, or under none.
    #[error("{role} of {mission} is held under epoch {}", .held.map_or("none".to_owned(), |epoch| epoch.to_string()))]
    StaleEpoch {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// Epoch of the award in force.
        held: Option<Epoch>,
    },
    /// The command concerns the branch that is not executed; common for delayed messages.
    #[error("mission {mission} executes its {} branch, and the command concerns the other branch", .taken.as_str())]
    WrongBranch {
        /// The mission.
        mission: MissionId,
        /// Branch that is executed now.
        taken: Branch,
    },
    /// The awarded roles differ from the open roles.
    #[error("the open roles of {mission} are {}", .open.iter().map(RoleId::as_str).collect::<Vec<_>>().join(", "))]
    NotOpen {
        /// The mission.
        mission: MissionId,
        /// Open roles of the mission.
        open: BTreeSet<RoleId>,
    },
    /// A robot would hold two roles.
    #[error("{robot} would hold two roles: it already holds {role} of {mission}")]
    TwoRoles {
        /// The robot.
        robot: RobotId,
        /// Mission of the role that it holds.
        mission: MissionId,
        /// Role that it holds.
        role: RoleId,
    },
    /// The role is not promised to a robot.
    #[error("{role} of {mission} is not promised")]
    NotPromised {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
    },
    /// The role has started, or can start now, so it cannot be postponed.
    #[error("{role} of {mission} can start")]
    CanStart {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
    },
    /// Missions would wait for each other's robots.
    #[error("{mission} would wait for missions that wait for it")]
    CircularWait {
        /// The mission.
        mission: MissionId,
    },
    /// A robot has an item of a mission that waits for a person.
    #[error("{robot} has the {item} of {mission}, which needs intervention")]
    CarriesItem {
        /// The robot.
        robot: RobotId,
        /// Item that it has, or may have.
        item: ItemId,
        /// Mission that waits.
        mission: MissionId,
    },
    /// There is no such request to a person.
    #[error("there is no request {request}; see api/requests")]
    NoPersonRequest {
        /// Id of the request.
        request: PersonRequestId,
    },
    /// Another answer, or the course of the mission, has closed the request.
    #[error("request {request} is closed; it was {phase}")]
    PersonRequestClosed {
        /// Id of the request.
        request: PersonRequestId,
        /// How it was closed.
        phase: String,
    },
    /// The mission does not wait for a person.
    #[error("mission {mission} is {state}; only a mission that needs intervention can be resolved")]
    NoInterventionNeeded {
        /// The mission.
        mission: MissionId,
        /// Name of its state.
        state: String,
    },
    /// The robot's node has restarted, and a later incarnation has confirmed the role; common for
    /// delayed reports.
    #[error("a later incarnation of {robot} has confirmed {role} of {mission}")]
    StaleIncarnation {
        /// The robot.
        robot: RobotId,
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
    },
    /// There is no such schedule.
    #[error("there is no schedule {schedule}; see api/schedules")]
    NoSchedule {
        /// Id of the schedule.
        schedule: ScheduleId,
    },
    /// Another schedule has this id.
    #[error("there is another schedule {schedule}; remove it first, or choose another name")]
    ScheduleExists {
        /// Id of the schedule.
        schedule: ScheduleId,
    },
    /// The fleet writes a wire version without schedules.
    #[error("schedules need wire version {since}; consort upgrade shows how far the fleet is")]
    NoSchedulesYet {
        /// Wire version since which there are schedules.
        since: u8,
    },
    /// The ledger contains the maximum number of schedules.
    #[error("there are {} schedules, the maximum of a ledger", Schedule::MAX)]
    SchedulesFull,
    /// The occurrence has been submitted or left out, or the schedule is paused; common for repeated commands.
    #[error("schedule {schedule} is paused, or handled up to {handled_ms} ms since 1970")]
    OccurrenceHandled {
        /// Id of the schedule.
        schedule: ScheduleId,
        /// Time up to which it is handled, in milliseconds since 1970.
        handled_ms: u64,
    },
    /// The fleet writes a wire version without orders of people.
    #[error(
        "holds, maintenance, closures, speed limits and alarms need wire version {since}; consort upgrade shows how far the fleet is"
    )]
    NoOrdersYet {
        /// Wire version since which there are orders.
        since: u8,
    },
    /// The orders to robots exceed their size limit.
    #[error("the orders to robots would take more than {} bytes; end some of them first", ORDERS_BYTES_MAX)]
    OrdersFull,
    /// The robot gets no role, because a person holds it or has taken it out of service, or because of an alarm.
    #[error("{robot} is {problem}")]
    UnderOrders {
        /// The robot.
        robot: RobotId,
        /// The order, as text.
        problem: String,
    },
    /// The ledger contains the maximum number of missions that have not ended.
    #[error("{missions} missions are active or need intervention, the maximum of a ledger")]
    Full {
        /// Number of these missions.
        missions: u64,
    },
    /// The divided mission exceeds its size limit.
    #[error("the mission takes {bytes} bytes; at most {max} are allowed")]
    TooLarge {
        /// Encoded size.
        bytes: u64,
        /// Maximum size.
        max: u64,
    },
    /// The request may be a repetition of a request whose outcome is no longer known.
    #[error(
        "request {request} was created at {created_ms} ms since 1970; the fleet remembers only requests after {since_ms}. \
         If it was never sent before, check the clock that it was named by, and send it under a new name"
    )]
    RequestForgotten {
        /// Id of the request.
        request: RequestId,
        /// Time in its id, in milliseconds since 1970.
        created_ms: u64,
        /// Time after which requests are remembered, in milliseconds since 1970.
        since_ms: u64,
    },
    /// The robot's node has restarted since it confirmed the role, and has lost the plan.
    #[error("{robot} has restarted since it confirmed {role} of {mission}")]
    Restarted {
        /// The robot.
        robot: RobotId,
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
    },
    /// The closures exceed their size limit.
    #[error(
        "the closures would take more than {} bytes; open some places first, or give shorter reasons",
        CLOSURES_BYTES_MAX
    )]
    ClosuresFull,
    /// Others have acted on the promise of a role.
    #[error("others have acted on {role} of {mission}")]
    ActedOn {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
    },
    /// The speed limits exceed their size limit.
    #[error(
        "the speed limits would take more than {} bytes; clear some of them first, or give shorter reasons",
        SPEED_LIMITS_BYTES_MAX
    )]
    SpeedLimitsFull,
    /// The alarms in force exceed their limits.
    #[error("{problem}; clear another alarm first")]
    AlarmsFull {
        /// The exceeded limit, as text.
        problem: String,
    },
}

/// Cause of a release.
pub(super) struct ReleaseCause {
    pub(super) cause: String,
    pub(super) class: Option<CauseClass>,
    pub(super) moved_nothing: bool,
    pub(super) place: Option<PlaceId>,
    pub(super) gave_way: bool,
}
