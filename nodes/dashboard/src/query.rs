//! A single query to a fleet: returns the first reply that settles it.

use bytes::Bytes;
use consort_bus::{Bus, BusError, Reply, ServiceSelection, Stream};
use consort_protocol::api::ErrorReply;
use serde::Deserialize;
use serde_json::Value;
use std::time::Duration;
use tokio::time::Instant;

/// Default delay before a query is repeated.
pub const RETRY_DELAY: Duration = Duration::from_millis(250);

/// Reason why a query has no answer.
#[derive(Debug)]
pub enum QueryError {
    /// The request is wrong; repeating it would not help.
    Rejected(String),
    /// The query may succeed after this time.
    Retryable(String, Duration),
    /// No node replied.
    NoReply,
}

/// Receivers of a query.
#[derive(Debug, Clone, Copy)]
pub enum QueryTarget {
    /// The nearest node that can reply.
    Nearest,
    /// Every node; only the addressed node replies.
    All,
}

impl QueryTarget {
    /// Returns the kind of node that is missing if there is no reply.
    pub fn responder(self) -> &'static str {
        match self {
            QueryTarget::Nearest => "node",
            QueryTarget::All => "coordinator",
        }
    }
}

/// Sends a query and waits for the first reply that settles it.
///
/// # Errors
/// [`QueryError`] if no such reply arrives.
pub async fn query_once(
    bus: &dyn Bus,
    key: &str,
    payload: &str,
    limit: Duration,
    whom: QueryTarget,
) -> Result<Value, QueryError> {
    let selection = match whom {
        QueryTarget::Nearest => ServiceSelection::Nearest,
        QueryTarget::All => ServiceSelection::All,
    };
    let payload = Bytes::from(payload.to_owned());
    settle(bus.query_with(key, payload, Bytes::new(), limit, selection).await, limit).await
}

/// Does the same for a request to the coordinator that the person of a token authorizes. Without a
/// token, in an open fleet, it is empty.
pub(crate) async fn query_with_token(
    bus: &dyn Bus,
    key: &str,
    payload: &str,
    token: &str,
    limit: Duration,
) -> Result<Value, QueryError> {
    let [payload, token] = [payload, token].map(|text| Bytes::from(text.to_owned()));
    settle(bus.query_with(key, payload, token, limit, ServiceSelection::All).await, limit).await
}

async fn settle(asked: Result<Stream<Reply>, BusError>, limit: Duration) -> Result<Value, QueryError> {
    let mut replies = asked.map_err(|problem| QueryError::Retryable(problem.to_string(), RETRY_DELAY))?;
    let mut hindrance = QueryError::NoReply;
    // A node that has just lost the leadership may reply too. The reply of the new leader settles
    // the query if it arrives soon.
    let mut until = Instant::now() + limit;
    while let Ok(Some(reply)) = tokio::time::timeout_at(until, replies.recv()).await {
        let answer = match reply.payload {
            Ok(bytes) => serde_json::from_slice::<Value>(&bytes).map_err(|e| format!("not JSON: {e}")),
            Err(refusal) => Err(refusal.to_string()),
        };
        match answer {
            Ok(value) => match ErrorReply::deserialize(&value) {
                Err(_) => return Ok(value),
                Ok(ErrorReply { error, retry_after_ms: Some(after) }) => {
                    let advice = format!(": retry after {after} ms");
                    let problem = error.strip_suffix(&advice).unwrap_or(&error).to_owned();
                    hindrance = QueryError::Retryable(problem, Duration::from_millis(after));
                }
                Ok(ErrorReply { error, retry_after_ms: None }) => return Err(QueryError::Rejected(error)),
            },
            Err(problem) => hindrance = QueryError::Retryable(problem, RETRY_DELAY),
        }
        until = until.min(Instant::now() + RETRY_DELAY);
    }
    Err(hindrance)
}
