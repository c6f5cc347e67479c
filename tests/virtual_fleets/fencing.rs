//! Messages under an outdated award are ignored.

use crate::support::task_began;
use consort_bus::cluster_membership::{ClusterBus, ClusterMembership};
use consort_bus::{Bus, Delivery, Encoding};
use consort_protocol::codec;
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::Key;
use consort_protocol::lease::Epoch;
use consort_protocol::message::SignalHistory;
use consort_protocol::plan::Signal;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

fn picked_up() -> Signal {
    let signal = serde_json::json!({ "kind": "done", "task": "pick_up_sample", "from": "lab_arm", "to": "r1" });
    serde_json::from_value(signal).expect("a signal")
}

fn signal_received(what: &EventKind) -> bool {
    matches!(what, EventKind::Received { signal, .. } if *signal == picked_up())
}

/// A client forges the signal that the sample has been taken, while the carrier opens its drawer in
/// the laboratory.
async fn signal_sent_too_early(seed: u64, epoch: impl Fn(Epoch) -> Epoch) -> (Fleet, MissionId) {
    let mut fleet = Fleet::hospital(seed, vec![RobotSpec::carrier("gorse", "IC Room 4")], &["aster"], &[ROOM]).await;
    fleet.wait_for_coordinator().await;
    let mission = fleet.submit("a", ROOM).await;
    let opens = task_began("open_drawer_lab");
    fleet.wait_until("the drawer to be opened", SOON, |fleet| fleet.has_event(&opens)).await;
    let held = fleet.ledger(|ledger| ledger.mission(&mission)?.roles.get(&slug("lab_arm"))?.holder.clone());
    let epoch = epoch(held.flatten().expect("the arm holds its role").epoch);
    let history = SignalHistory { mission: mission.clone(), epoch, signals: BTreeSet::from([picked_up()]) };
    let key = fleet.keys().write(&Key::Signal(mission.clone(), slug("r1")));
    let bytes = codec::encode(&history).expect("a signal fits a message").into();
    // The client belongs to the same cluster, so that only the epoch distinguishes the signals.
    let membership = ClusterMembership::default();
    membership.set_from_ledger(fleet.ledger(|ledger| ledger.cluster()).flatten().expect("a cluster was created"));
    let client = ClusterBus::new(Arc::new(fleet.client.clone()), fleet.keys().clone(), membership);
    client.publish(&key, bytes, Encoding::Wire, Delivery::Drop).await.expect("a virtual bus");
    (fleet, mission)
}

#[test]
fn a_signal_of_an_older_award_is_ignored_and_reported_once() {
    for_each_seed([401, 402], async |seed| {
        let (mut fleet, mission) = signal_sent_too_early(seed, |held| Epoch { index: held.index - 1, ..held }).await;
        fleet.assert_completes(&mission).await;
        let counts: Vec<u64> = fleet
            .events()
            .iter()
            .filter_map(|what| match what {
                EventKind::StaleSignal { signal, count, .. } if *signal == picked_up() => Some(*count),
                _ => None,
            })
            .collect();
        assert_eq!(counts, [1], "seed {seed}\n{}", fleet.event_log_text());
        let taken =
            |what: &EventKind| matches!(what, EventKind::TaskEnded { task, .. } if task.as_str() == "pick_up_sample");
        let (taken, received) = (fleet.event_log.times(taken), fleet.event_log.times(signal_received));
        assert!(
            taken.len() == 1 && received.len() == 1 && taken <= received,
            "seed {seed}\n{}",
            fleet.event_log_text()
        );
        fleet.assert_each_task_once(&mission);
        fleet.assert_sample_delivered(ROOM);
    });
}

#[test]
fn the_same_signal_of_the_current_award_is_accepted() {
    for_each_seed([403], async |seed| {
        let (mut fleet, _) = signal_sent_too_early(seed, |held| held).await;
        fleet.wait_until("the carrier to accept it", SOON, |fleet| fleet.has_event(signal_received)).await;
        let taken =
            |what: &EventKind| matches!(what, EventKind::TaskEnded { task, .. } if task.as_str() == "pick_up_sample");
        assert!(!fleet.has_event(taken), "seed {seed}\n{}", fleet.event_log_text());
    });
}
