//! Replies to requests.

use crate::auction::Explanation;
use crate::ids::{MissionId, NodeId, RobotId, RoleId};
use crate::ledger::{
    Alarm, Closure, MissionState, PersonRequestId, PersonRequestPhase, Priority, RobotOrders, RolePhase, RoleRelease,
    SpeedLimit,
};
use crate::view::{MissionStateName, ScheduleView};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Acknowledged mission: it is committed and will not be lost.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SubmitReply {
    /// Id of the mission.
    pub mission: MissionId,
    /// The mission had been submitted before, with the same request id.
    #[serde(default)]
    pub again: bool,
    /// Outcome of the mission, if the request is repeated after its end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outcome: Option<MissionState>,
}

/// State of a mission after a change.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct MissionChangeReply {
    /// The mission.
    pub mission: MissionId,
    /// Its state: a word, or an object with a single key and its details. Null if the ledger no
    /// longer contains the mission.
    pub state: Option<MissionState>,
}

/// Missions after their cancelation.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct CancelMissionsReply {
    /// The missions that were canceled, or would be, with their states now. A state is null if the ledger no longer
    /// contains the mission.
    pub missions: BTreeMap<MissionId, Option<MissionState>>,
    /// Selected missions that were left out, each with the reason.
    pub refused: BTreeMap<MissionId, String>,
    /// The request had been executed before, and changed nothing now; the audit trail lists its missions.
    pub again: bool,
}

/// Priority of a mission after a change.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct PriorityReply {
    /// The mission.
    pub mission: MissionId,
    /// Its priority; null if the ledger no longer contains the mission.
    pub priority: Option<Priority>,
}

/// A role after a reassignment or a pin. The robot of a reassigned role returns it later.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ReassignReply {
    /// The mission.
    pub mission: MissionId,
    /// The role.
    pub role: RoleId,
    /// Its phase; null if the ledger no longer contains the mission.
    pub phase: Option<RolePhase>,
    /// Its robot; null for none.
    pub robot: Option<RobotId>,
    /// The order about the role, as text; null for none.
    pub order: Option<String>,
}

/// A request to a person after an answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct AnswerReply {
    /// The request.
    pub request: PersonRequestId,
    /// Its phase.
    pub phase: Option<PersonRequestPhase>,
}

/// A schedule after a change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ScheduleReply {
    /// The schedule; null if it was removed.
    pub schedule: Option<ScheduleView>,
}

/// Orders to robots after a change.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct OrdersReply {
    /// The robots of the request, with their orders.
    pub robots: BTreeMap<RobotId, RobotOrders>,
}

/// Closures after a change.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ClosuresReply {
    /// All closed zones, places and lanes.
    pub closures: Vec<Closure>,
}

/// Speed limits after a change.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct LimitsReply {
    /// All speed limits.
    pub speed_limits: Vec<SpeedLimit>,
}

/// Alarms after a change.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct AlarmsReply {
    /// All alarms in force.
    pub alarms: Vec<Alarm>,
}

/// Progress of the upgrade to the next wire version.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct UpgradeReply {
    /// The version that the fleet writes.
    pub wire: u8,
    /// The next version; null if the coordinator's release reads no later version.
    pub next: Option<u8>,
    /// All nodes with a known record, and all voters, by name.
    pub nodes: Vec<NodeVersions>,
}

/// Wire versions that a node reads.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct NodeVersions {
    /// Id of the node.
    pub node: NodeId,
    /// The node is considered alive.
    pub alive: bool,
    /// The oldest version that the node reads; null if no record of it is known.
    pub oldest: Option<u8>,
    /// The newest version.
    pub newest: Option<u8>,
    /// The node reads the next version; null if there is none.
    pub ready: Option<bool>,
}

/// Explanation of the assignment of a mission's roles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ExplainReply {
    /// The mission.
    pub mission: MissionId,
    /// Its state.
    pub state: MissionStateName,
    /// The latest auction by role and robot, each bid by step; null if no auction has taken place
    /// yet.
    pub explanation: Option<Explanation>,
    /// Robots without a bid response in that auction.
    pub not_asked: Vec<UninvitedRobot>,
    /// Latest releases of its roles, oldest first.
    pub releases: Vec<RoleRelease>,
    /// The same as text, with 1 entry per line.
    pub text: Vec<String>,
}

/// Robot that was not invited to an auction.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct UninvitedRobot {
    /// The robot's node.
    pub robot: NodeId,
    /// Reason, as a sentence.
    pub why: String,
}

/// Error reply.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ErrorReply {
    /// The problem, its location, and the allowed values.
    pub error: String,
    /// If present, the same request may be repeated after that time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub retry_after_ms: Option<u64>,
}

impl ErrorReply {
    /// Creates a reply to a request that is wrong: repeating it would not help.
    pub fn rejected(error: impl Into<String>) -> ErrorReply {
        ErrorReply { error: error.into(), retry_after_ms: None }
    }

    /// Creates a reply to a request that may be repeated after a time in milliseconds.
    pub fn retry_after(error: impl Into<String>, retry_after_ms: u64) -> ErrorReply {
        ErrorReply { error: error.into(), retry_after_ms: Some(retry_after_ms) }
    }
}
