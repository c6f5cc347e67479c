//! An attacker with the key of a node, at the node's place in the network.

use super::wire;
use bytes::Bytes;
use consort_bus::{Delivery, Encoding, SharedBus};
use consort_protocol::codec;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{DriverCall, Key, Keys};
use consort_protocol::knowledge::RecordStamp;
use consort_protocol::message::{Beacon, ClusterEnvelope, RecordUpdate};
use serde::Serialize;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

fn within<T: Serialize>(message: &T) -> Bytes {
    wire(&ClusterEnvelope { cluster: None, payload: wire(message).to_vec() })
}

/// Attacker with the key of a node, at the node's place in the network.
pub(super) struct Compromised {
    /// The signing bus of a node, and the plain bus below it.
    pub(super) signing: SharedBus,
    pub(super) plain: SharedBus,
    pub(super) keys: Keys,
    /// Number of replayed, redirected, forged, answered and refused messages.
    pub(super) did: [AtomicU64; 5],
}

impl Compromised {
    async fn publish(&self, bus: &SharedBus, key: &str, payload: Bytes, beside: Bytes) {
        bus.publish_with_attachment(key, payload, beside, Encoding::Wire, Delivery::Block).await.expect("a network");
    }

    /// Replays every received message, on the same key and on the keys of other nodes.
    pub(super) async fn repeats(self: Arc<Self>) {
        let mut samples = self.plain.subscribe("consort/ward/**").await.expect("a network");
        let mut replayed: BTreeSet<Bytes> = BTreeSet::new();
        while let Some(sample) = samples.recv().await {
            let what: Bytes = [sample.key.as_bytes(), &sample.payload[..], &sample.attachment[..]].concat().into();
            if !replayed.insert(what) {
                continue;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
            self.publish(&self.plain, &sample.key, sample.payload.clone(), sample.attachment.clone()).await;
            self.did[0].fetch_add(1, Ordering::Relaxed);
            let moved = ["gorse", "lab-arm", "aster", "basil"].windows(2).find_map(|pair| {
                let moved = sample.key.replace(pair[0], pair[1]);
                (moved != sample.key).then_some(moved)
            });
            if let Some(moved) = moved {
                replayed.insert([moved.as_bytes(), &sample.payload[..], &sample.attachment[..]].concat().into());
                self.publish(&self.plain, &moved, sample.payload, sample.attachment).await;
                self.did[1].fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Publishes messages of other nodes, signed with its own key.
    pub(super) async fn claims(self: Arc<Self>) {
        let node = |name: &str| NodeId::new(name).expect("a name");
        let still = RecordUpdate::Refresh {
            stamp: RecordStamp { incarnation: u64::MAX, version: u64::MAX },
            since: 1,
            proof: None,
        };
        let still = Bytes::from(codec::encode_for_version(2, still).expect("a message"));
        for round in 0.. {
            let term = 1_000_000 + round;
            for name in ["fern", "basil"] {
                let beacon = Beacon {
                    node: node(name),
                    term,
                    voters: [node("fern")].into(),
                    since_ms: 0,
                    cluster: None,
                    wire: Some(200),
                };
                let event =
                    format!(r#"{{"node": "{name}", "sequence": 1, "at_ms": 1, "event": "elected", "term": {term}}}"#);
                let body = Key::Driver("gorse".parse().expect("a name"), DriverCall::State);
                for (key, payload) in [
                    (Key::Beacon, within(&beacon)),
                    (Key::Knowledge(node("gorse")), still.clone()),
                    (Key::Events(node("basil")), event.into()),
                    (body, Bytes::from_static(b"anywhere")),
                ] {
                    self.publish(&self.signing, &self.keys.write(&key), payload, Bytes::new()).await;
                    self.did[2].fetch_add(1, Ordering::Relaxed);
                }
            }
            tokio::time::sleep(Duration::from_millis(500)).await;
        }
    }

    /// Refuses the queries of other nodes at once, signed and unsigned.
    pub(super) async fn refuses(self: Arc<Self>, key: &'static str, bare: bool) {
        let bus = if bare { &self.plain } else { &self.signing };
        let mut queries = bus.serve(&format!("consort/ward/{key}")).await.expect("a network");
        while let Some(query) = queries.recv().await {
            let _ = query.replier.refuse("no").await;
            self.did[4].fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Answers queries for other nodes by returning the query, signed and unsigned, and repeats the
    /// query to its target.
    pub(super) async fn answers(self: Arc<Self>, key: &'static str, bare: bool) {
        let bus = if bare { &self.plain } else { &self.signing };
        let mut queries = bus.serve(&format!("consort/ward/{key}")).await.expect("a network");
        let mut again: BTreeSet<Bytes> = BTreeSet::new();
        while let Some(query) = queries.recv().await {
            let on = query.key.replace('*', "gorse");
            let _ = query.replier.reply(&on, query.payload.clone(), Encoding::Wire).await;
            self.did[3].fetch_add(1, Ordering::Relaxed);
            if bare && again.insert(query.payload.clone()) {
                drop(self.plain.query(&on, query.payload, Duration::from_secs(1)).await);
            }
        }
    }
}
