//! Requests of people at the page, handed to whoever coordinates.

use crate::query::{QueryError, QueryTarget, RETRY_DELAY, query_once};
use consort_actors::bus::SharedBus;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::{ApiCall, Key, Keys};
use serde_json::{Value, json};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// How long a request may take: some takeovers.
const LIMIT: Duration = Duration::from_secs(8);

/// How long one question may take. The coordinator itself gives up on the ledger after 2 s.
const ONE_QUERY: Duration = Duration::from_secs(3);

/// Why a request was not carried out.
#[derive(Debug)]
pub(super) enum ForwardError {
    /// It is wrong.
    Rejected(String),
    /// Nobody could be found who carries it out.
    Unreachable(String),
}

/// Hands requests over.
pub(super) struct RequestForwarder {
    bus: SharedBus,
    keys: Keys,
    node: String,
    /// Counts requests that bring no name of their own.
    count: AtomicU64,
}

impl RequestForwarder {
    pub(super) fn new(bus: SharedBus, keys: Keys, node: &str) -> RequestForwarder {
        RequestForwarder { bus, keys, node: node.to_owned(), count: AtomicU64::new(0) }
    }

    /// Submits a mission, as the API takes it. Whoever asks again under the same `request` gets the same mission; one that
    /// brings none is given one here, so that it can be repeated until somebody answers.
    pub(super) async fn submit(&self, mut request: Value, now_ms: u64) -> Result<Value, ForwardError> {
        let Some(fields) = request.as_object_mut() else {
            let what = r#"a request is an object, as {"mission": "lab-samples", "parameters": {"room": "IC Room 6"}}"#;
            return Err(ForwardError::Rejected(what.to_owned()));
        };
        let number = self.count.fetch_add(1, Ordering::Relaxed);
        fields.entry("request").or_insert_with(|| json!(format!("page-{now_ms}-{number}")));
        self.ask(ApiCall::Submit, &request).await
    }

    /// Has something done to a mission by somebody's word: withdraws it, or closes it after a rescue.
    pub(super) async fn act_on_mission(
        &self,
        call: ApiCall,
        mission: &MissionId,
        by: Option<String>,
    ) -> Result<Value, ForwardError> {
        let by = by.unwrap_or_else(|| format!("the dashboard of {}", self.node));
        self.ask(call, &json!({ "mission": mission, "by": by })).await
    }

    async fn ask(&self, call: ApiCall, request: &Value) -> Result<Value, ForwardError> {
        let (key, payload) = (self.keys.write(&Key::Api(call)), request.to_string());
        let until = Instant::now() + LIMIT;
        loop {
            let (problem, after) = match query_once(&*self.bus, &key, &payload, ONE_QUERY, QueryTarget::All).await {
                Ok(answer) => return Ok(answer),
                Err(QueryError::Rejected(problem)) => return Err(ForwardError::Rejected(problem)),
                Err(QueryError::Retryable(problem, after)) => (problem, after.max(RETRY_DELAY)),
                Err(QueryError::NoReply) => ("no coordinator answers".to_owned(), RETRY_DELAY),
            };
            if Instant::now() + after >= until {
                return Err(ForwardError::Unreachable(format!("{problem}; tried for {} s", LIMIT.as_secs())));
            }
            sleep(after).await;
        }
    }
}
