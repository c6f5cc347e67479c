//! A query that has not ended, with a part per service.

use crate::bus::Reply;
use crate::mailbox::MailboxSender;
use crate::virtual_bus::ids::{EntityId, Incarnation, NodeIndex};
use crate::virtual_bus::link::MessageClass;
use crate::virtual_bus::responder::QueryRequest;
use std::collections::BTreeMap;
use std::sync::Arc;
use tokio::time::Instant;

/// A query that has not ended.
pub(super) struct PendingQuery {
    pub(super) requester: NodeIndex,
    pub(super) replies: MailboxSender<Reply>,
    /// Latest reply per key, delivered at the end. Only for queries with a single reply per key.
    pub(super) latest: Option<BTreeMap<String, Reply>>,
    pub(super) request: Arc<QueryRequest>,
    pub(super) class: MessageClass,
    /// Parts, by id of the service.
    pub(super) parts: BTreeMap<EntityId, QueryPartState>,
}

impl Drop for PendingQuery {
    fn drop(&mut self) {
        for (_, reply) in self.latest.take().unwrap_or_default() {
            // The receiver may be gone: ignore the error.
            self.replies.send(reply);
        }
    }
}

/// State of a service's part in a query.
pub(super) struct QueryPartState {
    pub(super) service: Incarnation,
    /// A message of this part was lost, so all later messages are lost as well.
    pub(super) broken: bool,
    /// Arrival time of the latest reply; no reply arrives earlier.
    pub(super) earliest: Instant,
}
