//! Replies to queries on the bus.

use crate::bus::{Encoding, Query};
use crate::tasks::Tasks;
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

/// Replies like [`wire`], in the background: an actor that must not wait for the bus uses this.
pub fn wire_in<T: Serialize + Send + Sync + 'static>(tasks: &mut Tasks, query: Query, key: String, message: T) {
    tasks.spawn(async move { wire(&query, &key, &message).await });
}

/// Replies like [`json`] on the key of the query, in the background.
pub fn json_in<T: Serialize + Send + Sync + 'static>(tasks: &mut Tasks, query: Query, value: T) {
    tasks.spawn(async move { json(&query, &query.key, &value).await });
}

/// Refuses like [`refuse`], in the background.
pub fn refuse_in(tasks: &mut Tasks, query: Query, reason: String) {
    tasks.spawn(async move { refuse(&query, &reason).await });
}

/// Decodes a query's payload. Refuses a malformed query in the background and returns `None`.
pub fn decode_or_refuse_in<T: DeserializeOwned>(tasks: &mut Tasks, query: Query) -> Option<(Query, T)> {
    match codec::decode(&query.payload) {
        Ok(message) => Some((query, message)),
        Err(problem) => {
            refuse_in(tasks, query, problem.to_string());
            None
        }
    }
}

async fn send(query: &Query, key: &str, bytes: Bytes, encoding: Encoding) {
    if let Err(problem) = query.replier.reply(key, bytes, encoding).await {
        debug!(%problem, key, "failed to send a reply");
    }
}
