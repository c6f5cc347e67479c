//! Requests of clients in any language: JSON in, JSON out, on `consort/{fleet}/api/{submit,cancel,rescued,get,list}`.
//!
//! | call | asks | gets |
//! |---|---|---|
//! | `submit` | `{"mission": "lab-samples", "parameters": {"room": "IC Room 6"}, "request": "my-7"}`; `mission` may also be a whole mission file as an object; `request` may be left out, as may `priority` (-100 to 100, higher is served first, default 0) and `deadline_s` (seconds from now until the mission should be done) | `{"mission": "lab-samples-1", "again": false}` |
//! | `cancel` | `{"mission": "lab-samples-1", "by": "a nurse"}` | `{"mission": …, "state": …}` |
//! | `rescued` | `{"mission": "lab-samples-1", "by": "Nia"}`: what the mission left in robots' hands has been taken care of | `{"mission": …, "state": …}` |
//! | `get` | `{"mission": "lab-samples-1"}` | the mission, as `view/mission/{id}` has it |
//! | `list` | nothing | `{"missions": […]}` |
//!
//! What cannot be done gets `{"error": "…"}`, and nothing was changed. With `"retry_after_ms"` beside it the same may be
//! asked again after that time, with the same `request`: nobody coordinates yet, or the ledger could not be heard in time. A
//! submission is answered once the mission is committed; the same `request` again gets the same answer.
//!
//! A mission that is not done by its deadline is given up. Deadlines are kept by the coordinators' wall clocks.

use super::interregnum::RETRY_AFTER_MS;
use super::view;
use super::whereabouts::places;
use crate::gossip::SharedKnowledge;
use crate::replica::{ProposeError, Replica};
use consort_protocol::codec;
use consort_protocol::ids::{MissionId, RequestId};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{Command, Ledger, Outcome, Priority, Recovery, Submission, time_until_deadline};
use consort_protocol::mission::{Domain, Format, MissionTemplate, shipped};
use consort_protocol::plan::divide_and_check;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// How long the ledger may take to accept a request.
const LIMIT: Duration = Duration::from_secs(2);

/// Largest mission, divided and encoded, in bytes: its award and its call for bids must fit a message each.
const MISSION_MAX: usize = codec::LIMIT / 2;

/// What requests are carried out with.
#[derive(Clone)]
pub(super) struct Desk {
    pub(super) replica: Replica<Ledger>,
    pub(super) knowledge: SharedKnowledge,
    pub(super) domain: Arc<Domain>,
    /// For requests that bring no name of their own: unlike those of other coordinators.
    pub(super) request_prefix: String,
    pub(super) at_ms: u64,
    pub(super) number: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Submit {
    mission: Value,
    #[serde(default)]
    parameters: BTreeMap<String, String>,
    request: Option<RequestId>,
    #[serde(default)]
    priority: i64,
    deadline_s: Option<f64>,
}

/// Why there is no other answer.
struct Problem {
    text: String,
    /// Whether the same may be asked again.
    may_pass: bool,
}

impl From<String> for Problem {
    fn from(text: String) -> Problem {
        Problem { text, may_pass: false }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Cancel {
    mission: MissionId,
    #[serde(default = "a_client")]
    by: String,
}

fn a_client() -> String {
    "a client".to_owned()
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Get {
    mission: MissionId,
}

impl Desk {
    /// Carries a request out.
    pub(super) async fn serve(self, call: ApiCall, payload: &[u8]) -> Value {
        let answer = match call {
            ApiCall::Submit => self.submit(payload).await,
            ApiCall::Cancel => self.cancel(payload).await,
            ApiCall::Rescued => self.rescued(payload).await,
            ApiCall::Get => self.get(payload).await,
            ApiCall::List => self.list().await,
        };
        answer.unwrap_or_else(|Problem { text, may_pass }| match may_pass {
            true => json!({ "error": text, "retry_after_ms": RETRY_AFTER_MS }),
            false => json!({ "error": text }),
        })
    }

    async fn submit(&self, payload: &[u8]) -> Result<Value, Problem> {
        let asked: Submit = read(payload, r#"{"mission": "lab-samples", "parameters": {"room": "IC Room 6"}}"#)?;
        let submission = self.prepare(asked)?;
        match self.replica.propose(Command::Submit(Box::new(submission)), LIMIT).await {
            Ok(Outcome::Submitted { mission, again }) => Ok(json!({ "mission": mission, "again": again })),
            Ok(other) => Err(format!("the ledger answered {other:?}").into()),
            Err(problem) => Err(not_committed(&problem)),
        }
    }

    fn prepare(&self, asked: Submit) -> Result<Submission, String> {
        let template = match &asked.mission {
            Value::String(name) => shipped().get(name).cloned().ok_or_else(|| {
                let known: Vec<_> = shipped().keys().map(String::as_str).collect();
                format!("no mission {name:?} is shipped; there are {}", known.join(", "))
            })?,
            file => MissionTemplate::parse(&file.to_string(), Format::Json).map_err(|e| e.to_string())?,
        };
        let instance = template.instantiate_both(&asked.parameters, &self.domain);
        let (mission, recovery) = instance.map_err(|e| e.to_string())?;
        let division = divide_and_check(&mission).map_err(|e| e.to_string())?;
        let recovery = recovery.map(|mission| match divide_and_check(&mission) {
            Ok(division) => Ok(Recovery { mission, division }),
            Err(problem) => Err(format!("recovery: {problem}")),
        });
        let recovery = recovery.transpose()?;
        let priority = Priority::new(asked.priority).map_err(|e| e.to_string())?;
        let deadline_ms = match asked.deadline_s {
            None => None,
            Some(seconds) => {
                let time = time_until_deadline(seconds).map_err(|e| format!("deadline_s is {seconds}; {e}"))?;
                Some(self.at_ms.saturating_add(u64::try_from(time.as_millis()).unwrap_or(u64::MAX)))
            }
        };
        let request = match asked.request {
            Some(request) => request,
            None => RequestId::new(format!("{}-{}", self.request_prefix, self.number)).map_err(|e| e.to_string())?,
        };
        let (parameters, at_ms) = (asked.parameters, self.at_ms);
        let submission = Submission { request, mission, division, parameters, recovery, priority, deadline_ms, at_ms };
        match codec::encode(&submission) {
            Ok(bytes) if bytes.len() <= MISSION_MAX => Ok(submission),
            Ok(bytes) => Err(format!("the mission takes {} bytes, where {MISSION_MAX} are allowed", bytes.len())),
            Err(problem) => Err(format!("the mission is too large: {problem}")),
        }
    }

    async fn cancel(&self, payload: &[u8]) -> Result<Value, Problem> {
        let Cancel { mission, by } = read(payload, r#"{"mission": "lab-samples-1", "by": "a nurse"}"#)?;
        let places = self.replica.read(|ledger| places(&self.knowledge, ledger.mission(&mission)));
        self.change(mission.clone(), Command::Cancel { mission, by, places }).await
    }

    async fn rescued(&self, payload: &[u8]) -> Result<Value, Problem> {
        let Cancel { mission, by } = read(payload, r#"{"mission": "lab-samples-1", "by": "Nia"}"#)?;
        self.change(mission.clone(), Command::Rescued { mission, by }).await
    }

    async fn change(&self, mission: MissionId, command: Command) -> Result<Value, Problem> {
        match self.replica.propose(command, LIMIT).await {
            Ok(Outcome::Refused(refused)) => Err(refused.to_string().into()),
            Ok(_) => {
                let state = self.replica.read(|ledger| ledger.mission(&mission).map(|entry| entry.state.clone()));
                Ok(json!({ "mission": mission, "state": state }))
            }
            Err(problem) => Err(not_committed(&problem)),
        }
    }

    async fn get(&self, payload: &[u8]) -> Result<Value, Problem> {
        let Get { mission } = read(payload, r#"{"mission": "lab-samples-1"}"#)?;
        self.replica.ensure_leader(LIMIT).await.map_err(|problem| not_committed(&problem))?;
        self.replica
            .read(|ledger| ledger.mission(&mission).map(view::mission))
            .ok_or_else(|| format!("no mission {mission}").into())
    }

    async fn list(&self) -> Result<Value, Problem> {
        self.replica.ensure_leader(LIMIT).await.map_err(|problem| not_committed(&problem))?;
        Ok(self.replica.read(view::missions))
    }
}

fn read<T: serde::de::DeserializeOwned>(payload: &[u8], example: &str) -> Result<T, String> {
    serde_json::from_slice(payload).map_err(|problem| format!("{problem}; an example is {example}"))
}

fn not_committed(problem: &ProposeError) -> Problem {
    match problem {
        ProposeError::TooLarge { .. } | ProposeError::Unencodable { .. } => problem.to_string().into(),
        _ => Problem { text: format!("{problem}; the same request may be sent again"), may_pass: true },
    }
}
