//! Forwards requests of the page to the coordinator.

use crate::admission::AuthenticatedClient;
use crate::query::{QueryError, QueryTarget, RETRY_DELAY, query_once, query_with_token};
use consort_bus::SharedBus;
use consort_protocol::api::MissionChangeRequest;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::{ApiCall, Key, Keys};
use serde::Serialize;
use serde_json::{Map, Value};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// Limit of a request: enough for several leader changes.
const LIMIT: Duration = Duration::from_secs(8);

/// Limit of a single query. The coordinator itself gives up on the ledger after 2 s.
const ONE_QUERY: Duration = Duration::from_secs(3);

/// Reason why a request was not carried out.
#[derive(Debug)]
pub(super) enum ForwardError {
    /// The coordinator rejected the request.
    Rejected(String),
    /// No coordinator was reached.
    Unreachable(String),
}

/// Forwards requests.
pub(super) struct RequestForwarder {
    bus: SharedBus,
    keys: Keys,
    node: String,
    /// Addresses of the fleet's dashboards.
    dashboards: Vec<String>,
    /// Number of requests without a name of their own.
    unnamed_requests: AtomicU64,
}

impl RequestForwarder {
    pub(super) fn new(bus: SharedBus, keys: Keys, node: &str, dashboards: Vec<String>) -> RequestForwarder {
        RequestForwarder { bus, keys, node: node.to_owned(), dashboards, unnamed_requests: AtomicU64::new(0) }
    }

    /// Submits a mission, in the format of the API. The same `request` returns the same mission. A
    /// request without a name gets a generated name, so that it can be repeated until it is
    /// answered.
    pub(super) async fn submit(
        &self,
        mut request: Value,
        client: Option<&AuthenticatedClient>,
        now_ms: u64,
    ) -> Result<Value, ForwardError> {
        let Some(fields) = request.as_object_mut() else {
            let what = r#"a request is an object, as {"mission": "lab-samples", "parameters": {"room": "IC Room 6"}}"#;
            return Err(ForwardError::Rejected(what.to_owned()));
        };
        let number = self.unnamed_requests.fetch_add(1, Ordering::Relaxed);
        fields.entry("request").or_insert_with(|| format!("page-{now_ms}-{number}").into());
        self.query(ApiCall::Submit, &request, client).await
    }

    /// Cancels or resolves a mission on behalf of a person.
    pub(super) async fn act_on_mission(
        &self,
        call: ApiCall,
        mission: &MissionId,
        by: Option<String>,
        client: Option<&AuthenticatedClient>,
    ) -> Result<Value, ForwardError> {
        let by = by.or_else(|| self.unknown_person(client));
        self.query(call, &MissionChangeRequest { mission: mission.clone(), by }, client).await
    }

    /// Sends a request that names a responsible person, in the format of the API.
    pub(super) async fn act(
        &self,
        call: ApiCall,
        mut fields: Map<String, Value>,
        client: Option<&AuthenticatedClient>,
    ) -> Result<Value, ForwardError> {
        if let Some(by) = self.unknown_person(client) {
            fields.entry("by").or_insert_with(|| by.into());
        }
        self.query(call, &fields, client).await
    }

    /// Returns the name of a person that has not signed in and states none.
    fn unknown_person(&self, client: Option<&AuthenticatedClient>) -> Option<String> {
        client.is_none().then(|| format!("the dashboard of {}", self.node))
    }

    /// Returns the addresses of the fleet's dashboards.
    pub(super) fn dashboards(&self) -> &[String] {
        &self.dashboards
    }

    /// Reads a list or a view, from the nearest node.
    pub(super) async fn read(&self, key: Key) -> Result<Value, ForwardError> {
        let key = self.keys.write(&key);
        query_once(&*self.bus, &key, "", ONE_QUERY, QueryTarget::Nearest).await.map_err(|problem| match problem {
            QueryError::Rejected(problem) => ForwardError::Rejected(problem),
            QueryError::Retryable(problem, _) => ForwardError::Unreachable(problem),
            QueryError::NoReply => ForwardError::Unreachable("no node answers".to_owned()),
        })
    }

    /// Answers a request to a person.
    pub(super) async fn answer(
        &self,
        fields: &Map<String, Value>,
        client: Option<&AuthenticatedClient>,
    ) -> Result<Value, ForwardError> {
        self.query(ApiCall::Answer, fields, client).await
    }

    /// Sends a request with the token of the visitor, who authorizes it.
    async fn query(
        &self,
        call: ApiCall,
        request: &impl Serialize,
        client: Option<&AuthenticatedClient>,
    ) -> Result<Value, ForwardError> {
        let token = client.map(AuthenticatedClient::forwarded_token).unwrap_or_default();
        let payload = serde_json::to_string(request).expect("a request serializes to JSON");
        let key = self.keys.write(&Key::Api(call));
        let until = Instant::now() + LIMIT;
        loop {
            let (problem, after) = match query_with_token(&*self.bus, &key, &payload, token, ONE_QUERY).await {
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
