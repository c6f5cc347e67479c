//! Types of client requests and replies in any language: JSON in, JSON out, on
//! `consort/{fleet}/api/…`.
//!
//! | call | request | reply |
//! |---|---|---|
//! | `submit` | `{"mission": "lab-samples", "parameters": {"room": "IC Room 6"}, "request": "my-7"}`; `mission` may also be a whole mission file as an object; optional: `request`, `priority` (-100 to 100, higher is served first, default 0) and `deadline_s` (seconds from now until the mission should be completed) | `{"mission": "lab-samples-1", "again": false}` |
//! | `cancel` | `{"mission": "lab-samples-1", "by": "a nurse"}` | `{"mission": …, "state": …}` |
//! | `resolve` | `{"mission": "lab-samples-1", "by": "Nia"}`: the items that the mission left with robots have been taken care of | `{"mission": …, "state": …}` |
//! | `backup` | nothing | a copy of the ledger, with everything acknowledged before the request: see [`Backup`] |
//! | `upgrade` | `{"finish": false}`: the wire versions that each node reads; with `true` the fleet writes the next version from then on | `{"wire": 1, "next": 2, "nodes": […]}` |
//! | `get` | `{"mission": "lab-samples-1"}` | the mission, as in `view/mission/{id}` |
//! | `list` | nothing | `{"missions": […]}`, as in `view/missions` |
//! | `explain` | `{"mission": "lab-samples-1"}` | why each robot did or did not get each role |
//! | `help` | nothing | `{"calls": […]}`: all calls, with JSON Schemas; `api/{call}/help` returns a single call |
//!
//! Only the coordinator replies to the first 5 calls. All of them except `backup` may change state.
//! A request that cannot be executed gets `{"error": "…"}`, and nothing has changed. With an
//! additional `"retry_after_ms"` the same request, with the same `request` id, may be repeated
//! after that time: there is no coordinator yet, or the ledger did not commit in time. The reply to
//! a submission is sent once the mission is committed. Repeating the same `request` id gets the
//! same reply. Any node replies to the other calls (see [`crate::views`]).
//!
//! A mission that is not completed by its deadline fails. The coordinators' wall clocks decide
//! about deadlines.

use consort_protocol::ids::{MissionId, RequestId};
use consort_protocol::keys::ApiCall;
use consort_protocol::mission::FILE_BYTES_MAX;
use consort_raft::store::Backup;
use schemars::{JsonSchema, Schema, schema_for};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Submits a mission.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct SubmitRequest {
    /// The name of a shipped mission, or a whole mission file as an object.
    #[schemars(schema_with = "string_or_mission")]
    pub(crate) mission: Value,
    /// The values of the mission's parameters, by name.
    #[serde(default)]
    pub(crate) parameters: BTreeMap<String, String>,
    /// The client's id for this request. A repeated request with the same id is executed once.
    #[schemars(with = "Option<String>")]
    pub(crate) request: Option<RequestId>,
    /// Order in which waiting missions are served: higher priorities first.
    #[serde(default)]
    #[schemars(range(min = -100, max = 100))]
    pub(crate) priority: i64,
    /// Seconds from now until the mission should be completed; after that it fails.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub(crate) deadline_s: Option<f64>,
}

/// Changes a mission on behalf of a person.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct MissionChangeRequest {
    /// The mission.
    #[schemars(with = "String")]
    pub(crate) mission: MissionId,
    /// Name of the person, for display.
    #[serde(default = "default_name")]
    pub(crate) by: String,
}

/// Queries the progress of the upgrade to the next wire version.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct UpgradeRequest {
    /// The fleet writes the next version from now on. This cannot be undone.
    #[serde(default)]
    pub(crate) finish: bool,
}

/// Progress of the upgrade to the next wire version.
#[derive(Serialize, JsonSchema)]
pub(crate) struct UpgradeStatus {
    /// The version that the fleet writes.
    pub(crate) wire: u8,
    /// The next version; null if the coordinator's release reads no later version.
    pub(crate) next: Option<u8>,
    /// All nodes with a known record, and all voters, by name.
    pub(crate) nodes: Vec<NodeVersions>,
}

/// Wire versions that a node reads.
#[derive(Serialize, JsonSchema)]
pub(crate) struct NodeVersions {
    /// Id of the node.
    pub(crate) node: String,
    /// The node is considered alive.
    pub(crate) alive: bool,
    /// The oldest version that the node reads; null if no record of it is known.
    pub(crate) oldest: Option<u8>,
    /// The newest version.
    pub(crate) newest: Option<u8>,
    /// The node reads the next version; null if there is none.
    pub(crate) ready: Option<bool>,
}

/// Queries a mission.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct MissionQuery {
    /// The mission.
    #[schemars(with = "String")]
    pub(crate) mission: MissionId,
}

/// Acknowledged mission: it is committed and will not be lost.
#[derive(Serialize, JsonSchema)]
pub(crate) struct SubmitReply {
    /// Id of the mission.
    #[schemars(with = "String")]
    pub(crate) mission: MissionId,
    /// The mission had been submitted before, with the same request id.
    pub(crate) again: bool,
}

/// State of a mission after a change.
#[derive(Serialize, JsonSchema)]
pub(crate) struct MissionChangeReply<S> {
    /// The mission.
    #[schemars(with = "String")]
    pub(crate) mission: MissionId,
    /// Its state: a word, or an object with a single key and its details.
    #[schemars(schema_with = "string_or_object")]
    pub(crate) state: S,
}

/// Provenance of a reply.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub(crate) struct Provenance {
    /// The node that replies.
    pub(crate) seen_by: String,
    /// Age of its last beacon from the coordinator in milliseconds; 0 if it is the coordinator,
    /// null if it never received a beacon.
    pub(crate) age_ms: Option<u64>,
    /// The coordinator, as seen by this node; null if there is none.
    pub(crate) coordinator: Option<String>,
    /// Term of the coordinator.
    pub(crate) term: u64,
    /// Time by the node's clock, in milliseconds since 1970.
    pub(crate) at_ms: u64,
    /// Version of the program.
    pub(crate) version: String,
}

/// Reply with a summary of all missions.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "it says in JSON Schema what views/mission.rs makes")]
struct MissionListReply {
    #[serde(flatten)]
    provenance: Provenance,
    /// The missions in the order of submission.
    missions: Vec<MissionSummary>,
}

/// Summary of a mission.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "it says in JSON Schema what views/mission.rs makes")]
struct MissionSummary {
    /// Id of the mission.
    mission: String,
    /// State: pending, running, completed, failed, canceled or needs_intervention.
    state: String,
    /// Number of ended steps, over all managed roles.
    done: usize,
    /// Number of steps.
    steps: usize,
    /// Robots that hold or have completed each role.
    holders: BTreeMap<String, String>,
    /// Values of the parameters.
    parameters: BTreeMap<String, String>,
    /// Time of submission in milliseconds since 1970.
    submitted_at_ms: u64,
}

/// Reply with a single mission.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "it says in JSON Schema what views/mission.rs makes")]
struct MissionReply {
    #[serde(flatten)]
    provenance: Provenance,
    #[serde(flatten)]
    summary: MissionSummary,
    /// The tasks as a tree, each with its state, roles and holders.
    tree: Value,
    /// The roles, each with holder, epoch and steps.
    roles: Vec<Value>,
    /// The latest auction.
    auction: Option<Value>,
}

/// Reply that explains why each robot did or did not get each role.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "it says in JSON Schema what views/api.rs makes")]
struct ExplainReply {
    #[serde(flatten)]
    provenance: Provenance,
    /// The mission.
    mission: String,
    /// State: pending, running, completed, failed, canceled or needs_intervention.
    state: String,
    /// The latest auction by role and robot, each bid by step; null if no auction has taken place
    /// yet.
    explanation: Option<Value>,
    /// The same as text, with 1 entry per line.
    text: Vec<String>,
}

/// Reply with all calls.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "it says in JSON Schema what help() makes")]
struct HelpReply {
    /// The calls, each with its key, description, example, and the JSON Schemas of payload and
    /// reply.
    calls: Vec<Value>,
}

/// Error reply.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "it says in JSON Schema what every call may answer")]
struct ErrorReply {
    /// The problem, its location, and the allowed values.
    error: String,
    /// If present, the same request may be repeated after that time.
    retry_after_ms: Option<u64>,
}

fn string_or_mission(_: &mut schemars::SchemaGenerator) -> Schema {
    schemars::json_schema!({ "type": ["string", "object"] })
}

fn string_or_object(_: &mut schemars::SchemaGenerator) -> Schema {
    schemars::json_schema!({ "type": ["string", "object", "null"] })
}

fn default_name() -> String {
    "a client".to_owned()
}

/// Returns an example payload of a call; `None` if it has no payload.
fn example(call: ApiCall) -> Option<Value> {
    match call {
        ApiCall::Submit => {
            Some(json!({ "mission": "lab-samples", "parameters": { "room": "IC Room 6" }, "request": "my-7" }))
        }
        ApiCall::Cancel => Some(json!({ "mission": "lab-samples-1", "by": "a nurse" })),
        ApiCall::Resolve => Some(json!({ "mission": "lab-samples-1", "by": "Nia" })),
        ApiCall::Get | ApiCall::Explain => Some(json!({ "mission": "lab-samples-1" })),
        ApiCall::Upgrade => Some(json!({ "finish": false })),
        ApiCall::List | ApiCall::Help | ApiCall::Backup => None,
    }
}

/// Returns the JSON Schemas of a call's payload and reply.
fn schemas(call: ApiCall) -> (Option<Schema>, Schema) {
    match call {
        ApiCall::Submit => (Some(schema_for!(SubmitRequest)), schema_for!(SubmitReply)),
        ApiCall::Cancel | ApiCall::Resolve => {
            (Some(schema_for!(MissionChangeRequest)), schema_for!(MissionChangeReply<Value>))
        }
        ApiCall::Get => (Some(schema_for!(MissionQuery)), schema_for!(MissionReply)),
        ApiCall::List => (None, schema_for!(MissionListReply)),
        ApiCall::Explain => (Some(schema_for!(MissionQuery)), schema_for!(ExplainReply)),
        ApiCall::Help => (None, schema_for!(HelpReply)),
        ApiCall::Backup => (None, schema_for!(Backup)),
        ApiCall::Upgrade => (Some(schema_for!(UpgradeRequest)), schema_for!(UpgradeStatus)),
    }
}

/// Returns the description of a call.
pub(crate) fn call_help(call: ApiCall) -> Value {
    let about = consort_protocol::keys::Key::Api(call).info();
    let (payload, answer) = schemas(call);
    json!({
        "call": call.as_str(),
        "key": about.pattern,
        "what": about.what,
        "answered_by": about.who,
        "example": example(call),
        "payload_schema": payload,
        "answer_schema": answer,
        "error_schema": schema_for!(ErrorReply),
    })
}

/// Returns the descriptions of all calls on `api/**`, like `api/help`: key, meaning, example, and
/// the JSON Schemas of payload, reply and error.
pub fn help() -> Value {
    json!({ "calls": ApiCall::ALL.iter().map(|call| call_help(*call)).collect::<Vec<_>>() })
}

/// Maximum size of a request in bytes: twice the largest mission file, which may contain much white
/// space. Parsed, a request takes about 30 times as much memory.
const REQUEST_MAX: usize = 2 * FILE_BYTES_MAX;

/// Parses the payload of a call.
///
/// # Errors
/// A text with the field, its problem, the allowed values, and an example.
pub(crate) fn parse_request<T: serde::de::DeserializeOwned>(call: ApiCall, payload: &[u8]) -> Result<T, String> {
    if payload.len() > REQUEST_MAX {
        return Err(format!("the request has {} bytes; the limit is {REQUEST_MAX}", payload.len()));
    }
    let fields = serde_json::from_slice::<Value>(payload);
    let type_error = fields.ok().and_then(|payload| type_error(call, &payload));
    let read = match type_error {
        Some(problem) => Err(problem),
        None => serde_json::from_slice(payload).map_err(|problem| problem.to_string()),
    };
    read.map_err(|problem| {
        let example = example(call).map(|example| format!("; an example is {example}")).unwrap_or_default();
        format!("{problem}{example}; see api/{}/help", call.as_str())
    })
}

/// Returns a description of the first field with a wrong type, according to the call's own schema.
fn type_error(call: ApiCall, payload: &Value) -> Option<String> {
    let schema = schemas(call).0?.to_value();
    let Value::Object(fields) = payload else {
        return Some(format!("the payload is {}; allowed is an object", kind(payload)));
    };
    fields.iter().find_map(|(name, value)| {
        let allowed: Vec<&str> = match &schema["properties"][name]["type"] {
            Value::String(name) => vec![name],
            Value::Array(types) => types.iter().filter_map(Value::as_str).collect(),
            _ => return None,
        };
        let matches = allowed.iter().any(|allowed| match *allowed {
            "integer" => value.is_i64() || value.is_u64(),
            "number" => value.is_number(),
            "null" => value.is_null(),
            other => kind(value).ends_with(other),
        });
        if matches {
            let is_map = name == "parameters";
            let wrong = value.as_object().into_iter().flatten().find(|(_, value)| !value.is_string());
            return wrong
                .filter(|_| is_map)
                .map(|(key, value)| format!("{name}.{key} is {}; allowed is a string", kind(value)));
        }
        let allowed: Vec<&str> = allowed.into_iter().filter(|kind| *kind != "null").collect();
        Some(format!("{name} is {}; allowed is {}", kind(value), allowed.join(" or ")))
    })
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "a boolean",
        Value::Number(_) => "a number",
        Value::String(_) => "a string",
        Value::Array(_) => "an array",
        Value::Object(_) => "an object",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_example_is_accepted_by_its_call_and_its_schema() {
        for call in ApiCall::ALL {
            let Some(example) = example(*call) else { continue };
            let bytes = example.to_string();
            let taken = match call {
                ApiCall::Submit => parse_request::<SubmitRequest>(*call, bytes.as_bytes()).map(drop),
                ApiCall::Cancel | ApiCall::Resolve => {
                    parse_request::<MissionChangeRequest>(*call, bytes.as_bytes()).map(drop)
                }
                ApiCall::Get | ApiCall::Explain => parse_request::<MissionQuery>(*call, bytes.as_bytes()).map(drop),
                ApiCall::Upgrade => parse_request::<UpgradeRequest>(*call, bytes.as_bytes()).map(drop),
                ApiCall::List | ApiCall::Help | ApiCall::Backup => Ok(()),
            };
            assert_eq!(taken, Ok(()), "{}", call.as_str());
            assert_eq!(type_error(*call, &example), None, "{}", call.as_str());
        }
    }

    #[test]
    fn the_schemas_match_the_parsed_types() {
        let help = help();
        let of = |call: &str| {
            let calls = help["calls"].as_array().unwrap();
            calls.iter().find(|help| help["call"] == call).unwrap().clone()
        };
        let submit = of("submit");
        let properties = submit["payload_schema"]["properties"].as_object().unwrap();
        let names: Vec<&str> = properties.keys().map(String::as_str).collect();
        assert_eq!(names, ["deadline_s", "mission", "parameters", "priority", "request"]);
        assert_eq!(submit["payload_schema"]["required"], json!(["mission"]));
        assert_eq!(submit["payload_schema"]["additionalProperties"], json!(false));
        assert_eq!(submit["answer_schema"]["required"], json!(["mission", "again"]));
        assert_eq!(of("list")["payload_schema"], Value::Null);
        assert_eq!(help["calls"].as_array().unwrap().len(), ApiCall::ALL.len());
    }

    #[test]
    fn a_request_above_the_size_limit_is_rejected() {
        let long = format!("{{\"mission\": \"lab-samples-1\", \"by\": \"{}\"}}", "x".repeat(REQUEST_MAX));
        let error = parse_request::<MissionChangeRequest>(ApiCall::Cancel, long.as_bytes()).map(drop).unwrap_err();
        assert_eq!(error, format!("the request has {} bytes; the limit is {REQUEST_MAX}", long.len()));
    }

    #[test]
    fn a_payload_error_names_its_field() {
        let problem =
            |payload: &str| parse_request::<SubmitRequest>(ApiCall::Submit, payload.as_bytes()).map(drop).unwrap_err();
        for (payload, expected_start) in [
            (r#"{"mission": 7}"#, "mission is a number; allowed is string or object; an example is {"),
            (r#"{"mission": "a", "priority": "high"}"#, "priority is a string; allowed is integer; an"),
            (r#"{"mission": "a", "deadline_s": [1]}"#, "deadline_s is an array; allowed is number; an"),
            (r#"{"mission": "a", "parameters": {"room": 6}}"#, "parameters.room is a number; allowed is a string; an"),
            (r#"{"mision": "a"}"#, "unknown field `mision`, expected one of `mission`"),
            ("[]", "the payload is an array; allowed is an object; an"),
            ("{}", "missing field `mission`"),
        ] {
            let error = problem(payload);
            assert!(error.starts_with(expected_start), "{payload}: {error}");
            assert!(error.ends_with("see api/submit/help"), "{error}");
        }
    }
}
