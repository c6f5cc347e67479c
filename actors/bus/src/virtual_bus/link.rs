//! Model of a link between two nodes, its queue, and message counters.

use consort_protocol::keys::{KeyKind, Priority};
use std::collections::BTreeMap;
use std::ops::Bound::{Excluded, Unbounded};
use std::time::Duration;
use tokio::time::Instant;

/// Effect of links on the messages that cross them. A node's messages to itself cross no link.
///
/// Shares are probabilities from 0 to 1, drawn for every message and receiving node.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkModel {
    /// Minimum latency.
    pub latency_min: Duration,
    /// Maximum latency; the latency is distributed uniformly between the two. Tokio's clock ticks
    /// in milliseconds. Messages that arrive within the same millisecond are delivered at its end,
    /// in order of arrival.
    pub latency_max: Duration,
    /// Share of lost messages: publications, queries and replies alike. After a lost reply all
    /// later replies of that service to the same query are lost as well, and the query runs to its
    /// timeout.
    pub loss: f64,
    /// Share of publications that arrive twice.
    pub duplication: f64,
    /// Share of publications for which the guarantee of order is broken: they are delayed by up to
    /// [`reordering_delay`](Self::reordering_delay), and later publications overtake them.
    pub reordering: f64,
    /// Maximum additional delay of a reordered publication.
    pub reordering_delay: Duration,
    /// Bytes per second in each direction; `None` for no limit. Messages of a higher [`Priority`] overtake others.
    pub bandwidth: Option<u64>,
}

impl LinkModel {
    /// A local network in good order: 0.2 to 3 ms, without loss, duplication or reordering.
    pub const LAN: LinkModel = LinkModel {
        latency_min: Duration::from_micros(200),
        latency_max: Duration::from_millis(3),
        loss: 0.0,
        duplication: 0.0,
        reordering: 0.0,
        reordering_delay: Duration::ZERO,
        bandwidth: None,
    };

    /// Returns a model with a fixed latency, otherwise as [`LinkModel::LAN`].
    pub fn steady(latency: Duration) -> LinkModel {
        LinkModel { latency_min: latency, latency_max: latency, ..LinkModel::LAN }
    }

    /// Checks the values. Only the project's own tests create link models, so invalid values panic.
    pub(super) fn validated(self) -> LinkModel {
        assert!(self.latency_min <= self.latency_max, "the minimum latency must not exceed the maximum: {self:?}");
        for share in [self.loss, self.duplication, self.reordering] {
            assert!((0.0..=1.0).contains(&share), "a share must lie between 0 and 1: {self:?}");
        }
        assert_ne!(self.bandwidth, Some(0), "a link without bandwidth is a cut: {self:?}");
        self
    }
}

impl Default for LinkModel {
    fn default() -> Self {
        LinkModel::LAN
    }
}

/// Class of the messages on a key.
#[derive(Debug, Clone, Copy)]
pub(super) struct MessageClass {
    pub(super) kind: KeyKind,
    pub(super) priority: Priority,
}

impl MessageClass {
    /// Returns the class of the messages on a key or key expression.
    pub(super) fn of(key_expr: &str) -> MessageClass {
        MessageClass { kind: KeyKind::of(key_expr), priority: Priority::of(key_expr) }
    }
}

/// Size of the part of a message that a message of a higher priority waits for, in bytes: that of Zenoh's batches.
const BATCH_BYTES: usize = 8 * 1024;

/// Messages that a link has not sent, as the time at which the last of each priority will have been sent.
///
/// A message that is overtaken keeps its time, so a link carries a little more than its bandwidth.
#[derive(Debug, Default)]
pub(super) struct LinkQueue(BTreeMap<Priority, Instant>);

impl LinkQueue {
    /// Adds a message, and returns the time at which it will have been sent.
    pub(super) fn send(&mut self, now: Instant, priority: Priority, bytes: usize, bandwidth: u64) -> Instant {
        let duration = |bytes: usize| Duration::from_nanos(bytes as u64 * 1_000_000_000 / bandwidth);
        let same_or_higher = self.0.range(..=priority).map(|(_, sent)| *sent).max().filter(|sent| *sent > now);
        let lower = self.0.range((Excluded(priority), Unbounded)).map(|(_, sent)| *sent).max();
        let start = match (same_or_higher, lower) {
            (Some(sent), _) => sent,
            (None, Some(sent)) => sent.clamp(now, now + duration(BATCH_BYTES)),
            (None, None) => now,
        };
        let sent = start + duration(bytes);
        self.0.insert(priority, sent);
        sent
    }
}

/// Messages carried by a network so far: publications (counted per receiving node), queries and
/// replies.
///
/// `sent + duplicated = delivered + dropped`, plus the messages in transit or held back.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct NetworkCounters {
    /// Sent, each to a single node.
    pub sent: u64,
    /// Sent a second time by a duplicating link.
    pub duplicated: u64,
    /// Delivered.
    pub delivered: u64,
    /// Lost by chance, blocked by a fault, or arrived without a receiver.
    pub dropped: u64,
}

/// Traffic of a node: bytes of keys, payloads and attachments in publications (counted per
/// receiving node, as if all nodes were linked directly), queries and replies. The overhead of a
/// transport per message is not included, but the number of messages is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Bytes sent, including lost messages.
    pub sent: u64,
    /// Bytes received.
    pub received: u64,
    /// Messages sent, each to a single other node.
    pub messages_sent: u64,
    /// Messages received.
    pub messages_received: u64,
}

/// [`Traffic`] of a node per kind of key.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TrafficByKind(Vec<Traffic>);

impl TrafficByKind {
    /// Returns the traffic per kind of key, without kinds that did not occur.
    pub fn iter(&self) -> impl Iterator<Item = (KeyKind, Traffic)> {
        KeyKind::ALL.iter().copied().zip(self.0.iter().copied()).filter(|(_, traffic)| *traffic != Traffic::default())
    }

    /// Returns the sum over all kinds.
    pub fn total(&self) -> Traffic {
        self.0.iter().fold(Traffic::default(), |sum, part| Traffic {
            sent: sum.sent + part.sent,
            received: sum.received + part.received,
            messages_sent: sum.messages_sent + part.messages_sent,
            messages_received: sum.messages_received + part.messages_received,
        })
    }

    pub(super) fn sent(&mut self, kind: KeyKind, bytes: usize) {
        let traffic = self.of(kind);
        traffic.sent += bytes as u64;
        traffic.messages_sent += 1;
    }

    pub(super) fn received(&mut self, kind: KeyKind, bytes: usize) {
        let traffic = self.of(kind);
        traffic.received += bytes as u64;
        traffic.messages_received += 1;
    }

    fn of(&mut self, kind: KeyKind) -> &mut Traffic {
        // `KeyKind::ALL` is in the order of declaration.
        self.0.resize(KeyKind::ALL.len(), Traffic::default());
        &mut self.0[kind as usize]
    }
}
