//! Fleets whose nodes have certificates and sign their messages, and the effect of an attacker with
//! the key of a node.

mod attacker;
mod gossip;
mod messages;
mod people;
mod requests;
mod voters;

use bytes::Bytes;
use consort_bus::{ServiceSelection, SharedBus};
use consort_protocol::codec;
use consort_protocol::trust::NodeRole;
use consort_tests::{Fleet, RobotSpec, StolenKey};
use serde::Serialize;
use std::collections::BTreeSet;
use std::time::Duration;

pub(crate) const SEEDS: [u64; 3] = [51, 52, 53];
pub(crate) const ROOM: &str = "IC Room 6";
pub(crate) const SOON: Duration = Duration::from_secs(60);

/// `fern` is far away and `gorse` near, so that `gorse` carries. Tests with an attacker do not
/// start the node of `fern`.
pub(crate) async fn closed(seed: u64, fern: RobotSpec) -> Fleet {
    let robots = vec![fern, RobotSpec::carrier("gorse", "IC Room 4")];
    let mut fleet = Fleet::closed_hospital(seed, robots, &["aster", "basil", "clove"], &[ROOM]).await;
    assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}: the first coordinator");
    fleet
}

/// Returns the buses of an attacker with the key of a node that the test does not start.
pub(crate) async fn stolen(fleet: &Fleet, name: &str, role: NodeRole) -> StolenKey {
    StolenKey::of(fleet, name, Some(role), 0).await.expect("a closed fleet")
}

/// Returns the messages that nodes rejected.
fn refused(fleet: &Fleet) -> BTreeSet<String> {
    fleet.signing_buses.values().flat_map(|bus| bus.rejections()).collect()
}

pub(crate) fn wire<T: Serialize>(message: &T) -> Bytes {
    codec::encode(message).expect("a message").into()
}

/// Returns the replies to a request, as text.
pub(crate) async fn replies(bus: &SharedBus, key: &str, payload: Bytes, attachment: Bytes) -> Vec<String> {
    let asked = bus.query_with(key, payload, attachment, Duration::from_secs(3), ServiceSelection::All).await;
    let (mut replies, mut all) = (asked.expect("a network"), vec![]);
    while let Some(reply) = replies.recv().await {
        all.push(
            reply.payload.map_or_else(|refusal| refusal.to_string(), |text| String::from_utf8_lossy(&text).into()),
        );
    }
    all
}
