//! A bus whose traffic is counted, for a node's metrics: what a node sends and hears itself, by payload, without what it
//! relays for others and what the bus adds.

use super::{BusError, Encoding, Layer, MessageContent, Query, Replier, Reply, Sample, SharedBus, Stream};
use async_trait::async_trait;
use bytes::Bytes;
use consort_protocol::keys::KeyKind;
use std::sync::Arc;

/// Which way a message goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Direction {
    /// From this node.
    Sent,
    /// To this node.
    Received,
}

/// Counts. It is called for every message, so it neither waits nor panics.
pub trait Meter: Send + Sync + 'static {
    /// A message with a payload of so many bytes.
    fn count(&self, kind: KeyKind, direction: Direction, bytes: usize);
}

/// A bus whose messages are counted.
pub struct MeteredBus {
    bus: SharedBus,
    meter: Arc<dyn Meter>,
}

impl MeteredBus {
    /// `bus`, whose messages `meter` counts.
    pub fn new(bus: SharedBus, meter: Arc<dyn Meter>) -> MeteredBus {
        MeteredBus { bus, meter }
    }
}

impl Layer for MeteredBus {
    type QueryState = ();

    fn inner(&self) -> &SharedBus {
        &self.bus
    }

    fn outgoing_publication(&self, key: &str, said: MessageContent) -> Result<MessageContent, BusError> {
        self.meter.count(KeyKind::of(key), Direction::Sent, said.payload.len() + said.attachment.len());
        Ok(said)
    }

    fn incoming_publications(&self, _: &str, samples: Stream<Sample>) -> Stream<Sample> {
        let meter = Arc::clone(&self.meter);
        samples.map(move |sample| {
            meter.count(KeyKind::of(&sample.key), Direction::Received, sample.payload.len() + sample.attachment.len());
            sample
        })
    }

    fn outgoing_query(&self, key_expr: &str, said: MessageContent) -> Result<(MessageContent, ()), BusError> {
        self.meter.count(KeyKind::of(key_expr), Direction::Sent, said.payload.len() + said.attachment.len());
        Ok((said, ()))
    }

    fn incoming_replies(&self, (): (), replies: Stream<Reply>) -> Stream<Reply> {
        let meter = Arc::clone(&self.meter);
        replies.map(move |reply| {
            let bytes = reply.payload.as_ref().map_or_else(String::len, Bytes::len);
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
        beside: Bytes,
        encoding: Encoding,
    ) -> Result<(), BusError> {
        self.meter.count(KeyKind::of(key), Direction::Sent, payload.len() + beside.len());
        self.replier.reply_with_attachment(key, payload, beside, encoding).await
    }

    async fn refuse(&self, reason: &str) -> Result<(), BusError> {
        self.replier.refuse(reason).await
    }
}
