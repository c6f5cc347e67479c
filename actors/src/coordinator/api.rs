//! Requests of clients in any language: JSON in, JSON out, on `consort/{fleet}/api/{submit,cancel,get,list}`.
//!
//! | call | asks | gets |
//! |---|---|---|
//! | `submit` | `{"mission": "lab-samples", "parameters": {"room": "IC Room 6"}, "request": "my-7"}`; `mission` may also be a whole mission file as an object; `request` may be left out | `{"mission": "lab-samples-1", "again": false}` |
//! | `cancel` | `{"mission": "lab-samples-1", "by": "a nurse"}` | `{"mission": …, "state": …}` |
//! | `get` | `{"mission": "lab-samples-1"}` | the mission, as `view/mission/{id}` has it |
//! | `list` | nothing | `{"missions": […]}` |
//!
//! What cannot be done gets `{"error": "…"}`, and nothing was changed. A submission is answered once the mission is
//! committed; the same `request` again gets the same answer.

use super::view;
use crate::replica::{ProposeError, Replica};
use consort_protocol::codec;
use consort_protocol::ids::{MissionId, RequestId};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{Command, Ledger, Outcome, Submission};
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
            ApiCall::Get => self.get(payload).await,
            ApiCall::List => self.list().await,
        };
        answer.unwrap_or_else(|problem| json!({ "error": problem }))
    }

    async fn submit(&self, payload: &[u8]) -> Result<Value, String> {
        let asked: Submit = read(payload, r#"{"mission": "lab-samples", "parameters": {"room": "IC Room 6"}}"#)?;
        let submission = self.prepare(asked)?;
        match self.replica.propose(Command::Submit(Box::new(submission)), LIMIT).await {
            Ok(Outcome::Submitted { mission, again }) => Ok(json!({ "mission": mission, "again": again })),
            Ok(other) => Err(format!("the ledger answered {other:?}")),
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
        let mission = template.instantiate(&asked.parameters, &self.domain).map_err(|e| e.to_string())?;
        let division = divide_and_check(&mission).map_err(|e| e.to_string())?;
        let request = match asked.request {
            Some(request) => request,
            None => RequestId::new(format!("{}-{}", self.request_prefix, self.number)).map_err(|e| e.to_string())?,
        };
        let submission = Submission { request, mission, division, parameters: asked.parameters, at_ms: self.at_ms };
        match codec::encode(&submission) {
            Ok(bytes) if bytes.len() <= MISSION_MAX => Ok(submission),
            Ok(bytes) => Err(format!("the mission takes {} bytes, where {MISSION_MAX} are allowed", bytes.len())),
            Err(problem) => Err(format!("the mission is too large: {problem}")),
        }
    }

    async fn cancel(&self, payload: &[u8]) -> Result<Value, String> {
        let Cancel { mission, by } = read(payload, r#"{"mission": "lab-samples-1", "by": "a nurse"}"#)?;
        match self.replica.propose(Command::Cancel { mission: mission.clone(), by }, LIMIT).await {
            Ok(Outcome::Refused(refused)) => Err(refused.to_string()),
            Ok(_) => {
                let state = self.replica.read(|ledger| ledger.mission(&mission).map(|entry| entry.state.clone()));
                Ok(json!({ "mission": mission, "state": state }))
            }
            Err(problem) => Err(not_committed(&problem)),
        }
    }

    async fn get(&self, payload: &[u8]) -> Result<Value, String> {
        let Get { mission } = read(payload, r#"{"mission": "lab-samples-1"}"#)?;
        self.replica.ensure_leader(LIMIT).await.map_err(|problem| not_committed(&problem))?;
        self.replica
            .read(|ledger| ledger.mission(&mission).map(view::mission))
            .ok_or_else(|| format!("no mission {mission}"))
    }

    async fn list(&self) -> Result<Value, String> {
        self.replica.ensure_leader(LIMIT).await.map_err(|problem| not_committed(&problem))?;
        Ok(self.replica.read(view::missions))
    }
}

fn read<T: serde::de::DeserializeOwned>(payload: &[u8], example: &str) -> Result<T, String> {
    serde_json::from_slice(payload).map_err(|problem| format!("{problem}; an example is {example}"))
}

fn not_committed(problem: &ProposeError) -> String {
    format!("{problem}; the same request may be sent again")
}
