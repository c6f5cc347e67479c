//! A robot whose checkpoint cannot be written makes no promise that it could break after a crash.

use crate::support::task_began;
use async_trait::async_trait;
use consort_fleet::node::NodeSettings;
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::knowledge::Availability;
use consort_protocol::message::FailureKind;
use consort_raft::store::CheckpointStore;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

const ROOMS: [&str; 2] = ["IC Room 6", "IC Room 5"];
const SOON: Duration = Duration::from_secs(60);
const WHY: &str = "its checkpoint cannot be written: no space left on it";

/// A checkpoint store that a test can break and repair.
#[derive(Clone)]
struct Fragile {
    inner: Arc<dyn CheckpointStore>,
    broken: Arc<AtomicBool>,
}

#[async_trait]
impl CheckpointStore for Fragile {
    async fn read(&self) -> io::Result<Option<Vec<u8>>> {
        self.inner.read().await
    }

    async fn write(&self, page: Option<Vec<u8>>) -> io::Result<()> {
        match self.broken.load(Ordering::SeqCst) {
            true => Err(io::Error::other("no space left on it")),
            false => self.inner.write(page).await,
        }
    }
}

/// `gorse` is nearest and has a breakable checkpoint store; `fern` could take its work.
async fn fleet(seed: u64, broken: &Arc<AtomicBool>) -> Fleet {
    let robots = vec![RobotSpec::carrier("gorse", "IC Room 4"), RobotSpec::carrier("fern", "Dock")];
    let broken = Arc::clone(broken);
    let adjust = Box::new(move |settings: &mut NodeSettings| {
        if settings.node.as_str() == "gorse" {
            let (inner, broken) = (Arc::clone(&settings.store.checkpoints), Arc::clone(&broken));
            settings.store.checkpoints = Arc::new(Fragile { inner, broken });
        }
    });
    let mut fleet = Fleet::adjusted_hospital(seed, robots, &["aster", "basil", "clove"], &ROOMS, adjust).await;
    fleet.wait_for_coordinator().await;
    fleet
}

fn published_availability(fleet: &Fleet) -> Option<Availability> {
    Some(fleet.knowledge_of("aster", &slug("gorse"))?.availability)
}

fn out_of_service() -> Option<Availability> {
    Some(Availability::OutOfService { problem: WHY.to_owned() })
}

/// Waits until the mission completes and returns the holder of `r1`.
async fn carried_out(fleet: &mut Fleet, mission: &MissionId, room: &str) -> String {
    fleet.assert_completes(mission).await;
    fleet.assert_sample_delivered(room);
    fleet.holder(mission, "r1").expect("held").to_string()
}

#[test]
fn a_robot_that_cannot_write_is_out_of_service_until_it_can() {
    for_each_seed([1301, 1302], async |seed| {
        let broken = Arc::new(AtomicBool::new(true));
        let mut fleet = fleet(seed, &broken).await;
        fleet.wait_until("gorse to report it", SOON, |fleet| published_availability(fleet) == out_of_service()).await;
        let first = fleet.submit("a", ROOMS[0]).await;
        assert_eq!(carried_out(&mut fleet, &first, ROOMS[0]).await, "fern", "seed {seed}\n{}", fleet.event_log_text());
        let refusals: Vec<String> = fleet
            .events()
            .iter()
            .filter_map(|what| match what {
                EventKind::Closed { record, .. } => serde_json::to_string(record).ok(),
                _ => None,
            })
            .collect();
        assert!(refusals.iter().any(|record| record.contains(WHY)), "seed {seed}: {refusals:#?}");

        broken.store(false, Ordering::SeqCst);
        fleet
            .wait_until("gorse to be free again", SOON, |fleet| {
                published_availability(fleet) == Some(Availability::Free)
            })
            .await;
        let second = fleet.submit("b", ROOMS[1]).await;
        assert_eq!(
            carried_out(&mut fleet, &second, ROOMS[1]).await,
            "gorse",
            "seed {seed}\n{}",
            fleet.event_log_text()
        );
        fleet.assert_exclusive_roles();
    });
}

#[test]
fn a_role_that_cannot_be_stored_is_returned_before_it_begins() {
    for_each_seed([1311, 1312], async |seed| {
        let broken = Arc::new(AtomicBool::new(false));
        let mut fleet = fleet(seed, &broken).await;
        fleet
            .wait_until("gorse to be free", SOON, |fleet| published_availability(fleet) == Some(Availability::Free))
            .await;
        // The robot notices only when it has something to write.
        broken.store(true, Ordering::SeqCst);
        let mission = fleet.submit("a", ROOMS[0]).await;
        assert_eq!(
            carried_out(&mut fleet, &mission, ROOMS[0]).await,
            "fern",
            "seed {seed}\n{}",
            fleet.event_log_text()
        );
        let gave_up = fleet.event_log.count(
            |what| matches!(what, EventKind::GaveUp { kind: FailureKind::Checkpoint, cause, .. } if cause == WHY),
        );
        let released = |what: &EventKind| matches!(what, EventKind::Released { cause, .. } if cause.ends_with(WHY));
        let all = |what: &EventKind| matches!(what, EventKind::Released { .. });
        let counts = (gave_up, fleet.event_log.count(released), fleet.event_log.count(all));
        assert_eq!(counts, (1, 1, 1), "seed {seed}\n{}", fleet.event_log_text());
        assert_eq!(published_availability(&fleet), out_of_service(), "seed {seed}\n{}", fleet.event_log_text());
        for (task, (began, _)) in fleet.event_log.task_executors(&mission) {
            assert!(!began.contains(&"gorse".to_owned()), "seed {seed}: {task}\n{}", fleet.event_log_text());
        }
        fleet.assert_exclusive_roles();
    });
}

#[test]
fn a_stored_role_is_finished_although_the_store_breaks() {
    for_each_seed([1321, 1322], async |seed| {
        let broken = Arc::new(AtomicBool::new(false));
        let mut fleet = fleet(seed, &broken).await;
        let mission = fleet.submit("a", ROOMS[0]).await;
        let drives = task_began("navto_room");
        fleet.wait_until("the way to the room", SOON, |fleet| fleet.has_event(&drives)).await;
        broken.store(true, Ordering::SeqCst);
        assert_eq!(
            carried_out(&mut fleet, &mission, ROOMS[0]).await,
            "gorse",
            "seed {seed}\n{}",
            fleet.event_log_text()
        );
        fleet.assert_each_task_once(&mission);
        fleet.wait_until("gorse to report it", SOON, |fleet| published_availability(fleet) == out_of_service()).await;
        // After the restart its checkpoint contains an ended role, and the robot learns that the
        // role has ended.
        fleet.kill("gorse").await;
        broken.store(false, Ordering::SeqCst);
        fleet.restart("gorse").await;
        fleet
            .wait_until("gorse to be free again", SOON, |fleet| {
                published_availability(fleet) == Some(Availability::Free)
            })
            .await;
        // The store is written in the background.
        let is_empty = async |fleet: &Fleet| fleet.checkpoint("gorse").await.is_none().then_some(());
        fleet.poll_until("an empty store", SOON, is_empty).await;
    });
}
