//! Refusals without a signature, which the signing bus drops: a bus below it passes them to the bus above.

use async_trait::async_trait;
use bytes::Bytes;
use consort_bus::{
    Bus, BusError, Delivery, Encoding, Link, Presence, PresenceToken, Query, Reply, Sample, ServiceSelection,
    SharedBus, Stream,
};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

/// Passage for the refusals of the next query. The signing bus between its ends does not wait before it
/// passes on a query.
#[derive(Clone, Default)]
pub(super) struct RefusalPassage(Arc<Mutex<Option<UnboundedSender<Reply>>>>);

impl RefusalPassage {
    /// Opens the passage for the query that follows.
    pub(super) fn open(&self) -> UnboundedReceiver<Reply> {
        let (sender, receiver) = unbounded_channel();
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(sender);
        receiver
    }

    fn take(&self) -> Option<UnboundedSender<Reply>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

/// Returns the replies to a query together with its refusals, in the order of arrival.
pub(super) fn merged(mut replies: Stream<Reply>, mut refusals: UnboundedReceiver<Reply>) -> Stream<Reply> {
    let (sender, receiver) = unbounded_channel();
    tokio::spawn(async move {
        loop {
            let next = tokio::select! {
                biased;
                Some(refusal) = refusals.recv() => Some(refusal),
                reply = replies.recv() => reply,
            };
            let Some(reply) = next else { return };
            if sender.send(reply).is_err() {
                return;
            }
        }
    });
    Stream::new(receiver, Box::new(()))
}

/// Bus below the signatures of a node.
pub(super) struct RefusalTap {
    pub(super) passage: RefusalPassage,
    pub(super) inner: SharedBus,
}

#[async_trait]
impl Bus for RefusalTap {
    async fn publish_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        attachment: Bytes,
        encoding: Encoding,
        delivery: Delivery,
    ) -> Result<(), BusError> {
        self.inner.publish_with_attachment(key, payload, attachment, encoding, delivery).await
    }

    async fn subscribe(&self, key_expr: &str) -> Result<Stream<Sample>, BusError> {
        self.inner.subscribe(key_expr).await
    }

    async fn query_with(
        &self,
        key_expr: &str,
        payload: Bytes,
        attachment: Bytes,
        timeout: Duration,
        target: ServiceSelection,
    ) -> Result<Stream<Reply>, BusError> {
        let passage = self.passage.take();
        let replies = self.inner.query_with(key_expr, payload, attachment, timeout, target).await?;
        Ok(replies.map(move |reply| {
            if let (Some(passage), Err(_)) = (&passage, &reply.payload) {
                // The requester may have enough replies.
                let _ = passage.send(reply.clone());
            }
            reply
        }))
    }

    async fn serve(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        self.inner.serve(key_expr).await
    }

    async fn serve_complete(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        self.inner.serve_complete(key_expr).await
    }

    async fn announce(&self, key: &str) -> Result<PresenceToken, BusError> {
        self.inner.announce(key).await
    }

    async fn watch(&self, key_expr: &str) -> Result<Stream<Presence>, BusError> {
        self.inner.watch(key_expr).await
    }

    async fn links(&self) -> Vec<Link> {
        self.inner.links().await
    }
}
