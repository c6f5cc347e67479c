//! Leadership on slow links that also carry large messages.

use crate::failover::on_wifi;
use crate::support::{Fleet, node, on_virtual_time};
use consort_bus::virtual_bus::LinkModel;
use consort_bus::{Bus as _, Delivery, Encoding};
use consort_protocol::ids::FleetId;
use consort_protocol::keys::{Key, Keys, RaftCall};
use std::time::Duration;

/// Links of 1 Mbit/s.
const SLOW: LinkModel = LinkModel { bandwidth: Some(125_000), ..LinkModel::LAN };

/// Publishes more than its links carry from the leader to the other nodes, on `key`, for half a minute. Returns whether
/// the leader remains leader.
fn keeps_its_leader(seed: u64, key: &Key) -> bool {
    let key = Keys::new(&FleetId::new("ward").expect("a slug")).write(key);
    on_virtual_time(async {
        let fleet = Fleet::bootstrapped(seed, 3, on_wifi).await;
        fleet.write(1).await;
        let leader = fleet.leader().await;
        let leadership = fleet.view(&leader).leader_id;
        let mut subscriptions = vec![];
        for name in fleet.replicas.keys().filter(|name| **name != leader) {
            subscriptions.push(fleet.network.bus(name.clone()).subscribe(&key).await.expect("a virtual bus"));
        }
        fleet.network.set_link_model(SLOW);
        let bus = fleet.network.bus(leader);
        for _ in 0..30 {
            bus.publish(&key, vec![0; 250_000].into(), Encoding::Wire, Delivery::Drop).await.expect("a virtual bus");
            tokio::time::sleep(Duration::from_secs(1)).await;
            if fleet.replicas.keys().any(|name| fleet.view(name).leader_id != leadership) {
                return false;
            }
        }
        true
    })
}

#[test]
fn large_messages_on_slow_links_replace_no_leader() {
    for seed in 0..5 {
        assert!(keeps_its_leader(seed, &Key::Events(node("ada"))), "seed {seed}");
        // As if all messages had the same priority.
        assert!(!keeps_its_leader(seed, &Key::Raft(1, RaftCall::Vote)), "seed {seed}: the links are not slow");
    }
}
