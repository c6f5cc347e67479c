//! One question to a fleet, whoever asks: the first answer that settles it.

use bytes::Bytes;
use consort_actors::bus::Bus;
use serde_json::Value;
use std::time::Duration;
use tokio::time::Instant;

/// How long to wait before asking again, where nothing else is said.
pub(crate) const AGAIN: Duration = Duration::from_millis(250);

/// Why there is no answer.
#[derive(Debug)]
pub(crate) enum Hindrance {
    /// The request is wrong; asking again would not help.
    Refused(String),
    /// It may work after that time.
    MayPass(String, Duration),
    /// Nobody answered.
    Silence,
}

/// Who is asked.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Whom {
    /// The nearest node that can answer.
    Nearest,
    /// All, of whom the one answers whom it concerns.
    All,
}

impl Whom {
    /// Who is missing if nobody answers.
    pub(crate) fn word(self) -> &'static str {
        match self {
            Whom::Nearest => "node",
            Whom::All => "coordinator",
        }
    }
}

/// Asks once.
///
/// # Errors
/// [`Hindrance`] if nobody answers who can settle it.
pub(crate) async fn once(
    bus: &dyn Bus,
    key: &str,
    payload: &str,
    limit: Duration,
    whom: Whom,
) -> Result<Value, Hindrance> {
    let payload = Bytes::from(payload.to_owned());
    let asked = match whom {
        Whom::Nearest => bus.query_nearest(key, payload, limit).await,
        Whom::All => bus.query(key, payload, limit).await,
    };
    let mut replies = asked.map_err(|problem| Hindrance::MayPass(problem.to_string(), AGAIN))?;
    let mut hindrance = Hindrance::Silence;
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
                        hindrance = Hindrance::MayPass(problem, Duration::from_millis(after));
                    }
                    None => return Err(Hindrance::Refused(problem.to_owned())),
                },
            },
            Err(problem) => hindrance = Hindrance::MayPass(problem, AGAIN),
        }
        until = until.min(Instant::now() + AGAIN);
    }
    Err(hindrance)
}
