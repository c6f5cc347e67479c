//! Traffic of nodes, as rates per second.

use super::figures::KindFigures;
use crate::Fleet;
use consort_bus::TrafficByKind;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::KeyKind;
use std::collections::BTreeMap;
use std::time::Duration;

/// Bytes that Zenoh adds to a message on a TCP link: the length of a batch (2), the header of a
/// frame with its number (1 + 4), the headers of network message and put (2), the numeric
/// prefix of the key (3), quality of service and node id (2 + 2), and the length of the payload (2).
/// TCP and IP are not included: a batch may contain several messages.
pub const FRAME_BYTES: u64 = 18;

/// Traffic of nodes at a moment.
pub(super) struct Readings(Vec<(NodeId, TrafficByKind)>);

impl Readings {
    pub(super) fn of(fleet: &Fleet, nodes: &[NodeId]) -> Readings {
        Readings(nodes.iter().map(|node| (node.clone(), fleet.network.traffic(node))).collect())
    }

    pub(super) fn messages_of(&self, kind: KeyKind) -> u64 {
        let of_kind = self.0.iter().flat_map(|(_, traffic)| traffic.iter().filter(|(of, _)| *of == kind));
        of_kind.map(|(_, traffic)| traffic.messages_received).sum()
    }

    pub(super) fn rates_since(&self, before: &Readings, time: Duration) -> Rates {
        let rate = |before: u64, after: u64| (after - before) as f64 / time.as_secs_f64();
        let nodes = self.0.iter().zip(&before.0).map(|((node, after), (_, before))| {
            let mut by_kind: BTreeMap<&'static str, KindFigures> = BTreeMap::new();
            let former: BTreeMap<&str, _> = before.iter().map(|(kind, traffic)| (kind.as_str(), traffic)).collect();
            for (kind, traffic) in after.iter() {
                let former = former.get(kind.as_str()).copied().unwrap_or_default();
                let messages = rate(former.messages_received, traffic.messages_received);
                let bytes = rate(former.received, traffic.received) + messages * FRAME_BYTES as f64;
                if messages > 0.0 {
                    by_kind.insert(kind.as_str(), KindFigures { bytes_per_s: bytes, messages_per_s: messages });
                }
            }
            let (before, after) = (before.total(), after.total());
            let sent_messages = rate(before.messages_sent, after.messages_sent);
            let received_messages = rate(before.messages_received, after.messages_received);
            let rates = NodeRates {
                received_bytes: rate(before.received, after.received) + received_messages * FRAME_BYTES as f64,
                received_messages,
                sent_bytes: rate(before.sent, after.sent) + sent_messages * FRAME_BYTES as f64,
                sent_messages,
                by_kind,
            };
            (node.clone(), rates)
        });
        Rates(nodes.collect())
    }
}

/// Rates of nodes.
pub(super) struct Rates(Vec<(NodeId, NodeRates)>);

#[derive(Default)]
pub(super) struct NodeRates {
    pub(super) received_bytes: f64,
    pub(super) received_messages: f64,
    pub(super) sent_bytes: f64,
    pub(super) sent_messages: f64,
    pub(super) by_kind: BTreeMap<&'static str, KindFigures>,
}

impl Rates {
    /// Returns the rates of the mean of the chosen nodes.
    pub(super) fn mean(&self, choose: impl Fn(&NodeId) -> bool) -> NodeRates {
        let chosen: Vec<&NodeRates> = self.0.iter().filter(|(node, _)| choose(node)).map(|(_, rates)| rates).collect();
        let share = 1.0 / chosen.len().max(1) as f64;
        let mut mean = NodeRates::default();
        for rates in chosen {
            mean.received_bytes += rates.received_bytes * share;
            mean.received_messages += rates.received_messages * share;
            mean.sent_bytes += rates.sent_bytes * share;
            mean.sent_messages += rates.sent_messages * share;
            for (kind, figures) in &rates.by_kind {
                let sum = mean.by_kind.entry(kind).or_default();
                sum.bytes_per_s += figures.bytes_per_s * share;
                sum.messages_per_s += figures.messages_per_s * share;
            }
        }
        mean
    }
}
