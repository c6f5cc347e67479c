//! Errors of commands of the ledger.

use super::branch::Branch;
use super::closure::CLOSURES_BYTES_MAX;
use super::entry::MissionState;
use super::mission_order::ReassignProblem;
use super::person_request::PersonRequestId;
use super::resource_lease::{RESOURCE_LEASES_BYTES_MAX, Resource};
use super::robot_order::ORDERS_BYTES_MAX;
use super::schedule::Schedule;
use super::speed_limit::SPEED_LIMITS_BYTES_MAX;
use crate::auction::RobotRestriction;
use crate::ids::{ItemId, MissionId, RequestId, RobotId, RoleId, ScheduleId};
use crate::lease::Epoch;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

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
    /// The fleet writes a wire version without orders of people and without leases of chargers.
    #[error(
        "orders of people and leases of chargers need wire version {since}; consort upgrade shows how far the fleet is"
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
    /// The role is not reassigned or pinned.
    #[error("{role} of {mission} {problem}")]
    CannotReassign {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The reason.
        problem: ReassignProblem,
    },
    /// A person has restricted the role to other robots.
    #[error("{robot} may not get {role} of {mission}, which is {restriction}")]
    NotPermitted {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The robot.
        robot: RobotId,
        /// The restriction.
        restriction: RobotRestriction,
    },
    /// The resource is leased, or the robot has the lease of another charger.
    #[error("{resource} is leased to {robot}")]
    ResourceLeased {
        /// The charger or the device that is leased.
        resource: Resource,
        /// The robot that has the lease.
        robot: RobotId,
    },
    /// The resource has no lease of this grant; common for repeated commands.
    #[error("{resource} has no lease of epoch {epoch}")]
    NoResourceLease {
        /// The charger or the device.
        resource: Resource,
        /// Position of the grant.
        epoch: Epoch,
    },
    /// The leases of chargers and devices exceed their size limit.
    #[error("the leases of chargers and devices would take more than {} bytes", RESOURCE_LEASES_BYTES_MAX)]
    ResourceLeasesFull,
}
