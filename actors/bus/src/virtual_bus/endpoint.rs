//! Endpoint of a node on a virtual network.

use super::driver::Shared;
use super::ids::{EntityId, Incarnation};
use super::network::Network;
use super::responder::QueryRequest;
use crate::author::Author;
use crate::bus::{
    Bus, BusError, Delivery, Encoding, Link, MESSAGE_MAX, Presence, PresenceToken, Query, Reply, Sample,
    ServiceSelection, Stream,
};
use crate::keys;
use crate::mailbox::mailbox;
use crate::open_queries::query_mailbox;
use async_trait::async_trait;
use bytes::Bytes;
use consort_protocol::ids::NodeId;
use std::sync::{Arc, Weak};
use std::time::Duration;

/// Endpoint of a node on a [`VirtualNetwork`](super::VirtualNetwork). Clones share the endpoint.
/// Dropping it ends nothing; a [crash](super::VirtualNetwork::crash) does.
#[derive(Clone)]
pub struct VirtualBus {
    pub(super) shared: Arc<Shared>,
    pub(super) node: NodeId,
    pub(super) incarnation: Incarnation,
}

impl VirtualBus {
    /// Returns the node of this endpoint.
    pub fn node(&self) -> &NodeId {
        &self.node
    }

    /// Runs an operation on the network, unless the node has crashed.
    fn act<R>(&self, operation: &str, act: impl FnOnce(&mut Network) -> R) -> Result<R, BusError> {
        self.shared.with(|network| {
            if !network.is_running(self.incarnation) {
                let problem = format!("node {} has crashed", self.node);
                return Err(BusError::Failed { operation: operation.to_owned(), problem });
            }
            Ok(act(network))
        })
    }

    fn serve_with(&self, key_expr: &str, complete: bool) -> Result<Stream<Query>, BusError> {
        let key_expr = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = query_mailbox();
        let id = self.act("serve", |network| network.serve(self.incarnation, key_expr, complete, mailbox))?;
        Ok(Stream::new(receiver, self.guard(id, Network::stop_serving)))
    }

    /// Returns a guard that ends a declaration or a query.
    fn guard(&self, id: EntityId, end: fn(&mut Network, EntityId)) -> Box<dyn Send + Sync> {
        Box::new(Guard { shared: Arc::downgrade(&self.shared), id, end })
    }
}

#[async_trait]
impl Bus for VirtualBus {
    async fn publish_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        attachment: Bytes,
        encoding: Encoding,
        _delivery: Delivery,
    ) -> Result<(), BusError> {
        self.shared.until_unblocked(self.incarnation.index).await;
        keys::check_payload_size("publish", &payload, MESSAGE_MAX)?;
        self.act("publish", |network| {
            let valid_key = match network.cached_key(key) {
                Some(valid_key) => valid_key,
                None => keys::single_key(key)?,
            };
            network.publish(
                self.incarnation,
                &valid_key,
                Sample { key: key.to_owned(), payload, encoding, attachment, author: Author::UNKNOWN },
            );
            Ok(())
        })?
    }

    async fn subscribe(&self, key_expr: &str) -> Result<Stream<Sample>, BusError> {
        self.shared.until_unblocked(self.incarnation.index).await;
        let key_expr = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = mailbox();
        let id = self.act("subscribe", |network| network.subscribe(self.incarnation, key_expr, mailbox))?;
        Ok(Stream::of_mailbox(receiver, self.guard(id, Network::unsubscribe)))
    }

    async fn query_with(
        &self,
        key_expr: &str,
        payload: Bytes,
        attachment: Bytes,
        timeout: Duration,
        target: ServiceSelection,
    ) -> Result<Stream<Reply>, BusError> {
        self.shared.until_unblocked(self.incarnation.index).await;
        let (key_expr, parameters) = keys::selector(key_expr)?;
        keys::check_payload_size("query", &payload, MESSAGE_MAX)?;
        let request = QueryRequest { key_expr, parameters: parameters.to_owned(), payload, attachment };
        let (replies, receiver) = mailbox();
        let id = self.act("query", |network| network.query(self.incarnation, request, timeout, target, replies))?;
        Ok(Stream::of_mailbox(receiver, self.guard(id, Network::cancel_query)))
    }

    async fn serve(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        self.shared.until_unblocked(self.incarnation.index).await;
        self.serve_with(key_expr, false)
    }

    async fn serve_complete(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        self.shared.until_unblocked(self.incarnation.index).await;
        self.serve_with(key_expr, true)
    }

    async fn announce(&self, key: &str) -> Result<PresenceToken, BusError> {
        let key = keys::single_key(key)?;
        let id = self.act("announce", |network| network.announce(self.incarnation, key))?;
        Ok(PresenceToken::new(self.guard(id, Network::withdraw_token)))
    }

    async fn watch(&self, key_expr: &str) -> Result<Stream<Presence>, BusError> {
        let key_expr = keys::key_expression(key_expr)?;
        let (mailbox, receiver) = mailbox();
        let id = self.act("watch", |network| network.watch(self.incarnation, key_expr, mailbox))?;
        Ok(Stream::of_mailbox(receiver, self.guard(id, Network::stop_watching)))
    }

    async fn links(&self) -> Vec<Link> {
        self.act("list its links", |network| {
            let link = |peer: &NodeId| Link { peer: peer.to_string(), kind: "router".to_owned() };
            network.neighbours(self.incarnation.index).map(link).collect()
        })
        .unwrap_or_default()
    }
}

/// Guard that ends a declaration or a query when it is dropped.
struct Guard {
    shared: Weak<Shared>,
    id: EntityId,
    end: fn(&mut Network, EntityId),
}

impl Drop for Guard {
    fn drop(&mut self) {
        if let Some(shared) = self.shared.upgrade() {
            shared.with(|network| (self.end)(network, self.id));
        }
    }
}
