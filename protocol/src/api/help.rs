//! Descriptions of the calls, for clients.

use super::request::{
    AlarmRequest, AnswerRequest, CancelMissionsRequest, CloseRequest, HoldRequest, LimitRequest, MaintenanceRequest,
    MissionChangeRequest, MissionQuery, OpenRequest, PriorityRequest, ReadOptions, ReassignRequest, ReleaseRequest,
    ScheduleRequest, SubmitRequest, UpgradeRequest,
};
use crate::keys::ApiCall;
use schemars::{JsonSchema, Schema, schema_for};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// The calls on `api/**`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HelpReply {
    /// The calls, each with its key, description, example, and the JSON Schemas of payload and
    /// reply.
    pub calls: Vec<CallHelp>,
}

/// Description of a call.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CallHelp {
    /// Name of the call.
    pub call: String,
    /// Its key, below the prefix of the fleet.
    pub key: String,
    /// Meaning.
    pub what: String,
    /// The nodes that reply.
    pub answered_by: String,
    /// Example payload; null if there is no payload.
    pub example: Option<Value>,
    /// JSON Schema of the payload; null if there is no payload.
    pub payload_schema: Option<Schema>,
    /// JSON Schema of the reply.
    pub answer_schema: Schema,
    /// JSON Schema of an error reply.
    pub error_schema: Schema,
}

/// Returns an example payload of a call; `None` if it has no payload.
pub fn example(call: ApiCall) -> Option<Value> {
    match call {
        ApiCall::Submit => {
            Some(json!({ "mission": "vital-signs", "parameters": { "room_a": "IC Room 6" }, "request": "my-7" }))
        }
        ApiCall::Cancel => Some(json!({ "mission": "vital-signs-1", "by": "a clerk" })),
        ApiCall::CancelMissions => Some(json!({
            "missions": { "where": "mission.name == \"vital-signs\" && mission.age_s > 3600" }, "dry_run": true, "by": "Nia",
        })),
        ApiCall::Priority => Some(json!({ "mission": "vital-signs-1", "priority": 10, "by": "Nia" })),
        ApiCall::Reassign => Some(json!({ "mission": "vital-signs-1", "role": "r1", "to": "birch", "by": "Nia" })),
        ApiCall::Resolve => Some(json!({ "mission": "vital-signs-1", "by": "Nia" })),
        ApiCall::Get | ApiCall::Explain => Some(json!({ "mission": "vital-signs-1" })),
        ApiCall::Answer => {
            Some(json!({ "request": "vital-signs-1.1", "answer": "done", "results": { "dust_g": 3 }, "by": "Nia" }))
        }
        ApiCall::Schedule => Some(json!({
            "schedule": "rounds", "action": "add", "cron": "0 8 * * 1-5", "zone": "Europe/Berlin",
            "submit": { "mission": "vital-signs" }, "by": "Nia",
        })),
        ApiCall::Hold => Some(json!({ "robots": ["ada"], "for_s": 600, "reason": "a spill", "by": "Nia" })),
        ApiCall::Release => Some(json!({ "robots": "all", "by": "Nia" })),
        ApiCall::Maintenance => {
            Some(json!({ "robots": ["ada"], "action": "begin", "reason": "new tyres", "by": "Nia" }))
        }
        ApiCall::Close => {
            Some(json!({ "places": ["IC Room 6"], "lanes": [], "for_s": 3600, "reason": "wet floor", "by": "Nia" }))
        }
        ApiCall::Open => Some(json!({ "places": ["IC Room 6"], "by": "Nia" })),
        ApiCall::Limit => Some(json!({
            "places": ["IC Corridor 5"], "action": "set", "speed_mps": 0.3, "for_s": 3600, "reason": "wet floor",
            "by": "Nia",
        })),
        ApiCall::Alarm => Some(json!({ "action": "raise", "alarm": "fire", "reason": "smoke", "by": "Nia" })),
        ApiCall::List | ApiCall::Requests | ApiCall::Schedules | ApiCall::Audit => {
            Some(json!({ "linearizable": true }))
        }
        ApiCall::Upgrade => Some(json!({ "finish": false })),
        ApiCall::Help | ApiCall::Backup => None,
    }
}

/// Returns the JSON Schema of a call's payload; `None` if it has no payload.
pub fn payload_schema(call: ApiCall) -> Option<Schema> {
    match call {
        ApiCall::Submit => Some(schema_for!(SubmitRequest)),
        ApiCall::Cancel | ApiCall::Resolve => Some(schema_for!(MissionChangeRequest)),
        ApiCall::CancelMissions => Some(schema_for!(CancelMissionsRequest)),
        ApiCall::Priority => Some(schema_for!(PriorityRequest)),
        ApiCall::Reassign => Some(schema_for!(ReassignRequest)),
        ApiCall::Get | ApiCall::Explain => Some(schema_for!(MissionQuery)),
        ApiCall::Answer => Some(schema_for!(AnswerRequest)),
        ApiCall::Schedule => Some(schema_for!(ScheduleRequest)),
        ApiCall::Hold => Some(schema_for!(HoldRequest)),
        ApiCall::Release => Some(schema_for!(ReleaseRequest)),
        ApiCall::Maintenance => Some(schema_for!(MaintenanceRequest)),
        ApiCall::Close => Some(schema_for!(CloseRequest)),
        ApiCall::Open => Some(schema_for!(OpenRequest)),
        ApiCall::Limit => Some(schema_for!(LimitRequest)),
        ApiCall::Alarm => Some(schema_for!(AlarmRequest)),
        ApiCall::List | ApiCall::Requests | ApiCall::Schedules | ApiCall::Audit => Some(schema_for!(ReadOptions)),
        ApiCall::Upgrade => Some(schema_for!(UpgradeRequest)),
        ApiCall::Help | ApiCall::Backup => None,
    }
}
