//! A robot whose notebook cannot be written promises nothing that it could not keep after a crash.

use crate::usual::began;
use async_trait::async_trait;
use consort_actors::node::NodeSettings;
use consort_actors::store::Notebook;
use consort_protocol::event::Happening;
use consort_protocol::ids::MissionId;
use consort_protocol::knowledge::Availability;
use consort_protocol::message::FailureKind;
use consort_tests::{Fleet, Member, slug, tell};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

const ROOMS: [&str; 2] = ["IC Room 6", "IC Room 5"];
const SOON: Duration = Duration::from_secs(60);
const WHY: &str = "its notebook cannot be written: no space left on it";

/// A notebook that can be made to break, and be mended.
#[derive(Clone)]
struct Fragile {
    inner: Arc<dyn Notebook>,
    broken: Arc<AtomicBool>,
}

#[async_trait]
impl Notebook for Fragile {
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

/// `gorse` is nearest and has a fragile notebook; `fern` could do its work.
async fn fleet(seed: u64, broken: &Arc<AtomicBool>) -> Fleet {
    let robots = vec![Member::carrier("gorse", "IC Room 4"), Member::carrier("fern", "Dock")];
    let broken = Arc::clone(broken);
    let adjust = Box::new(move |settings: &mut NodeSettings| {
        if settings.node.as_str() == "gorse" {
            let (inner, broken) = (Arc::clone(&settings.store.notebook), Arc::clone(&broken));
            settings.store.notebook = Arc::new(Fragile { inner, broken });
        }
    });
    let mut fleet = Fleet::adjusted_hospital(seed, robots, &["aster", "basil", "clove"], &ROOMS, adjust).await;
    fleet.coordinator().await;
    fleet
}

fn says(fleet: &Fleet) -> Option<Availability> {
    Some(fleet.knowledge_of("aster", &slug("gorse"))?.availability)
}

fn out_of_service() -> Option<Availability> {
    Some(Availability::OutOfService { problem: WHY.to_owned() })
}

/// Who carried a mission out as `r1`.
async fn carried_out(fleet: &mut Fleet, mission: &MissionId, room: &str) -> String {
    fleet.completes(mission).await;
    fleet.sample_delivered(room);
    fleet.holder(mission, "r1").expect("held").to_string()
}

#[test]
fn a_robot_that_cannot_write_is_out_of_service_until_it_can() {
    tell([1301, 1302], async |seed| {
        let broken = Arc::new(AtomicBool::new(true));
        let mut fleet = fleet(seed, &broken).await;
        fleet.until("gorse to say so", SOON, |fleet| says(fleet) == out_of_service()).await;
        let first = fleet.submit("a", ROOMS[0]).await;
        assert_eq!(carried_out(&mut fleet, &first, ROOMS[0]).await, "fern", "seed {seed}\n{}", fleet.tale());
        let refusals: Vec<String> = fleet
            .happenings()
            .iter()
            .filter_map(|what| match what {
                Happening::Closed { record, .. } => serde_json::to_string(record).ok(),
                _ => None,
            })
            .collect();
        assert!(refusals.iter().any(|record| record.contains(WHY)), "seed {seed}: {refusals:#?}");

        broken.store(false, Ordering::SeqCst);
        fleet.until("gorse to be free again", SOON, |fleet| says(fleet) == Some(Availability::Free)).await;
        let second = fleet.submit("b", ROOMS[1]).await;
        assert_eq!(carried_out(&mut fleet, &second, ROOMS[1]).await, "gorse", "seed {seed}\n{}", fleet.tale());
        fleet.one_role_one_robot();
    });
}

#[test]
fn a_role_that_cannot_be_written_down_is_given_back_before_anything_is_begun() {
    tell([1311, 1312], async |seed| {
        let broken = Arc::new(AtomicBool::new(false));
        let mut fleet = fleet(seed, &broken).await;
        fleet.until("gorse to be free", SOON, |fleet| says(fleet) == Some(Availability::Free)).await;
        // It learns of it only when it has something to write.
        broken.store(true, Ordering::SeqCst);
        let mission = fleet.submit("a", ROOMS[0]).await;
        assert_eq!(carried_out(&mut fleet, &mission, ROOMS[0]).await, "fern", "seed {seed}\n{}", fleet.tale());
        let gave_up = fleet
            .chronicle
            .count(|what| matches!(what, Happening::GaveUp { kind: FailureKind::Notebook, cause, .. } if cause == WHY));
        let released = |what: &Happening| matches!(what, Happening::Released { cause, .. } if cause.ends_with(WHY));
        let all = |what: &Happening| matches!(what, Happening::Released { .. });
        let counts = (gave_up, fleet.chronicle.count(released), fleet.chronicle.count(all));
        assert_eq!(counts, (1, 1, 1), "seed {seed}\n{}", fleet.tale());
        assert_eq!(says(&fleet), out_of_service(), "seed {seed}\n{}", fleet.tale());
        for (task, (began, _)) in fleet.chronicle.doers(&mission) {
            assert!(!began.contains(&"gorse".to_owned()), "seed {seed}: {task}\n{}", fleet.tale());
        }
        fleet.one_role_one_robot();
    });
}

#[test]
fn a_role_that_is_on_record_is_carried_out_although_the_notebook_breaks() {
    tell([1321, 1322], async |seed| {
        let broken = Arc::new(AtomicBool::new(false));
        let mut fleet = fleet(seed, &broken).await;
        let mission = fleet.submit("a", ROOMS[0]).await;
        let drives = began("navto_room");
        fleet.until("the way to the room", SOON, |fleet| fleet.happened(&drives)).await;
        broken.store(true, Ordering::SeqCst);
        assert_eq!(carried_out(&mut fleet, &mission, ROOMS[0]).await, "gorse", "seed {seed}\n{}", fleet.tale());
        fleet.each_task_once(&mission);
        fleet.until("gorse to say so", SOON, |fleet| says(fleet) == out_of_service()).await;
        // With the page of a role that is over it starts anew, and learns that it is.
        fleet.kill("gorse").await;
        broken.store(false, Ordering::SeqCst);
        fleet.restart("gorse").await;
        fleet.until("gorse to be free again", SOON, |fleet| says(fleet) == Some(Availability::Free)).await;
        assert_eq!(fleet.notebook("gorse").await, None, "seed {seed}");
    });
}
