//! Answering queries.

use crate::bus::{Encoding, Query};
use bytes::Bytes;
use consort_protocol::codec;
use serde::Serialize;
use serde::de::DeserializeOwned;
use tracing::{debug, warn};

/// Answers with a wire message, on the key that was asked or, for an expression, on `key`.
pub(crate) async fn wire<T: Serialize>(query: &Query, key: &str, message: &T) {
    match codec::encode(message) {
        Ok(bytes) => send(query, key, Bytes::from(bytes), Encoding::Wire).await,
        Err(problem) => refuse(query, &problem.to_string()).await,
    }
}

/// Answers with JSON.
pub(crate) async fn json<T: Serialize>(query: &Query, key: &str, value: &T) {
    match serde_json::to_vec(value) {
        Ok(bytes) => send(query, key, Bytes::from(bytes), Encoding::Json).await,
        Err(problem) => refuse(query, &problem.to_string()).await,
    }
}

/// Answers that there is no answer, and why.
pub(crate) async fn refuse(query: &Query, reason: &str) {
    warn!(key = query.key, reason, "refused");
    if let Err(problem) = query.replier.refuse(reason).await {
        debug!(%problem, "a refusal was not sent");
    }
}

/// Reads a query's content; a malformed one is refused, and `None`.
pub(crate) async fn decode_or_refuse<T: DeserializeOwned>(query: &Query) -> Option<T> {
    match codec::decode(&query.payload) {
        Ok(message) => Some(message),
        Err(problem) => {
            refuse(query, &problem.to_string()).await;
            None
        }
    }
}

async fn send(query: &Query, key: &str, bytes: Bytes, encoding: Encoding) {
    if let Err(problem) = query.replier.reply(key, bytes, encoding).await {
        debug!(%problem, key, "an answer was not sent");
    }
}
