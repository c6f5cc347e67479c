//! What a link between two nodes does to messages, and what was counted.

use consort_protocol::keys::KeyKind;
use std::time::Duration;

/// What links do to the messages that cross them. A node's messages to itself cross none.
///
/// Shares are probabilities from 0 to 1, drawn afresh for every message and receiving node.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkModel {
    /// Shortest time under way.
    pub latency_min: Duration,
    /// Longest time under way; every time between the two is equally likely. Tokio's clock ticks in milliseconds, so
    /// that what arrives within one millisecond is handed over at its end, in order of arrival.
    pub latency_max: Duration,
    /// Share of messages that get lost: publications, questions and answers alike. What a lost answer's service says
    /// afterwards to the same question is lost too, and the query runs to its limit.
    pub loss: f64,
    /// Share of publications that arrive twice.
    pub duplication: f64,
    /// Share of publications for which the promise of order is broken: they wait up to
    /// [`reordering_delay`](Self::reordering_delay) longer, and later ones overtake them.
    pub reordering: f64,
    /// Longest additional time under way of a publication that is overtaken.
    pub reordering_delay: Duration,
}

impl LinkModel {
    /// A local network in good order: 0.2 to 3 ms, nothing lost, repeated or overtaken.
    pub const LAN: LinkModel = LinkModel {
        latency_min: Duration::from_micros(200),
        latency_max: Duration::from_millis(3),
        loss: 0.0,
        duplication: 0.0,
        reordering: 0.0,
        reordering_delay: Duration::ZERO,
    };

    /// Every message takes exactly `latency`; otherwise as [`LinkModel::LAN`].
    pub fn steady(latency: Duration) -> LinkModel {
        LinkModel { latency_min: latency, latency_max: latency, ..LinkModel::LAN }
    }

    /// Only our own tests state link models: one that makes no sense is refused loudly.
    pub(super) fn validated(self) -> LinkModel {
        assert!(self.latency_min <= self.latency_max, "the shortest latency exceeds the longest: {self:?}");
        for share in [self.loss, self.duplication, self.reordering] {
            assert!((0.0..=1.0).contains(&share), "a share lies between 0 and 1: {self:?}");
        }
        self
    }
}

impl Default for LinkModel {
    fn default() -> Self {
        LinkModel::LAN
    }
}

/// What a network has carried so far: publications (once for each receiving node), questions and answers.
///
/// `sent + duplicated = delivered + dropped`, plus what is still under way or held up.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct NetworkCounters {
    /// Set out towards one node each.
    pub sent: u64,
    /// Set out a second time because the link repeats itself.
    pub duplicated: u64,
    /// Handed over.
    pub delivered: u64,
    /// Lost by chance, cut off, or arrived where nobody listens any more.
    pub dropped: u64,
}

/// What one node has put on the wire and taken from it, in bytes of keys, payloads and what is said beside them:
/// publications (once for each other node that receives them, as if all were linked with all), questions and answers. What a
/// transport adds to each message is not counted, but the messages are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Bytes sent, also what got lost on the way.
    pub sent: u64,
    /// Bytes handed over.
    pub received: u64,
    /// Messages sent, each to one other node.
    pub messages_sent: u64,
    /// Messages handed over.
    pub messages_received: u64,
}

/// A node's [`Traffic`] by what it was about.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TrafficByKind(Vec<Traffic>);

impl TrafficByKind {
    /// What it was about, and how much of it there was; nothing of kinds that did not occur.
    pub fn iter(&self) -> impl Iterator<Item = (KeyKind, Traffic)> {
        KeyKind::ALL.iter().copied().zip(self.0.iter().copied()).filter(|(_, traffic)| *traffic != Traffic::default())
    }

    /// All of it together.
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
        // Declared in this order.
        self.0.resize(KeyKind::ALL.len(), Traffic::default());
        &mut self.0[kind as usize]
    }
}
