//! A bus over another bus, which makes something of what is said and heard on it: counts it, seals it, keeps it within a
//! cluster.
//!
//! ```text
//! actors ──▶ ClusterBus ──▶ SealedBus ──▶ MeteredBus ──▶ ZenohBus
//! ```

use super::{
    Bus, BusError, Delivery, Encoding, Link, Presence, PresenceToken, Query, Reply, Sample, ServiceSelection,
    SharedBus, Stream,
};
use async_trait::async_trait;
use bytes::Bytes;
use std::time::Duration;
use tracing::debug;

/// A content, and what stands beside it.
pub(crate) struct MessageContent {
    pub(crate) payload: Bytes,
    pub(crate) attachment: Bytes,
}

/// What a layer makes of what passes; all else, presence and links, is the carrier's. Whoever asks or serves may do so in two
/// ways, of which a layer need not know.
pub(crate) trait Layer: Send + Sync + 'static {
    /// What is remembered of a question until it is answered.
    type QueryState: Send;

    /// The bus on which this one lies.
    fn inner(&self) -> &SharedBus;

    /// What is published on `key` in the place of `said`.
    ///
    /// # Errors
    /// [`BusError`] if it cannot be said at all.
    fn outgoing_publication(&self, key: &str, said: MessageContent) -> Result<MessageContent, BusError>;

    /// What a subscriber to `key_expr` hears of `samples`.
    fn incoming_publications(&self, key_expr: &str, samples: Stream<Sample>) -> Stream<Sample>;

    /// What is asked on `key_expr` in the place of `said`.
    ///
    /// # Errors
    /// [`BusError`] if it cannot be asked at all.
    fn outgoing_query(
        &self,
        key_expr: &str,
        said: MessageContent,
    ) -> Result<(MessageContent, Self::QueryState), BusError>;

    /// What whoever asked hears of `replies`.
    fn incoming_replies(&self, asked: Self::QueryState, replies: Stream<Reply>) -> Stream<Reply>;

    /// What a service on `key_expr` is asked of `questions`.
    fn incoming_queries(&self, key_expr: &str, questions: Stream<Query>) -> Stream<Query>;
}

/// Refuses a question that is not let through, while the next one is looked at: whoever asks in good faith need not wait for
/// its limit.
pub(crate) fn refuse_in_background(query: Query, reason: String) {
    tokio::spawn(async move {
        if let Err(problem) = query.replier.refuse(&reason).await {
            debug!(%problem, "a refusal was not sent");
        }
    });
}

#[async_trait]
impl<L: Layer> Bus for L {
    async fn publish_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        beside: Bytes,
        encoding: Encoding,
        delivery: Delivery,
    ) -> Result<(), BusError> {
        let MessageContent { payload, attachment } =
            self.outgoing_publication(key, MessageContent { payload, attachment: beside })?;
        self.inner().publish_with_attachment(key, payload, attachment, encoding, delivery).await
    }

    async fn subscribe(&self, key_expr: &str) -> Result<Stream<Sample>, BusError> {
        Ok(self.incoming_publications(key_expr, self.inner().subscribe(key_expr).await?))
    }

    async fn query_with(
        &self,
        key_expr: &str,
        payload: Bytes,
        beside: Bytes,
        limit: Duration,
        whom: ServiceSelection,
    ) -> Result<Stream<Reply>, BusError> {
        let (MessageContent { payload, attachment }, asked) =
            self.outgoing_query(key_expr, MessageContent { payload, attachment: beside })?;
        Ok(self.incoming_replies(asked, self.inner().query_with(key_expr, payload, attachment, limit, whom).await?))
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
