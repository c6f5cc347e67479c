//! Replies to queries on the bus.

use crate::bus::{Encoding, Query};
use bytes::Bytes;
use consort_protocol::codec;
use serde::Serialize;
use serde::de::DeserializeOwned;
use tracing::{debug, warn};

/// Replies with a wire message on `key`, which must match the query's key expression.
pub async fn wire<T: Serialize>(query: &Query, key: &str, message: &T) {
    match codec::encode(message) {
        Ok(bytes) => send(query, key, Bytes::from(bytes), Encoding::Wire).await,
        Err(problem) => refuse(query, &problem.to_string()).await,
    }
}

/// Replies with JSON on `key`.
pub async fn json<T: Serialize>(query: &Query, key: &str, value: &T) {
    match serde_json::to_vec(value) {
        Ok(bytes) => send(query, key, Bytes::from(bytes), Encoding::Json).await,
        Err(problem) => refuse(query, &problem.to_string()).await,
    }
}

/// Replies with an error, and logs it.
pub async fn refuse(query: &Query, reason: &str) {
    warn!(key = query.key, reason, "refused a query");
    if let Err(problem) = query.replier.refuse(reason).await {
        debug!(%problem, "failed to send an error reply");
    }
}

/// Decodes a query's payload. Refuses a malformed query and returns `None`.
pub async fn decode_or_refuse<T: DeserializeOwned>(query: &Query) -> Option<T> {
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
        debug!(%problem, key, "failed to send a reply");
    }
}
