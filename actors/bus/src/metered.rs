//! A bus that counts its traffic for a node's metrics: payload bytes that the node itself sends and
//! receives, without relayed messages and without the bus's own overhead.

use crate::bus::{BusError, Encoding, Query, Replier, Reply, Sample, SharedBus, Stream};
use crate::layer::{Layer, MessageContent};
use async_trait::async_trait;
use bytes::Bytes;
use consort_protocol::keys::KeyKind;
use std::sync::Arc;

/// Direction of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Direction {
    /// Sent by this node.
    Sent,
    /// Received by this node.
    Received,
}

/// A message counter. It is called for every message, so it must neither block nor panic.
pub trait Meter: Send + Sync + 'static {
    /// Counts a message with a payload of `bytes` bytes.
    fn count(&self, kind: KeyKind, direction: Direction, bytes: usize);
}

/// Bus that counts its messages.
pub struct MeteredBus {
    bus: SharedBus,
    meter: Arc<dyn Meter>,
}

impl MeteredBus {
    /// Creates a bus that passes messages to `bus` and counts them with `meter`.
    pub fn new(bus: SharedBus, meter: Arc<dyn Meter>) -> MeteredBus {
        MeteredBus { bus, meter }
    }
}

impl Layer for MeteredBus {
    type QueryState = ();

    fn inner(&self) -> &SharedBus {
        &self.bus
    }

    fn outgoing_publication(&self, key: &str, content: MessageContent) -> Result<MessageContent, BusError> {
        self.meter.count(KeyKind::of(key), Direction::Sent, content.payload.len() + content.attachment.len());
        Ok(content)
    }

    fn incoming_publications(&self, _: &str, samples: Stream<Sample>) -> Stream<Sample> {
        let meter = Arc::clone(&self.meter);
        samples.map(move |sample| {
            meter.count(KeyKind::of(&sample.key), Direction::Received, sample.payload.len() + sample.attachment.len());
            sample
        })
    }

    fn outgoing_query(&self, key_expr: &str, content: MessageContent) -> Result<(MessageContent, ()), BusError> {
        self.meter.count(KeyKind::of(key_expr), Direction::Sent, content.payload.len() + content.attachment.len());
        Ok((content, ()))
    }

    fn incoming_replies(&self, (): (), replies: Stream<Reply>) -> Stream<Reply> {
        let meter = Arc::clone(&self.meter);
        replies.map(move |reply| {
            let bytes = reply.payload.as_ref().map_or_else(|refused| refused.0.len(), Bytes::len);
            meter.count(KeyKind::of(&reply.key), Direction::Received, bytes + reply.attachment.len());
            reply
        })
    }

    fn incoming_queries(&self, _: &str, incoming_queries: Stream<Query>) -> Stream<Query> {
        let meter = Arc::clone(&self.meter);
        incoming_queries.map(move |query| {
            meter.count(KeyKind::of(&query.key), Direction::Received, query.payload.len() + query.attachment.len());
            let replier = MeteredReplier { replier: query.replier, meter: Arc::clone(&meter) };
            Query { replier: Box::new(replier), ..query }
        })
    }
}

struct MeteredReplier {
    replier: Box<dyn Replier>,
    meter: Arc<dyn Meter>,
}

#[async_trait]
impl Replier for MeteredReplier {
    async fn reply_with_attachment(
        &self,
        key: &str,
        payload: Bytes,
        attachment: Bytes,
        encoding: Encoding,
    ) -> Result<(), BusError> {
        self.meter.count(KeyKind::of(key), Direction::Sent, payload.len() + attachment.len());
        self.replier.reply_with_attachment(key, payload, attachment, encoding).await
    }

    async fn refuse(&self, reason: &str) -> Result<(), BusError> {
        self.replier.refuse(reason).await
    }
}
