//! Parser of request payloads. An error names the field, the problem and the allowed values.

use super::help::{example, payload_schema};
use super::request::ReadOptions;
use crate::keys::ApiCall;
use crate::mission::FILE_BYTES_MAX;
use serde::de::DeserializeOwned;
use serde_json::Value;

/// The payload of a request is wrong. Nothing was executed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RequestError {
    /// The payload is too large.
    #[error("the request has {bytes} bytes; the limit is {REQUEST_MAX}")]
    TooLarge {
        /// Size of the payload.
        bytes: usize,
    },
    /// The payload has another form. The text contains an example.
    #[error("{problem}{}; see api/{}/help", example_text(*.call), .call.as_str())]
    Invalid {
        /// The call.
        call: ApiCall,
        /// The field with its problem and the allowed values.
        problem: String,
    },
}

fn example_text(call: ApiCall) -> String {
    example(call).map(|example| format!("; an example is {example}")).unwrap_or_default()
}

/// Maximum size of a request in bytes: twice the largest mission file, which may contain much white
/// space. Parsed, a request takes about 30 times as much memory.
const REQUEST_MAX: usize = 2 * FILE_BYTES_MAX;

/// Parses the payload of a call.
///
/// # Errors
/// [`RequestError`]. Nothing was executed.
pub fn parse_request<T: DeserializeOwned>(call: ApiCall, payload: &[u8]) -> Result<T, RequestError> {
    if payload.len() > REQUEST_MAX {
        return Err(RequestError::TooLarge { bytes: payload.len() });
    }
    let fields = serde_json::from_slice::<Value>(payload);
    let type_error = fields.ok().and_then(|payload| type_error(call, &payload));
    let read = match type_error {
        Some(problem) => Err(problem),
        None => serde_json::from_slice(payload).map_err(|problem| problem.to_string()),
    };
    read.map_err(|problem| RequestError::Invalid { call, problem })
}

/// Parses the payload of a call whose only parameters are [`ReadOptions`]. No payload, or `null`, means
/// the default.
///
/// # Errors
/// [`RequestError`].
pub fn parse_read_options(call: ApiCall, payload: &[u8]) -> Result<ReadOptions, RequestError> {
    match payload {
        b"" | b"null" => Ok(ReadOptions::default()),
        payload => parse_request(call, payload),
    }
}

/// Returns a description of the first field with a wrong type, according to the call's own schema.
fn type_error(call: ApiCall, payload: &Value) -> Option<String> {
    let schema = payload_schema(call)?.to_value();
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
    use super::super::request::{
        AlarmRequest, AnswerRequest, CancelMissionsRequest, CloseRequest, HoldRequest, LimitRequest,
        MaintenanceRequest, MissionChangeRequest, MissionQuery, OpenRequest, PriorityRequest, ReassignRequest,
        ReleaseRequest, ScheduleRequest, SubmitRequest, UpgradeRequest,
    };
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
                ApiCall::CancelMissions => parse_request::<CancelMissionsRequest>(*call, bytes.as_bytes()).map(drop),
                ApiCall::Priority => parse_request::<PriorityRequest>(*call, bytes.as_bytes()).map(drop),
                ApiCall::Reassign => parse_request::<ReassignRequest>(*call, bytes.as_bytes()).map(drop),
                ApiCall::Get | ApiCall::Explain => parse_request::<MissionQuery>(*call, bytes.as_bytes()).map(drop),
                ApiCall::Upgrade => parse_request::<UpgradeRequest>(*call, bytes.as_bytes()).map(drop),
                ApiCall::Answer => parse_request::<AnswerRequest>(*call, bytes.as_bytes()).map(drop),
                ApiCall::Schedule => parse_request::<ScheduleRequest>(*call, bytes.as_bytes()).map(drop),
                ApiCall::Hold => parse_request::<HoldRequest>(*call, bytes.as_bytes()).map(drop),
                ApiCall::Release => parse_request::<ReleaseRequest>(*call, bytes.as_bytes()).map(drop),
                ApiCall::Maintenance => parse_request::<MaintenanceRequest>(*call, bytes.as_bytes()).map(drop),
                ApiCall::Close => parse_request::<CloseRequest>(*call, bytes.as_bytes()).map(drop),
                ApiCall::Open => parse_request::<OpenRequest>(*call, bytes.as_bytes()).map(drop),
                ApiCall::Limit => parse_request::<LimitRequest>(*call, bytes.as_bytes()).map(drop),
                ApiCall::Alarm => parse_request::<AlarmRequest>(*call, bytes.as_bytes()).map(drop),
                ApiCall::List | ApiCall::Requests | ApiCall::Schedules | ApiCall::Audit => {
                    parse_read_options(*call, bytes.as_bytes()).map(drop)
                }
                ApiCall::Help | ApiCall::Backup => Ok(()),
            };
            assert_eq!(taken, Ok(()), "{}", call.as_str());
            assert_eq!(type_error(*call, &example), None, "{}", call.as_str());
        }
    }

    #[test]
    fn options_of_a_read_may_be_omitted() {
        let read = |payload: &str| parse_read_options(ApiCall::List, payload.as_bytes());
        for payload in ["", "null", "{}", r#"{"linearizable": false}"#] {
            assert_eq!(read(payload), Ok(ReadOptions { linearizable: false }), "{payload}");
        }
        assert_eq!(read(r#"{"linearizable": true}"#), Ok(ReadOptions { linearizable: true }));
        let error = read(r#"{"linearizable": "yes"}"#).unwrap_err().to_string();
        assert!(error.starts_with("linearizable is a string; allowed is boolean; an example is {"), "{error}");
    }

    #[test]
    fn a_request_above_the_size_limit_is_rejected() {
        let long = format!("{{\"mission\": \"vital-signs-1\", \"by\": \"{}\"}}", "x".repeat(REQUEST_MAX));
        let error =
            parse_request::<MissionChangeRequest>(ApiCall::Cancel, long.as_bytes()).map(drop).unwrap_err().to_string();
        assert_eq!(error, format!("the request has {} bytes; the limit is {REQUEST_MAX}", long.len()));
    }

    #[test]
    fn a_payload_error_names_its_field() {
        let problem = |payload: &str| {
            parse_request::<SubmitRequest>(ApiCall::Submit, payload.as_bytes()).unwrap_err().to_string()
        };
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
