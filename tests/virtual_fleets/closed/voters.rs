//! The key of a voter, which may send requests of consensus.

use super::attacker::Compromised;
use super::{ROOM, SEEDS, closed, replies, stolen, wire};
use crate::support::released;
use bytes::Bytes;
use consort_bus::{Bus as _, Delivery, Encoding};
use consort_protocol::event::EventKind;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::Key;
use consort_protocol::lease::Epoch;
use consort_protocol::message::{AlarmNotice, AwardNotice, Beacon, ClusterEnvelope, OrderNotice, OrdersNotice};
use consort_protocol::trust::NodeRole;
use consort_tests::{RobotSpec, StolenKey, for_each_seed};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

#[test]
fn the_key_of_a_voter_pins_no_node_to_a_term_or_a_version() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let name: NodeId = "dill".parse().expect("a name");
        let signing = stolen(&fleet, "dill", NodeRole::Voter).await.signing;
        let cluster = fleet.ledger(|ledger| ledger.cluster()).flatten();
        let mission = fleet.submit("a", ROOM).await;
        let key = fleet.keys().write(&Key::Beacon);
        let mut attack = tokio::task::JoinSet::new();
        attack.spawn(async move {
            for term in (0..u64::MAX).rev() {
                let beacon = Beacon {
                    node: name.clone(),
                    term,
                    voters: [name.clone()].into(),
                    since_ms: 0,
                    cluster,
                    wire: Some(200),
                };
                let payload = wire(&ClusterEnvelope { cluster, payload: wire(&beacon).to_vec() });
                signing.publish(&key, payload, Encoding::Wire, Delivery::Block).await.expect("a network");
                tokio::time::sleep(Duration::from_millis(300)).await; // virtual time
            }
        });
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        fleet.assert_sample_delivered(ROOM);
        assert_eq!(fleet.event_log.count(released), 0, "seed {seed}: no role is released\n{}", fleet.event_log_text());
        attack.shutdown().await;
    });
}

/// Its key permits replies to and refusals of every request of consensus.
#[test]
fn the_key_of_a_voter_replies_to_no_request_of_consensus_for_another() {
    for_each_seed([51, 52], async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let StolenKey { signing, plain } = stolen(&fleet, "dill", NodeRole::Voter).await;
        let dill = Arc::new(Compromised { signing, plain, keys: fleet.keys().clone(), did: Default::default() });
        let mut tasks = tokio::task::JoinSet::new();
        tasks.spawn(Arc::clone(&dill).refuses("wire/raft/*/*", false));
        tasks.spawn(Arc::clone(&dill).answers("wire/raft/*/*", false));
        let elected = |what: &EventKind| matches!(what, EventKind::Elected { .. });
        let before = fleet.event_log.count(elected);
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
        assert_eq!(fleet.event_log.count(elected), before, "seed {seed}\n{}", fleet.event_log_text());
        assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}");
        let did = dill.did.each_ref().map(|count| count.load(Ordering::Relaxed));
        assert!(did[3] > 10 && did[4] > 10, "seed {seed}: replies, refusals: {did:?}");
        tasks.shutdown().await;
    });
}

#[test]
fn the_key_of_a_voter_that_does_not_lead_holds_no_robot() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let mission = fleet.submit("a", ROOM).await;
        let bus = stolen(&fleet, "dill", NodeRole::Voter).await.in_cluster(&fleet);
        let hold = Some(OrderNotice { text: "held by dill".to_owned(), remaining_ms: None });
        let alarm = hold.clone().map(|order| AlarmNotice { order, places: BTreeSet::new(), closes: BTreeSet::new() });
        let orders = OrdersNotice { as_of: Epoch { term: u64::MAX, index: 1 }, hold, alarm, ..OrdersNotice::default() };
        let payload = wire(&AwardNotice::Orders(Box::new(orders)));
        for robot in ["gorse", "lab-arm"] {
            let key = fleet.keys().write(&Key::Award(robot.parse().expect("a name")));
            // A node without a record knows no certificates, so it cannot verify the refusal.
            let verified = replies(&bus, &key, payload.clone(), Bytes::new()).await;
            assert_eq!(verified, [] as [String; 0], "seed {seed}");
        }
        // A held robot would keep its role and wait for ever.
        fleet.assert_completes(&mission).await;
    });
}
