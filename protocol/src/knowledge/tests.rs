use super::*;
use crate::ensemble::example_robot;
use crate::ids::NodeId;
use crate::units::NodeTime;
use proptest::prelude::*;
use std::collections::BTreeSet;

fn record(owner: u8, incarnation: u64, version: u64) -> Record {
    Record {
        owner: NodeId::new(format!("node{owner}")).unwrap(),
        stamp: RecordStamp { incarnation, version },
        knowledge: Knowledge {
            may_vote: version.is_multiple_of(2),
            replica: Some(incarnation * 1000 + version),
            ..Knowledge::of(None)
        },
        proof: None,
    }
}

fn records() -> impl Strategy<Value = Vec<Record>> {
    prop::collection::vec((0u8..5, 0u64..3, 0u64..5).prop_map(|(o, i, v)| record(o, i, v)), 0..20)
}

fn base(records: &[Record]) -> KnowledgeBase {
    let mut base = KnowledgeBase::default();
    for record in records {
        base.merge(record.clone(), NodeTime::ZERO);
    }
    base
}

fn content(base: &KnowledgeBase) -> Vec<Record> {
    base.iter().map(|(_, entry)| entry.record.clone()).collect()
}

proptest! {
    #[test]
    fn merging_ignores_order_and_repetition((a, b) in records().prop_flat_map(|a| (Just(a.clone()), Just(a).prop_shuffle()))) {
        let mut twice = a.clone();
        twice.extend(b.clone());
        prop_assert_eq!(content(&base(&a)), content(&base(&b)));
        prop_assert_eq!(content(&base(&a)), content(&base(&twice)));
    }

    #[test]
    fn two_nodes_have_the_same_records_after_an_exchange(a in records(), b in records()) {
        let (mut ada, mut bob) = (base(&a), base(&b));
        let scope = DigestScope::of_difference(&ada.class_sums(), &bob.class_sums_like(&ada.class_sums()));
        let for_bob: Vec<Record> = ada.missing_for(scope, &bob.digest(scope)).into_iter().cloned().collect();
        let for_ada: Vec<Record> = bob.missing_for(scope, &ada.digest(scope)).into_iter().cloned().collect();
        let owners: BTreeSet<NodeId> = for_ada.iter().map(|record| record.owner.clone()).collect();
        prop_assert_eq!(ada.outdated_owners(&bob.digest(scope)), owners);
        for record in for_bob { prop_assert!(bob.merge(record, NodeTime::ZERO)); }
        for record in for_ada { prop_assert!(ada.merge(record, NodeTime::ZERO)); }
        prop_assert_eq!(content(&ada), content(&bob));
        prop_assert!(ada.missing_for(DigestScope::ALL, &bob.digest(DigestScope::ALL)).is_empty());
        prop_assert_eq!(DigestScope::of_difference(&ada.class_sums(), &bob.class_sums_like(&ada.class_sums())).within, 0);
    }
}

proptest! {
    /// Updates of an owner may be lost or overtaken; a version never gets content that it does
    /// not have.
    #[test]
    fn a_refresh_is_equivalent_to_the_unchanged_record(
        changes in prop::collection::vec(any::<bool>(), 1..12),
        received in prop::collection::vec((0usize..12, any::<bool>()), 0..30),
    ) {
        let mut since = 0;
        let mut versions = vec![];
        for (version, changed) in changes.iter().enumerate() {
            let version = version as u64;
            since = if *changed { version } else { since };
            let record_sent = Record { stamp: RecordStamp { incarnation: 1, version }, ..record(1, 1, since) };
            versions.push((record_sent, since));
        }
        let mut base = KnowledgeBase::default();
        for (which, whole) in received {
            let Some((record_sent, since)) = versions.get(which) else { continue };
            let before = base.get(&record_sent.owner).map(|entry| entry.record.stamp);
            if whole {
                base.merge(record_sent.clone(), NodeTime::ZERO);
            } else if !base.refresh(&record_sent.owner, record_sent.stamp, *since, None, NodeTime::ZERO) {
                prop_assert!(before.is_none_or(|before| before.version < *since));
                continue;
            }
            let now = base.get(&record_sent.owner).unwrap();
            prop_assert_eq!(now.record.stamp, before.map_or(record_sent.stamp, |before| before.max(record_sent.stamp)));
            prop_assert_eq!(&now.record, &versions[now.record.stamp.version as usize].0);
        }
    }
}

#[test]
fn an_earlier_incarnation_does_not_refresh_a_later_incarnation() {
    let mut base = base(&[record(1, 2, 5)]);
    let owner = record(1, 0, 0).owner;
    assert!(base.refresh(&owner, RecordStamp { incarnation: 1, version: 9 }, 0, None, NodeTime::ZERO));
    assert!(!base.refresh(&owner, RecordStamp { incarnation: 3, version: 9 }, 0, None, NodeTime::ZERO));
    assert!(!base.refresh(&record(2, 0, 0).owner, RecordStamp { incarnation: 1, version: 0 }, 0, None, NodeTime::ZERO));
    assert_eq!(content(&base), [record(1, 2, 5)]);
}

#[test]
fn sums_show_the_classes_in_which_large_bases_differ() {
    let all_records: Vec<Record> = (0..=255).map(|owner| record(owner, 1, 1)).collect();
    let (mut ada, bob) = (base(&all_records), base(&all_records));
    ada.merge(record(77, 1, 2), NodeTime::ZERO);
    let scope = DigestScope::of_difference(&ada.class_sums(), &bob.class_sums_like(&ada.class_sums()));
    assert!(scope.contains(&record(77, 0, 0).owner));
    // About a sixteenth of the classes.
    assert!((1..=40).contains(&bob.digest(scope).len()), "{}", bob.digest(scope).len());
    let strange = vec![0; 300];
    assert_eq!(DigestScope::of_difference(&bob.class_sums_like(&strange), &strange), DigestScope::ALL);
    assert_eq!(bob.digest(DigestScope::ALL).len(), 256);
    assert!(bob.digest(DigestScope::NONE).is_empty());
    assert!(!DigestScope { classes: 0, within: 0 }.contains(&record(1, 0, 0).owner));
}

#[test]
fn the_record_of_a_later_incarnation_replaces_an_earlier_record() {
    let mut base = base(&[record(1, 1, 9)]);
    assert!(base.merge(record(1, 2, 0), NodeTime::ZERO));
    assert!(!base.merge(record(1, 1, 10), NodeTime::ZERO));
}

#[test]
fn motion_counts_for_its_version_of_the_record_and_is_not_forwarded() {
    let mut base = KnowledgeBase::default();
    let mut known = record(1, 1, 1);
    known.knowledge.robot = Some(example_robot());
    let (owner, robot) = (known.owner.clone(), known.knowledge.robot.clone().unwrap());
    base.merge(known.clone(), NodeTime::ZERO);
    let update = |number, place: &str, stamp| {
        let motion = Motion::of(&RobotKnowledge { place: place.parse().unwrap(), ..robot.clone() });
        MotionUpdate { stamp, number, motion: Some(motion) }
    };
    let place = |base: &KnowledgeBase| {
        base.get(&owner).and_then(|known| known.knowledge().robot.as_ref()).map(|robot| robot.place.to_string())
    };
    assert!(base.receive_motion(&owner, &update(2, "Lab", known.stamp)));
    assert!(!base.receive_motion(&owner, &update(2, "Store", known.stamp)), "repeated");
    assert!(!base.receive_motion(&owner, &update(1, "Store", known.stamp)), "late");
    assert!(!base.receive_motion(&owner, &update(4, "Lab", known.stamp)), "a heartbeat");
    assert!(!base.receive_motion(&owner, &update(3, "Store", known.stamp)), "from before the heartbeat");
    assert!(!base.receive_motion(&owner, &update(5, "Store", RecordStamp { incarnation: 1, version: 2 })), "unknown");
    assert_eq!(place(&base).as_deref(), Some("Lab"));
    // The record that other nodes receive has the content that its owner has signed.
    assert_eq!(base.missing_for(DigestScope::ALL, &Digest::new()), [&known]);
    let next = Record { stamp: RecordStamp { incarnation: 1, version: 2 }, ..known };
    assert!(base.merge(next.clone(), NodeTime::ZERO));
    assert_eq!(place(&base), Some(robot.place.to_string()));
    assert!(base.receive_motion(&owner, &update(1, "Store", next.stamp)), "numbers begin again with each version");
}
