//! Parts of the fleet model, as serialised for clients.

use super::charge_trend::{ChargeForecast, ChargeTrend};
use consort_protocol::auction::BidPart;
use consort_protocol::cause::CauseClass;
use consort_protocol::knowledge::Charging;
use consort_protocol::ledger::{Branch, HeldItem, RobotOrders, RolePhase};
use consort_protocol::mission::{RoleKind, TaskNode};
use consort_protocol::scalar::Scalar;
use consort_protocol::view::{NodeStatus, PromiseView};
use serde::Serialize;
use std::collections::BTreeMap;

/// Reachability of the fleet from the observing node.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Reachability {
    /// The state.
    pub state: ReachabilityState,
    /// Number of links to other nodes.
    pub links: usize,
    /// Start of this state.
    pub since_ms: u64,
    /// Time of the last contact with a coordinator.
    pub last_contact_ms: Option<u64>,
}

/// State of the connection to the fleet.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ReachabilityState {
    /// A coordinator is reachable.
    Connected,
    /// Other nodes are linked, but no coordinator is reachable.
    #[default]
    NoCoordinator,
    /// No node is linked.
    Isolated,
}

/// The coordinator.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct CoordinatorModel {
    /// The node.
    pub node: String,
    /// Its term.
    pub term: u64,
    /// Start of its leadership.
    pub since_ms: u64,
    /// Time of the last acknowledgement by a majority of the voters.
    pub quorum_ms: Option<u64>,
    /// Voters of the ledger.
    pub voters: Vec<String>,
    /// Learners of the ledger.
    pub learners: Vec<String>,
    /// Permanently lost voters.
    pub voters_lost: Vec<String>,
}

/// A change of the coordinator.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Takeover {
    /// Time of the change.
    pub at_ms: u64,
    /// The new coordinator.
    pub node: String,
    /// Its term.
    pub term: u64,
    /// The former coordinator, if known.
    pub from: Option<String>,
    /// Time from the last message of the former coordinator to the first message of the next, in
    /// milliseconds.
    pub gap_ms: Option<u64>,
}

/// A node.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(crate) struct NodeModel {
    /// True if it counts as alive.
    pub alive: bool,
    /// Its membership status.
    pub status: NodeStatus,
    /// Time of the last contact.
    pub last_contact_ms: u64,
    /// True if it may become a voter.
    pub may_vote: bool,
    /// True if it does not move.
    pub stationary: bool,
    /// True if it runs on mains power.
    pub mains_powered: bool,
    /// True if it is being decommissioned.
    pub leaving: bool,
    /// True if it has a robot.
    pub robot: bool,
}

/// A robot.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RobotModel {
    /// True if its node counts as alive.
    pub alive: bool,
    /// The current place, or the last passed place.
    pub place: String,
    /// Metres to the east of the map's origin.
    pub x: f64,
    /// Metres to the north.
    pub y: f64,
    /// Heading in radians, counter-clockwise from east.
    pub yaw: f64,
    /// Charge, as a share.
    pub battery: f64,
    /// Charge below which it takes no work, as a share.
    pub useful_charge: f64,
    /// Time of the next threshold of the charge, if the charge changes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub forecast: Option<ChargeForecast>,
    /// Samples of the charge since its availability has changed.
    #[serde(skip)]
    pub(super) charge_trend: ChargeTrend,
    /// Charging of a free robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub charging: Option<Charging>,
    /// True if it can move.
    pub can_move: bool,
    /// `free`, `charging`, `holding`, `suspended` or `out_of_service`.
    pub availability: String,
    /// Reason for being out of service, or the orders of people to it.
    pub problem: Option<String>,
    /// Orders of people to it, as far as the observing node knows them.
    #[serde(skip_serializing_if = "RobotOrders::is_empty")]
    pub orders: RobotOrders,
    /// The current mission.
    pub mission: Option<String>,
    /// The role in the mission.
    pub role: Option<String>,
    /// Roles that it gets later, in their order, as far as the observing node knows them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub next: Vec<NextRole>,
    /// The current task.
    pub task: Option<String>,
    /// The destination.
    pub destination: Option<String>,
    /// Places of the route ahead.
    pub route: Vec<String>,
    /// Its average speed in metres per second.
    pub speed: Option<f64>,
    /// The skills.
    pub skills: Vec<String>,
    /// Latest readings of its driver, by name.
    pub readings: BTreeMap<String, Scalar>,
    /// Latest values of the feedback of its goal in progress, by name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub feedback: BTreeMap<String, Scalar>,
    /// Time of the last contact with its node.
    pub last_contact_ms: u64,
    /// Time of the last telemetry.
    pub telemetry_ms: Option<u64>,
}

/// A role that a robot gets later.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct NextRole {
    /// The mission.
    pub mission: String,
    /// The role in it.
    pub role: String,
    /// Planned start.
    pub start_ms: u64,
    /// Estimated duration in milliseconds, at the speed of its world.
    pub planned_ms: Option<u64>,
}

/// A person.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct PersonModel {
    /// The role in missions.
    pub role: String,
    /// The place.
    pub place: String,
    /// True if the person has left the place.
    pub away: bool,
    /// Samples to hand over.
    pub samples: Vec<String>,
    /// Metres to the east of the map's origin, if the place is on the map.
    pub x: Option<f64>,
    /// Metres to the north.
    pub y: Option<f64>,
}

/// A mission.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct MissionModel {
    /// Sequence number of the submission.
    pub number: u64,
    /// The state.
    pub state: String,
    /// Reason of the failure or cancellation, or the needed intervention.
    pub cause: Option<String>,
    /// Class of the reason of a failure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cause_class: Option<CauseClass>,
    /// True if the fleet does no more work on it.
    pub ended: bool,
    /// Priority; higher is served first.
    pub priority: i64,
    /// The deadline.
    pub deadline_ms: Option<u64>,
    /// The executed tree.
    pub branch: Branch,
    /// Parameters of the request.
    pub parameters: BTreeMap<String, String>,
    /// Results that are known.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub result: BTreeMap<String, Scalar>,
    /// Results of its tasks, by task and name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub task_results: BTreeMap<String, BTreeMap<String, Scalar>>,
    /// Robot of each role.
    pub holders: BTreeMap<String, String>,
    /// Orders of people about roles, as text.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub orders: BTreeMap<String, String>,
    /// Finished steps.
    pub done: u64,
    /// Total steps.
    pub steps: u64,
    /// Reason why it is still pending.
    pub pending_reason: Option<String>,
    /// Items in robots' hands.
    pub items: Option<Vec<HeldItem>>,
    /// Time of the acknowledgement.
    pub submitted_ms: u64,
    /// Time of the first award.
    pub awarded_ms: Option<u64>,
    /// Time from the request to the award, in milliseconds.
    pub award_after_ms: Option<f64>,
    /// Time of the end.
    pub ended_ms: Option<u64>,
    /// Its roles.
    pub roles: BTreeMap<String, RoleModel>,
    /// The tree: a list of tasks; the first is the root, children are indices.
    pub tasks: Option<Vec<TaskNode>>,
    /// True if the whole mission was received after its end.
    #[serde(skip)]
    pub(super) is_complete: bool,
    /// Task bars of the chart, as far as received.
    pub bars: Vec<TaskBar>,
    /// Role assignments over time, as far as received.
    pub assignments: Vec<RoleAssignment>,
}

/// A role of a mission.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RoleModel {
    /// Kind of role.
    pub kind: RoleKind,
    /// The phase.
    pub phase: RolePhase,
    /// The holder.
    pub holder: Option<String>,
    /// The epoch of the award.
    pub epoch: Option<String>,
    /// The plan.
    pub steps: Option<Vec<StepModel>>,
    /// Planned start, if the role is promised.
    pub promise: Option<PromiseView>,
}

/// A step of a role's plan.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct StepModel {
    /// Type of the task, or of the message.
    #[serde(rename = "type")]
    pub step_type: String,
    /// Name of the task, or the signal.
    pub label: String,
    /// True if it has ended.
    pub done: bool,
}

/// A task on the chart.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TaskBar {
    /// The role.
    pub role: String,
    /// The task.
    pub task: String,
    /// The robot or person.
    pub by: String,
    /// Start.
    pub from_ms: u64,
    /// End.
    pub to_ms: Option<u64>,
    /// `running`, `done`, `failed`, or `broken off`.
    pub state: String,
}

/// The assignment of a role to a robot, with its times.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RoleAssignment {
    /// The role.
    pub role: String,
    /// The robot.
    pub by: String,
    /// Start of the assignment, or the time when it was first seen.
    pub from_ms: u64,
    /// End of the assignment.
    pub to_ms: Option<u64>,
    /// `at work`, `suspended`, `carried out`, `given up` or `broken off`.
    pub state: String,
    /// Planned duration by the robot's bid, in milliseconds at the speed of its world, if both are
    /// known.
    pub planned_ms: Option<u64>,
}

/// A round of an auction.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct AuctionModel {
    /// The mission.
    pub mission: String,
    /// The coordinator's term.
    pub term: u64,
    /// The round.
    pub round: u64,
    /// Closing time.
    pub at_ms: u64,
    /// The assignment, by role.
    pub chosen: BTreeMap<String, String>,
    /// Reason if no robot was assigned.
    pub failure: Option<String>,
    /// Answers left out of the record.
    pub omitted: u64,
    /// Every answer, in the order of roles and robots.
    pub offers: Vec<RoleBid>,
}

/// A robot's bid or refusal for a role.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RoleBid {
    /// The role.
    pub role: String,
    /// The robot.
    pub robot: String,
    /// `bid`, `unviable` or `refused`.
    pub verdict: String,
    /// True if it won.
    pub chosen: bool,
    /// Time for the plan, in seconds.
    pub time_s: Option<f64>,
    /// Charge used, as a share.
    pub energy: Option<f64>,
    /// Charge left, as a share.
    pub remaining: Option<f64>,
    /// Reason if it was not accepted.
    pub why: Option<String>,
    /// Start place of the estimate.
    pub from: Option<String>,
    /// The parts of the price: label, skill, time and energy.
    pub parts: Option<Vec<BidPart>>,
}

/// An ensemble: members, and other nodes with the reason.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct EnsembleModel {
    /// Membership conditions, as expressions of the fleet file.
    pub membership: Vec<String>,
    /// Required skills.
    pub skills: Vec<String>,
    /// Nodes without contact for longer than this are not members, in milliseconds.
    pub stale_after_ms: Option<u64>,
    /// Members.
    pub members: Vec<String>,
    /// Other nodes, each with the reason.
    pub non_members: BTreeMap<String, String>,
}

/// An event in the log.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LogEntry {
    /// Time by the clock of the publishing node.
    pub at_ms: u64,
    /// The publishing node.
    pub node: String,
    /// Kind of event: its name in the stream.
    pub kind: String,
    /// Label of the kind, for people.
    pub label: String,
    /// Description.
    pub text: String,
    /// The mission, if any.
    pub mission: Option<String>,
    /// The robot, if any.
    pub robot: Option<String>,
    /// True if the event needs attention.
    pub alarm: bool,
}
