//! Bus layers. A layer wraps another bus and transforms the messages that pass: it counts them,
//! signs them, or restricts them to a cluster.
//!
//! ```text
//! actors ──▶ ClusterBus ──▶ SigningBus ──▶ MeteredBus ──▶ ZenohBus
//! ```

use crate::bus::{
    Bus, BusError, Delivery, Encoding, Link, Presence, PresenceToken, Query, Reply, Sample, ServiceSelection,
    SharedBus, Stream,
};
use async_trait::async_trait;
use bytes::Bytes;
use std::time::Duration;
use tracing::debug;

/// Payload and attachment of a message.
#[derive(Debug, Clone)]
pub struct MessageContent {
    /// Payload.
    pub payload: Bytes,
    /// Attachment.
    pub attachment: Bytes,
}

/// Transformations that a layer applies to messages; by default it passes them on. Presence and links
/// are passed to the inner bus. A layer need not distinguish the two kinds of query and of service.
pub trait Layer: Send + Sync + 'static {
    /// State kept for a query until its replies have arrived.
    type QueryState: Send;

    /// Returns the wrapped bus.
    fn inner(&self) -> &SharedBus;

    /// Transforms a publication on `key` before it is sent.
    ///
    /// # Errors
    /// [`BusError`] if the message cannot be published at all.
    fn outgoing_publication(&self, _key: &str, content: MessageContent) -> Result<MessageContent, BusError> {
        Ok(content)
    }

    /// Transforms the publications delivered to a subscriber of `key_expr`. A layer may drop
    /// samples.
    fn incoming_publications(&self, _key_expr: &str, samples: Stream<Sample>) -> Stream<Sample> {
        samples
    }

    /// Transforms a query on `key_expr` before it is sent.
    ///
    /// # Errors
    /// [`BusError`] if the query cannot be sent at all.
    fn outgoing_query(
        &self,
        key_expr: &str,
        content: MessageContent,
    ) -> Result<(MessageContent, Self::QueryState), BusError>;

    /// Transforms the replies delivered to the querying node.
    fn incoming_replies(&self, _state: Self::QueryState, replies: Stream<Reply>) -> Stream<Reply> {
        replies
    }

    /// Transforms the queries delivered to a service on `key_expr`. A layer may drop queries.
    fn incoming_queries(&self, _key_expr: &str, queries: Stream<Query>) -> Stream<Query> {
        queries
    }
}

/// Refuses a query in a background task, so that the next query is not delayed. A requester in good
/// faith then need not wait for its timeout.
pub(crate) fn refuse_in_background(query: Query, reason: String) {
    tokio::spawn(async move {
        if let Err(problem) = query.replier.refuse(&reason).await {
            debug!(%problem, "failed to send an error reply");
        }
    });
}

#[async_trait]
impl<L: Layer> Bus for L {
    async fn publish_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        attachment: Bytes,
        encoding: Encoding,
        delivery: Delivery,
    ) -> Result<(), BusError> {
        let MessageContent { payload, attachment } =
            self.outgoing_publication(key, MessageContent { payload, attachment })?;
        self.inner().publish_with_attachment(key, payload, attachment, encoding, delivery).await
    }

    async fn subscribe(&self, key_expr: &str) -> Result<Stream<Sample>, BusError> {
        Ok(self.incoming_publications(key_expr, self.inner().subscribe(key_expr).await?))
    }

    async fn query_with(
        &self,
        key_expr: &str,
        payload: Bytes,
        attachment: Bytes,
        timeout: Duration,
        target: ServiceSelection,
    ) -> Result<Stream<Reply>, BusError> {
        let (MessageContent { payload, attachment }, state) =
            self.outgoing_query(key_expr, MessageContent { payload, attachment })?;
        Ok(self.incoming_replies(state, self.inner().query_with(key_expr, payload, attachment, timeout, target).await?))
    }

    async fn serve(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        Ok(self.incoming_queries(key_expr, self.inner().serve(key_expr).await?))
    }

    async fn serve_complete(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        Ok(self.incoming_queries(key_expr, self.inner().serve_complete(key_expr).await?))
    }

    async fn announce(&self, key: &str) -> Result<PresenceToken, BusError> {
        self.inner().announce(key).await
    }

    async fn watch(&self, key_expr: &str) -> Result<Stream<Presence>, BusError> {
        self.inner().watch(key_expr).await
    }

    async fn links(&self) -> Vec<Link> {
        self.inner().links().await
    }
}
