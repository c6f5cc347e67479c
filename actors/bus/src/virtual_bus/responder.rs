//! Replies of a service on the virtual bus.

use super::ids::{Incarnation, NodeIndex, QueryPart};
use crate::author::Author;
use crate::bus::{BusError, Encoding, MESSAGE_MAX, QueryRefused, Replier, Reply};
use crate::keys;
use async_trait::async_trait;
use bytes::Bytes;
use std::sync::{Arc, Weak};
use tokio::sync::OwnedSemaphorePermit;
use zenoh_keyexpr::OwnedKeyExpr;

/// A query, shared by all its parts.
pub(super) struct QueryRequest {
    pub(super) key_expr: OwnedKeyExpr,
    pub(super) parameters: String,
    pub(super) payload: Bytes,
    pub(super) attachment: Bytes,
}

impl QueryRequest {
    /// Returns the size in bytes.
    pub(super) fn bytes(&self) -> usize {
        self.key_expr.len() + self.parameters.len() + self.payload.len() + self.attachment.len()
    }

    /// Returns the reply of a service that refuses the query.
    pub(super) fn refusal(&self, reason: &str) -> Reply {
        Reply {
            key: self.key_expr.to_string(),
            payload: Err(QueryRefused(reason.to_owned())),
            attachment: Bytes::new(),
            author: Author::UNKNOWN,
        }
    }
}

/// Receiver of the replies of services: the network.
#[async_trait]
pub(super) trait ReplySink: Send + Sync {
    /// Sends a reply of a part. `incarnation` is the node of the service.
    fn reply(self: Arc<Self>, incarnation: Incarnation, part: QueryPart, reply: Reply) -> Result<(), BusError>;

    /// Waits until the operations of a node are not blocked.
    async fn until_unblocked(&self, node: NodeIndex);

    /// Notes that a service has ended a part. Called while the network may be in use.
    fn finish(&self, part: QueryPart);
}

/// Returns the error of a reply that cannot be sent.
pub(super) fn reply_failed(problem: &str) -> BusError {
    BusError::Failed { operation: "reply to a query".to_owned(), problem: problem.to_owned() }
}

/// Replier of a service on the virtual bus.
pub(super) struct VirtualReplier {
    pub(super) sink: Weak<dyn ReplySink>,
    pub(super) part: QueryPart,
    pub(super) incarnation: Incarnation,
    pub(super) request: Arc<QueryRequest>,
    /// Part of the open queries of the service.
    pub(super) _open: OwnedSemaphorePermit,
}

impl VirtualReplier {
    async fn send(&self, reply: Reply) -> Result<(), BusError> {
        let sink = self.sink.upgrade().ok_or_else(|| reply_failed("the network is gone"))?;
        sink.until_unblocked(self.incarnation.index).await;
        sink.reply(self.incarnation, self.part, reply)
    }
}

#[async_trait]
impl Replier for VirtualReplier {
    async fn reply_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        attachment: Bytes,
        _: Encoding,
    ) -> Result<(), BusError> {
        keys::reply_key(key, &self.request.key_expr)?;
        keys::check_payload_size("reply to a query", &payload, MESSAGE_MAX)?;
        self.send(Reply { key: key.to_owned(), payload: Ok(payload), attachment, author: Author::UNKNOWN }).await
    }

    async fn refuse(&self, reason: &str) -> Result<(), BusError> {
        self.send(self.request.refusal(reason)).await
    }
}

impl Drop for VirtualReplier {
    /// Reports the end to the driver task, not to the network: this may run while the network is
    /// being changed.
    fn drop(&mut self) {
        if let Some(sink) = self.sink.upgrade() {
            sink.finish(self.part);
        }
    }
}
