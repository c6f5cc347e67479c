//! Requests of clients in any language: JSON in, JSON out, on `consort/{fleet}/api/…`.
//!
//! | call | asks | gets |
//! |---|---|---|
//! | `submit` | `{"mission": "lab-samples", "parameters": {"room": "IC Room 6"}, "request": "my-7"}`; `mission` may also be a whole mission file as an object; `request` may be left out, as may `priority` (-100 to 100, higher is served first, default 0) and `deadline_s` (seconds from now until the mission should be done) | `{"mission": "lab-samples-1", "again": false}` |
//! | `cancel` | `{"mission": "lab-samples-1", "by": "a nurse"}` | `{"mission": …, "state": …}` |
//! | `rescued` | `{"mission": "lab-samples-1", "by": "Nia"}`: what the mission left in robots' hands has been taken care of | `{"mission": …, "state": …}` |
//! | `backup` | nothing | a copy of the ledger, with all that was acknowledged before it was asked for: see [`Backup`] |
//! | `upgrade` | `{"finish": false}`: which versions of the wire each node reads; with `true` the fleet writes the next one from then on | `{"wire": 1, "next": 2, "nodes": […]}` |
//! | `get` | `{"mission": "lab-samples-1"}` | the mission, as `view/mission/{id}` has it |
//! | `list` | nothing | `{"missions": […]}`, as `view/missions` has it |
//! | `explain` | `{"mission": "lab-samples-1"}` | why each robot did or did not get each role |
//! | `help` | nothing | `{"calls": […]}`: all this, with JSON Schemas; `api/{call}/help` has one call |
//!
//! The first five are answered by the coordinator alone; all of them but `backup` may change something. What cannot be done gets `{"error": "…"}`,
//! and nothing was changed. With `"retry_after_ms"` beside it the same may be asked again after that time, with the same
//! `request`: nobody coordinates yet, or the ledger could not be heard in time. A submission is answered once the mission
//! is committed; the same `request` again gets the same answer. The others are answered by any node (see [`crate::views`]).
//!
//! A mission that is not done by its deadline is given up. Deadlines are kept by the coordinators' wall clocks.

use crate::store::Backup;
use consort_protocol::ids::{MissionId, RequestId};
use consort_protocol::keys::ApiCall;
use consort_protocol::mission::FILE_BYTES_MAX;
use schemars::{JsonSchema, Schema, schema_for};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Asks for a mission.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct SubmitRequest {
    /// The name of a mission that is shipped, or a whole mission file as an object.
    #[schemars(schema_with = "name_or_file")]
    pub(crate) mission: Value,
    /// What the mission's parameters are in this case, by their names.
    #[serde(default)]
    pub(crate) parameters: BTreeMap<String, String>,
    /// The client's name for this request: made again under the same name, it is done once.
    #[schemars(with = "Option<String>")]
    pub(crate) request: Option<RequestId>,
    /// Which of two waiting missions is served first: the one of higher priority.
    #[serde(default)]
    #[schemars(range(min = -100, max = 100))]
    pub(crate) priority: i64,
    /// Seconds from now until the mission should be done; then it is given up.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub(crate) deadline_s: Option<f64>,
}

/// Says something of a mission, on somebody's word.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct MissionChangeRequest {
    /// The mission.
    #[schemars(with = "String")]
    pub(crate) mission: MissionId,
    /// On whose word, to show.
    #[serde(default = "a_client")]
    pub(crate) by: String,
}

/// Asks how far the fleet is on its way to the next version of the wire.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct UpgradeRequest {
    /// Whether the fleet shall write the next version from now on, which cannot be taken back.
    #[serde(default)]
    pub(crate) finish: bool,
}

/// How far the fleet is on its way to the next version of the wire.
#[derive(Serialize, JsonSchema)]
pub(crate) struct UpgradeStatus {
    /// The version that the fleet writes.
    pub(crate) wire: u8,
    /// The next one; null if the coordinator's release reads none later.
    pub(crate) next: Option<u8>,
    /// Everybody of whom something is known or who keeps the ledger, by name.
    pub(crate) nodes: Vec<NodeVersions>,
}

/// Which versions of the wire a node reads.
#[derive(Serialize, JsonSchema)]
pub(crate) struct NodeVersions {
    /// Its name.
    pub(crate) node: String,
    /// Whether it is believed to be there.
    pub(crate) alive: bool,
    /// The oldest version that it reads; null if nothing is known of it.
    pub(crate) oldest: Option<u8>,
    /// The newest.
    pub(crate) newest: Option<u8>,
    /// Whether it reads the next version; null if there is none.
    pub(crate) ready: Option<bool>,
}

/// Asks about a mission.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct MissionQuery {
    /// The mission.
    #[schemars(with = "String")]
    pub(crate) mission: MissionId,
}

/// A mission that was acknowledged: it is committed, and will not be lost.
#[derive(Serialize, JsonSchema)]
pub(crate) struct SubmitReply {
    /// Its id.
    #[schemars(with = "String")]
    pub(crate) mission: MissionId,
    /// Whether it had been asked for before, under the same name.
    pub(crate) again: bool,
}

/// How a mission stands after what was asked.
#[derive(Serialize, JsonSchema)]
pub(crate) struct MissionChangeReply<S> {
    /// The mission.
    #[schemars(with = "String")]
    pub(crate) mission: MissionId,
    /// Its state: a word, or an object of one word with what belongs to it.
    #[schemars(schema_with = "word_or_object")]
    pub(crate) state: S,
}

/// Whoever looks gets this beside what was asked for.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub(crate) struct Provenance {
    /// The node that answers.
    pub(crate) seen_by: String,
    /// How long ago it last had word from the coordinator, in milliseconds; 0 if it is the coordinator, null if it never had.
    pub(crate) age_ms: Option<u64>,
    /// Who coordinates, as it believes; null if nobody does.
    pub(crate) coordinator: Option<String>,
    /// In which term.
    pub(crate) term: u64,
    /// What time it is by its clock, in milliseconds since 1970.
    pub(crate) at_ms: u64,
    /// Which version of the program it is.
    pub(crate) version: String,
}

/// Missions, briefly.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "it says in JSON Schema what views/mission.rs makes")]
struct Listed {
    #[serde(flatten)]
    mark: Provenance,
    /// In the order in which they were submitted.
    missions: Vec<Brief>,
}

/// A mission, briefly.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "it says in JSON Schema what views/mission.rs makes")]
struct Brief {
    /// Its id.
    mission: String,
    /// One of pending, running, completed, failed, canceled, needs_rescue.
    state: String,
    /// Steps ended, over all roles of robots.
    done: usize,
    /// Steps in all.
    steps: usize,
    /// Who holds or has carried out which role.
    holders: BTreeMap<String, String>,
    /// What was given for its parameters.
    parameters: BTreeMap<String, String>,
    /// When it was submitted, in milliseconds since 1970.
    submitted_at_ms: u64,
}

/// A mission.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "it says in JSON Schema what views/mission.rs makes")]
struct Told {
    #[serde(flatten)]
    mark: Provenance,
    #[serde(flatten)]
    brief: Brief,
    /// Its tasks as a tree, each with its state, roles and holders.
    tree: Value,
    /// Its roles, each with holder, epoch and steps.
    roles: Vec<Value>,
    /// Its latest auction.
    auction: Option<Value>,
}

/// Why each robot did or did not get each role.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "it says in JSON Schema what views/api.rs makes")]
struct Explained {
    #[serde(flatten)]
    mark: Provenance,
    /// The mission.
    mission: String,
    /// One of pending, running, completed, failed, canceled, needs_rescue.
    state: String,
    /// The latest auction, role by role and robot by robot, each bid step by step; null if none was held yet.
    explanation: Option<Value>,
    /// The same in sentences, one a line.
    words: Vec<String>,
}

/// All calls there are.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "it says in JSON Schema what help() makes")]
struct Calls {
    /// Each with its key, what it does, an example, and the JSON Schemas of payload and answer.
    calls: Vec<Value>,
}

/// What was not done, and why.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "it says in JSON Schema what every call may answer")]
struct Error {
    /// What is wrong, where, and what is allowed.
    error: String,
    /// If it is there, the same may be asked again after that time.
    retry_after_ms: Option<u64>,
}

fn name_or_file(_: &mut schemars::SchemaGenerator) -> Schema {
    schemars::json_schema!({ "type": ["string", "object"] })
}

fn word_or_object(_: &mut schemars::SchemaGenerator) -> Schema {
    schemars::json_schema!({ "type": ["string", "object", "null"] })
}

fn a_client() -> String {
    "a client".to_owned()
}

/// An example of what a call takes; nothing if it takes nothing.
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

/// What a call takes and what it answers, as JSON Schemas.
fn schemas(call: ApiCall) -> (Option<Schema>, Schema) {
    match call {
        ApiCall::Submit => (Some(schema_for!(SubmitRequest)), schema_for!(SubmitReply)),
        ApiCall::Cancel | ApiCall::Resolve => {
            (Some(schema_for!(MissionChangeRequest)), schema_for!(MissionChangeReply<Value>))
        }
        ApiCall::Get => (Some(schema_for!(MissionQuery)), schema_for!(Told)),
        ApiCall::List => (None, schema_for!(Listed)),
        ApiCall::Explain => (Some(schema_for!(MissionQuery)), schema_for!(Explained)),
        ApiCall::Help => (None, schema_for!(Calls)),
        ApiCall::Backup => (None, schema_for!(Backup)),
        ApiCall::Upgrade => (Some(schema_for!(UpgradeRequest)), schema_for!(UpgradeStatus)),
    }
}

/// How a call is made.
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
        "error_schema": schema_for!(Error),
    })
}

/// How every call on `api/**` is made, as `api/help` answers: key, meaning, example, and the JSON Schemas of payload, answer and
/// error.
pub fn help() -> Value {
    json!({ "calls": ApiCall::ALL.iter().map(|call| call_help(*call)).collect::<Vec<_>>() })
}

/// Largest request in bytes: twice the largest mission file, which may be written with much space in it. Read, it takes some
/// thirty times as much memory.
const REQUEST_MAX: usize = 2 * FILE_BYTES_MAX;

/// Reads what a call was given.
///
/// # Errors
/// What is wrong in words: which field, what is wrong with it, what is allowed, and an example.
pub(crate) fn parse_request<T: serde::de::DeserializeOwned>(call: ApiCall, payload: &[u8]) -> Result<T, String> {
    if payload.len() > REQUEST_MAX {
        return Err(format!("the request has {} bytes, where {REQUEST_MAX} are allowed", payload.len()));
    }
    let fields = serde_json::from_slice::<Value>(payload);
    let misfit = fields.ok().and_then(|payload| misfit(call, &payload));
    let read = match misfit {
        Some(problem) => Err(problem),
        None => serde_json::from_slice(payload).map_err(|problem| problem.to_string()),
    };
    read.map_err(|what| {
        let example = example(call).map(|example| format!("; an example is {example}")).unwrap_or_default();
        format!("{what}{example}; api/{}/help has the whole", call.as_str())
    })
}

/// Which field is of the wrong kind, by the call's own schema.
fn misfit(call: ApiCall, payload: &Value) -> Option<String> {
    let schema = schemas(call).0?.to_value();
    let Value::Object(fields) = payload else {
        return Some(format!("the payload is {}; allowed is an object", kind(payload)));
    };
    fields.iter().find_map(|(name, value)| {
        let allowed: Vec<&str> = match &schema["properties"][name]["type"] {
            Value::String(one) => vec![one],
            Value::Array(several) => several.iter().filter_map(Value::as_str).collect(),
            _ => return None,
        };
        let fits = allowed.iter().any(|allowed| match *allowed {
            "integer" => value.is_i64() || value.is_u64(),
            "number" => value.is_number(),
            "null" => value.is_null(),
            other => kind(value).ends_with(other),
        });
        if fits {
            let of_wrong_kind = name == "parameters";
            let wrong = value.as_object().into_iter().flatten().find(|(_, value)| !value.is_string());
            return wrong
                .filter(|_| of_wrong_kind)
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
    fn every_example_is_taken_by_its_call_and_fits_its_schema() {
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
            assert_eq!(misfit(*call, &example), None, "{}", call.as_str());
        }
    }

    #[test]
    fn the_schemas_are_of_the_types_that_are_read() {
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
    fn a_request_that_is_too_large_is_not_read() {
        let long = format!("{{\"mission\": \"lab-samples-1\", \"by\": \"{}\"}}", "x".repeat(REQUEST_MAX));
        let said = parse_request::<MissionChangeRequest>(ApiCall::Cancel, long.as_bytes()).map(drop).unwrap_err();
        assert_eq!(said, format!("the request has {} bytes, where {REQUEST_MAX} are allowed", long.len()));
    }

    #[test]
    fn what_is_wrong_with_a_payload_is_said_by_field() {
        let problem =
            |payload: &str| parse_request::<SubmitRequest>(ApiCall::Submit, payload.as_bytes()).map(drop).unwrap_err();
        for (payload, says) in [
            (r#"{"mission": 7}"#, "mission is a number; allowed is string or object; an example is {"),
            (r#"{"mission": "a", "priority": "high"}"#, "priority is a string; allowed is integer; an"),
            (r#"{"mission": "a", "deadline_s": [1]}"#, "deadline_s is an array; allowed is number; an"),
            (r#"{"mission": "a", "parameters": {"room": 6}}"#, "parameters.room is a number; allowed is a string; an"),
            (r#"{"mision": "a"}"#, "unknown field `mision`, expected one of `mission`"),
            ("[]", "the payload is an array; allowed is an object; an"),
            ("{}", "missing field `mission`"),
        ] {
            let said = problem(payload);
            assert!(said.starts_with(says), "{payload}: {said}");
            assert!(said.ends_with("api/submit/help has the whole"), "{said}");
        }
    }
}
