//! One question to a fleet, whoever asks: the first answer that settles it.

use bytes::Bytes;
use consort_actors::bus::Bus;
use serde_json::Value;
use std::time::Duration;
use tokio::time::Instant;

/// How long to wait before asking again, where nothing else is said.
pub(crate) const RETRY_DELAY: Duration = Duration::from_millis(250);

/// Why there is no answer.
#[derive(Debug)]
pub(crate) enum QueryError {
    /// The request is wrong; asking again would not help.
    Rejected(String),
    /// It may work after that time.
    Retryable(String, Duration),
    /// Nobody answered.
    NoReply,
}

/// Who is asked.
#[derive(Debug, Clone, Copy)]
pub(crate) enum QueryTarget {
    /// The nearest node that can answer.
    Nearest,
    /// All, of whom the one answers whom it concerns.
    All,
}

impl QueryTarget {
    /// Who is missing if nobody answers.
    pub(crate) fn responder(self) -> &'static str {
        match self {
            QueryTarget::Nearest => "node",
            QueryTarget::All => "coordinator",
        }
    }
}

/// Asks once.
///
/// # Errors
/// [`Hindrance`] if nobody answers who can settle it.
pub(crate) async fn query_once(
    bus: &dyn Bus,
    key: &str,
    payload: &str,
    limit: Duration,
    whom: QueryTarget,
) -> Result<Value, QueryError> {
    let payload = Bytes::from(payload.to_owned());
    let asked = match whom {
        QueryTarget::Nearest => bus.query_nearest(key, payload, limit).await,
        QueryTarget::All => bus.query(key, payload, limit).await,
    };
    let mut replies = asked.map_err(|problem| QueryError::Retryable(problem.to_string(), RETRY_DELAY))?;
    let mut hindrance = QueryError::NoReply;
    // Whoever has just lost the coordination may answer too; the one who can act settles it, if it does soon.
    let mut until = Instant::now() + limit;
    while let Ok(Some(reply)) = tokio::time::timeout_at(until, replies.recv()).await {
        let answer = match reply.payload {
            Ok(bytes) => serde_json::from_slice::<Value>(&bytes).map_err(|e| format!("not JSON: {e}")),
            Err(refusal) => Err(refusal),
        };
        match answer {
            Ok(value) => match value.get("error").and_then(Value::as_str) {
                None => return Ok(value),
                Some(problem) => match value.get("retry_after_ms").and_then(Value::as_u64) {
                    Some(after) => {
                        let advice = format!(": retry after {after} ms");
                        let problem = problem.strip_suffix(&advice).unwrap_or(problem).to_owned();
                        hindrance = QueryError::Retryable(problem, Duration::from_millis(after));
                    }
                    None => return Err(QueryError::Rejected(problem.to_owned())),
                },
            },
            Err(problem) => hindrance = QueryError::Retryable(problem, RETRY_DELAY),
        }
        until = until.min(Instant::now() + RETRY_DELAY);
    }
    Err(hindrance)
}
