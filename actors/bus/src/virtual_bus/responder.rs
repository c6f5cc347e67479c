//! Replies of a service on the virtual bus.

use super::Shared;
use super::network::{EntityId, Incarnation, QueryRequest};
use crate::bus::{BusError, Encoding, MESSAGE_MAX, Replier, Reply};
use crate::keys;
use async_trait::async_trait;
use bytes::Bytes;
use std::sync::{Arc, Weak};

/// Part of a single service in a single query.
#[derive(Debug, Clone, Copy)]
pub(super) struct QueryPart {
    pub(super) query: EntityId,
    pub(super) service: EntityId,
}

pub(super) struct VirtualReplier {
    shared: Weak<Shared>,
    part: QueryPart,
    incarnation: Incarnation,
    request: Arc<QueryRequest>,
}

impl VirtualReplier {
    pub(super) fn new(
        shared: Weak<Shared>,
        part: QueryPart,
        incarnation: Incarnation,
        request: Arc<QueryRequest>,
    ) -> Self {
        VirtualReplier { shared, part, incarnation, request }
    }

    fn send(&self, reply: Reply) -> Result<(), BusError> {
        let failed =
            |problem: &str| BusError::Failed { operation: "reply to a query".to_owned(), problem: problem.to_owned() };
        let shared = self.shared.upgrade().ok_or_else(|| failed("the network is gone"))?;
        shared.with(|network| {
            if !network.is_running(self.incarnation) {
                return Err(failed("the node has crashed"));
            }
            network.reply(self.part, reply);
            Ok(())
        })
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
        self.send(Reply { key: key.to_owned(), payload: Ok(payload), attachment })
    }

    async fn refuse(&self, reason: &str) -> Result<(), BusError> {
        self.send(Reply {
            key: self.request.key_expr.to_string(),
            payload: Err(reason.to_owned()),
            attachment: Bytes::new(),
        })
    }
}

impl Drop for VirtualReplier {
    /// Reports the end to the driver task, not to the network: this may run while the network is
    /// being changed.
    fn drop(&mut self) {
        if let Some(shared) = self.shared.upgrade() {
            shared.finished(self.part);
        }
    }
}
