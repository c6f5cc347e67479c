//! A bus whose traffic is counted, for a node's metrics: what a node sends and hears itself, by payload, without what it
//! relays for others and what the bus adds.

use super::{
    Bus, BusError, Delivery, Encoding, Link, Presence, Query, Replier, Reply, Sample, SharedBus, Stream, Token, Whom,
};
use async_trait::async_trait;
use bytes::Bytes;
use consort_protocol::keys::KeyKind;
use std::sync::Arc;
use std::time::Duration;

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

    fn counted_replies(&self, replies: Stream<Reply>) -> Stream<Reply> {
        let meter = Arc::clone(&self.meter);
        replies.passing(move |reply: Reply| {
            let bytes = reply.payload.as_ref().map_or_else(String::len, Bytes::len);
            meter.count(KeyKind::of(&reply.key), Direction::Received, bytes + reply.beside.len());
            reply
        })
    }

    fn counted_questions(&self, questions: Stream<Query>) -> Stream<Query> {
        let meter = Arc::clone(&self.meter);
        questions.passing(move |query: Query| {
            meter.count(KeyKind::of(&query.key), Direction::Received, query.payload.len() + query.beside.len());
            let replier = MeteredReplier { replier: query.replier, meter: Arc::clone(&meter) };
            Query { replier: Box::new(replier), ..query }
        })
    }
}

#[async_trait]
impl Bus for MeteredBus {
    async fn publish_with(
        &self,
        key: &str,
        payload: Bytes,
        beside: Bytes,
        encoding: Encoding,
        delivery: Delivery,
    ) -> Result<(), BusError> {
        self.meter.count(KeyKind::of(key), Direction::Sent, payload.len() + beside.len());
        self.bus.publish_with(key, payload, beside, encoding, delivery).await
    }

    async fn subscribe(&self, key_expr: &str) -> Result<Stream<Sample>, BusError> {
        let meter = Arc::clone(&self.meter);
        let count = move |sample: Sample| {
            meter.count(KeyKind::of(&sample.key), Direction::Received, sample.payload.len() + sample.beside.len());
            sample
        };
        Ok(self.bus.subscribe(key_expr).await?.passing(count))
    }

    async fn ask(
        &self,
        key_expr: &str,
        payload: Bytes,
        beside: Bytes,
        limit: Duration,
        whom: Whom,
    ) -> Result<Stream<Reply>, BusError> {
        self.meter.count(KeyKind::of(key_expr), Direction::Sent, payload.len() + beside.len());
        Ok(self.counted_replies(self.bus.ask(key_expr, payload, beside, limit, whom).await?))
    }

    async fn serve(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        Ok(self.counted_questions(self.bus.serve(key_expr).await?))
    }

    async fn serve_complete(&self, key_expr: &str) -> Result<Stream<Query>, BusError> {
        Ok(self.counted_questions(self.bus.serve_complete(key_expr).await?))
    }

    async fn announce(&self, key: &str) -> Result<Token, BusError> {
        self.bus.announce(key).await
    }

    async fn watch(&self, key_expr: &str) -> Result<Stream<Presence>, BusError> {
        self.bus.watch(key_expr).await
    }

    async fn links(&self) -> Vec<Link> {
        self.bus.links().await
    }
}

struct MeteredReplier {
    replier: Box<dyn Replier>,
    meter: Arc<dyn Meter>,
}

#[async_trait]
impl Replier for MeteredReplier {
    async fn reply_with(&self, key: &str, payload: Bytes, beside: Bytes, encoding: Encoding) -> Result<(), BusError> {
        self.meter.count(KeyKind::of(key), Direction::Sent, payload.len() + beside.len());
        self.replier.reply_with(key, payload, beside, encoding).await
    }

    async fn refuse(&self, reason: &str) -> Result<(), BusError> {
        self.replier.refuse(reason).await
    }
}
