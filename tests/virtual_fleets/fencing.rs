//! What is said under an award that is no longer in force is not listened to.

use crate::usual::began;
use consort_actors::allegiance::{Allegiance, ClusterBus};
use consort_actors::bus::{Bus, Delivery, Encoding};
use consort_protocol::codec;
use consort_protocol::event::Happening;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::Key;
use consort_protocol::lease::Epoch;
use consort_protocol::message::Said;
use consort_protocol::plan::Signal;
use consort_tests::{Fleet, Member, slug, tell};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

fn picked_up() -> Signal {
    let signal = serde_json::json!({ "kind": "done", "task": "pick_up_sample", "from": "lab_arm", "to": "r1" });
    serde_json::from_value(signal).expect("a signal")
}

fn heard_it(what: &Happening) -> bool {
    matches!(what, Happening::Heard { signal, .. } if *signal == picked_up())
}

/// Somebody says that the sample has been taken, while the carrier opens its drawer in the laboratory for that.
async fn told_too_early(seed: u64, epoch: impl Fn(Epoch) -> Epoch) -> (Fleet, MissionId) {
    let mut fleet = Fleet::hospital(seed, vec![Member::carrier("gorse", "IC Room 4")], &["aster"], &[ROOM]).await;
    fleet.coordinator().await;
    let mission = fleet.submit("a", ROOM).await;
    let opens = began("open_drawer_lab");
    fleet.until("the drawer to be opened", SOON, |fleet| fleet.happened(&opens)).await;
    let held = fleet.ledger(|ledger| ledger.mission(&mission)?.roles.get(&slug("lab_arm"))?.holder.clone());
    let epoch = epoch(held.flatten().expect("the arm holds its role").epoch);
    let said = Said { mission: mission.clone(), epoch, signals: BTreeSet::from([picked_up()]) };
    let key = fleet.keys().write(&Key::Signal(mission.clone(), slug("r1")));
    let bytes = codec::encode(&said).expect("one signal fits a message").into();
    // Somebody of the same cluster: it is the epoch alone that tells them apart.
    let allegiance = Allegiance::default();
    allegiance.keep(fleet.ledger(|ledger| ledger.cluster()).flatten().expect("a ledger that was founded"));
    let client = ClusterBus::new(Arc::new(fleet.client.clone()), fleet.keys().clone(), allegiance);
    client.publish(&key, bytes, Encoding::Wire, Delivery::Drop).await.expect("a virtual bus");
    (fleet, mission)
}

#[test]
fn a_signal_of_an_older_award_is_ignored_counted_and_told_of_once() {
    tell([401, 402], async |seed| {
        let (mut fleet, mission) = told_too_early(seed, |held| Epoch { index: held.index - 1, ..held }).await;
        fleet.completes(&mission).await;
        let counts: Vec<u64> = fleet
            .happenings()
            .iter()
            .filter_map(|what| match what {
                Happening::Outdated { signal, count, .. } if *signal == picked_up() => Some(*count),
                _ => None,
            })
            .collect();
        assert_eq!(counts, [1], "seed {seed}\n{}", fleet.tale());
        let taken =
            |what: &Happening| matches!(what, Happening::TaskEnded { task, .. } if task.as_str() == "pick_up_sample");
        let (taken, heard) = (fleet.chronicle.times(taken), fleet.chronicle.times(heard_it));
        assert!(taken.len() == 1 && heard.len() == 1 && taken <= heard, "seed {seed}\n{}", fleet.tale());
        fleet.each_task_once(&mission);
        fleet.sample_delivered(ROOM);
    });
}

#[test]
fn the_same_signal_of_the_award_in_force_would_be_believed() {
    tell([403], async |seed| {
        let (mut fleet, _) = told_too_early(seed, |held| held).await;
        fleet.until("the carrier to believe it", SOON, |fleet| fleet.happened(heard_it)).await;
        let taken =
            |what: &Happening| matches!(what, Happening::TaskEnded { task, .. } if task.as_str() == "pick_up_sample");
        assert!(!fleet.happened(taken), "seed {seed}\n{}", fleet.tale());
    });
}
