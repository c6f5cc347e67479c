//! Records and membership: the key of a robot neither forges records nor declares other nodes down or restarted.

use super::{ROOM, SEEDS, SOON, closed, stolen};
use consort_bus::{Bus as _, Delivery, Encoding};
use consort_gossip::packet_about;
use consort_protocol::codec;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::Key;
use consort_protocol::knowledge::{Availability, Digest, DigestScope, KnowledgeBase, Record, RecordStamp};
use consort_protocol::message::Exchange;
use consort_protocol::trust::NodeRole;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use std::time::Duration;

/// Returns the record of a robot in the knowledge base of a node.
fn known_record(fleet: &Fleet, at: &str, of: &str) -> Option<Record> {
    let entry = |base: &KnowledgeBase| base.get(&of.parse().expect("a name")).map(|entry| entry.record.clone());
    fleet.knowledge(at).read(entry)
}

fn record(fleet: &Fleet, at: &str, of: &str) -> Record {
    known_record(fleet, at, of).expect("it is known")
}

#[test]
fn a_relaying_node_can_neither_change_nor_forge_records() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let signing = stolen(&fleet, "fern", NodeRole::Robot).await.signing;
        let signed = |record: Option<Record>| {
            record.is_some_and(|record| record.proof.is_some() && record.knowledge.cluster.is_some())
        };
        fleet
            .wait_until("records are signed", SOON, |fleet| {
                ["lab-arm", "gorse"].iter().all(|of| signed(known_record(fleet, "gorse", of)))
            })
            .await;

        let original = record(&fleet, "gorse", "lab-arm");
        let later = RecordStamp { incarnation: u64::MAX, version: 7 };
        let mut broken = original.clone();
        broken.stamp = later;
        broken.knowledge.robot.as_mut().expect("a robot").availability =
            Availability::OutOfService { problem: "says fern".to_owned() };
        let by_fern = Record { proof: Some(signing.record_signer().sign(&broken)), ..broken.clone() };
        let renewed = Record { stamp: later, ..original.clone() };
        let unsigned = Record { proof: None, ..broken.clone() };
        let malformed = |fleet: &Fleet| fleet.knowledge("gorse").counters().malformed;
        let before = malformed(&fleet);
        let key = fleet.keys().write(&Key::Gossip("gorse".parse().expect("a name")));
        let hand_over = async |digest: Digest, records: Vec<Record>| {
            let exchange = Exchange { sums: vec![], scope: DigestScope::ALL, digest, records };
            let bytes = codec::encode_for_version(2, exchange).expect("a message");
            let mut answers = signing.query(&key, bytes.into(), Duration::from_secs(1)).await.expect("a network");
            answers.recv().await.is_some_and(|answer| answer.payload.is_ok())
        };
        // A node whose certificate is not known yet must repeat the query.
        while !hand_over(Digest::new(), vec![]).await {}
        for record in [broken, by_fern, renewed, unsigned] {
            assert!(hand_over(Digest::new(), vec![record]).await, "seed {seed}: the rest of it is answered");
        }
        // And that gorse itself has published a version that cannot be exceeded.
        let own = Digest::from([("gorse".parse().expect("a name"), later)]);
        assert!(!hand_over(own, vec![]).await, "seed {seed}: what cannot be is not answered");
        fleet.wait_until("gorse has counted them", SOON, |fleet| malformed(fleet) == before + 4).await;
        for of in ["lab-arm", "gorse"] {
            let known = record(&fleet, "gorse", of);
            assert!(known.stamp.incarnation < 100, "seed {seed}: {known:?}");
        }
        assert_eq!(record(&fleet, "gorse", "lab-arm").knowledge, original.knowledge, "seed {seed}");
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
    });
}

/// A robot's key declares no other node down or restarted: neither in the name of that node, nor as its own
/// verdict.
#[test]
fn the_key_of_a_robot_declares_no_other_node_down() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let signing = stolen(&fleet, "fern", NodeRole::Robot).await.signing;
        let nodes = ["aster", "basil", "clove", "gorse", "lab-arm"];
        let all_know = |fleet: &Fleet| {
            let knows = |at: &str| nodes.iter().all(|of| known_record(fleet, at, of).is_some());
            nodes.iter().all(|at| knows(at))
        };
        fleet.wait_until("all nodes know each other", SOON, all_know).await;
        let identity = |of: &str| -> (NodeId, u64) { (slug(of), record(&fleet, "aster", of).stamp.incarnation) };
        // With the time since when: it changes with every verdict and every suspicion.
        let statuses = |fleet: &Fleet| nodes.map(|at| nodes.map(|of| fleet.knowledge(at).status(&slug(of))));
        let before = statuses(&fleet);
        for _ in 0..20 {
            for to in nodes {
                let key = fleet.keys().write(&Key::Swim(slug(to)));
                for about in nodes.into_iter().filter(|about| *about != to) {
                    let (now, later) = (identity(about), (slug(about), identity(about).1 + 1));
                    for from in [now.clone(), (slug("fern"), 1_000)] {
                        for (about, is_alive) in [(now.clone(), false), (later.clone(), true)] {
                            let packet = packet_about(from.clone(), about, is_alive, identity(to));
                            let sent = signing.publish(&key, packet, Encoding::Wire, Delivery::Drop).await;
                            sent.expect("its key permits packets");
                        }
                    }
                }
            }
            tokio::time::sleep(Duration::from_millis(200)).await; // virtual time
        }
        assert_eq!(statuses(&fleet), before, "seed {seed}\n{}", fleet.event_log_text());
        let malformed = nodes.map(|node| fleet.knowledge(node).counters().malformed);
        assert!(malformed.iter().all(|count| *count > 0), "seed {seed}: {malformed:?}");
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
    });
}

/// A node that was out of reach is a member again when it returns, whatever incarnation a robot's key has
/// stated in its name meanwhile.
#[test]
fn the_key_of_a_robot_keeps_no_other_node_out() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let signing = stolen(&fleet, "fern", NodeRole::Robot).await.signing;
        let others = ["aster", "basil", "gorse", "lab-arm"];
        let all_hold =
            |fleet: &Fleet, is_alive| others.iter().all(|at| fleet.knowledge(at).is_alive(&slug("clove")) == is_alive);
        fleet.wait_until("clove is a member", SOON, |fleet| all_hold(fleet, true)).await;
        let identity = |of: &str| -> (NodeId, u64) { (slug(of), record(&fleet, "aster", of).stamp.incarnation) };
        let (clove, identities) = (identity("clove"), others.map(identity));
        fleet.network.isolate(slug("clove"));
        fleet.wait_until("clove is down", SOON, |fleet| all_hold(fleet, false)).await;
        for ahead in [1, 1_000, u64::MAX / 2] {
            for to in &identities {
                let (key, about) = (fleet.keys().write(&Key::Swim(to.0.clone())), (clove.0.clone(), clove.1 + ahead));
                let packet = packet_about((slug("fern"), 1_000), about, true, to.clone());
                let sent = signing.publish(&key, packet, Encoding::Wire, Delivery::Drop).await;
                sent.expect("its key permits packets");
            }
        }
        let is_believed = |fleet: &Fleet| !all_hold(fleet, false);
        fleet.assert_never("belief in a claim", Duration::from_millis(500), is_believed).await;
        fleet.network.heal();
        fleet.wait_until("clove is a member again", SOON, |fleet| all_hold(fleet, true)).await;
    });
}
