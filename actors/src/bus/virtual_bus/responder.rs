//! How a service on the virtual bus answers one query.

use super::Shared;
use super::network::{EntityId, Incarnation, QueryRequest};
use crate::bus::{BusError, Encoding, MESSAGE_MAX, Replier, Reply, keys};
use async_trait::async_trait;
use bytes::Bytes;
use std::sync::{Arc, Weak};

/// One service's part in one query.
#[derive(Debug, Clone, Copy)]
pub(super) struct QueryPart {
    pub(super) query: EntityId,
    pub(super) service: EntityId,
}

pub(super) struct VirtualReplier {
    home: Weak<Shared>,
    leg: QueryPart,
    life: Incarnation,
    question: Arc<QueryRequest>,
}

impl VirtualReplier {
    pub(super) fn new(home: Weak<Shared>, leg: QueryPart, life: Incarnation, question: Arc<QueryRequest>) -> Self {
        VirtualReplier { home, leg, life, question }
    }

    fn send(&self, reply: Reply) -> Result<(), BusError> {
        let gone =
            |problem: &str| BusError::Failed { operation: "answer a query".to_owned(), problem: problem.to_owned() };
        let shared = self.home.upgrade().ok_or_else(|| gone("the network is gone"))?;
        shared.with(|network| {
            if !network.is_running(self.life) {
                return Err(gone("the node has crashed"));
            }
            network.reply(self.leg, reply);
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
        beside: Bytes,
        _: Encoding,
    ) -> Result<(), BusError> {
        keys::reply_key(key, &self.question.key_expr)?;
        keys::check_payload_size("answer a query", &payload, MESSAGE_MAX)?;
        self.send(Reply { key: key.to_owned(), payload: Ok(payload), attachment: beside })
    }

    async fn refuse(&self, reason: &str) -> Result<(), BusError> {
        self.send(Reply {
            key: self.question.key_expr.to_string(),
            payload: Err(reason.to_owned()),
            attachment: Bytes::new(),
        })
    }
}

impl Drop for VirtualReplier {
    /// Reports the end to the driver, rather than to the network: this may run while the network is being changed.
    fn drop(&mut self) {
        if let Some(shared) = self.home.upgrade() {
            shared.finished(self.leg);
        }
    }
}
