//! A bus over another bus, which makes something of what is said and heard on it: counts it, seals it, keeps it within a
//! cluster.
//!
//! ```text
//! actors ──▶ ClusterBus ──▶ SealedBus ──▶ MeteredBus ──▶ ZenohBus
//! ```

use super::{Bus, BusError, Delivery, Encoding, Link, Presence, Query, Reply, Sample, SharedBus, Stream, Token, Whom};
use async_trait::async_trait;
use bytes::Bytes;
use std::time::Duration;
use tracing::debug;

/// A content, and what stands beside it.
pub(crate) struct Said {
    pub(crate) payload: Bytes,
    pub(crate) beside: Bytes,
}

/// What a layer makes of what passes; all else, presence and links, is the carrier's. Whoever asks or serves may do so in two
/// ways, of which a layer need not know.
pub(crate) trait Layer: Send + Sync + 'static {
    /// What is remembered of a question until it is answered.
    type Asked: Send;

    /// The bus on which this one lies.
    fn carrier(&self) -> &SharedBus;

    /// What is published on `key` in the place of `said`.
    ///
    /// # Errors
    /// [`BusError`] if it cannot be said at all.
    fn publication(&self, key: &str, said: Said) -> Result<Said, BusError>;

    /// What a subscriber to `key_expr` hears of `samples`.
    fn publications(&self, key_expr: &str, samples: Stream<Sample>) -> Stream<Sample>;

    /// What is asked on `key_expr` in the place of `said`.
    ///
    /// # Errors
    /// [`BusError`] if it cannot be asked at all.
    fn question(&self, key_expr: &str, said: Said) -> Result<(Said, Self::Asked), BusError>;

    /// What whoever asked hears of `replies`.
    fn answers(&self, asked: Self::Asked, replies: Stream<Reply>) -> Stream<Reply>;

    /// What a service on `key_expr` is asked of `questions`.
    fn questions(&self, key_expr: &str, questions: Stream<Query>) -> Stream<Query>;
}

/// Refuses a question that is not let through, while the next one is looked at: whoever asks in good faith need not wait for
/// its limit.
pub(crate) fn turn_away(query: Query, reason: String) {
    tokio::spawn(async move {
        if let Err(problem) = query.replier.refuse(&reason).await {
            debug!(%problem, "a refusal was not sent");
        }
    });
}

#[async_trait]
impl<L: Layer> Bus for L {
    async fn publish_with(
        &self,
        key: &str,
        payload: Bytes,
        beside: Bytes,
        encoding: Encoding,
        delivery: Delivery,
    ) -> Result<(), BusError> {
        let Said { payload, beside } = self.publication(key, Said { payload, beside })?;
        self.carrier().publish_with(key, payload, beside, encoding, delivery).await
    }

    async fn subscribe(&self, key_expr: &str) -> Result<Stream<Sample>, BusError> {
        Ok(self.publications(key_expr, self.carrier().subscribe(key_expr).await?))
    }

    async fn ask(
        &self,
        key_expr: &str,
        payload: Bytes,
        beside: Bytes,
        limit: Duration,
        whom: Whom,
    ) -> Result<Stream<Reply>, BusError> {
        let (Said { payload, beside }, asked) = self.question(key_expr, Said { payload, beside })?;
        Ok(self.answers(asked, self.carrier().ask(key_expr, payload, beside, limit, whom).await?))
    }

    async fn serve(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        Ok(self.questions(key_expr, self.carrier().serve(key_expr).await?))
    }

    async fn serve_complete(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        Ok(self.questions(key_expr, self.carrier().serve_complete(key_expr).await?))
    }

    async fn announce(&self, key: &str) -> Result<Token, BusError> {
        self.carrier().announce(key).await
    }

    async fn watch(&self, key_expr: &str) -> Result<Stream<Presence>, BusError> {
        self.carrier().watch(key_expr).await
    }

    async fn links(&self) -> Vec<Link> {
        self.carrier().links().await
    }
}
