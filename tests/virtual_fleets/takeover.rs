//! The coordinator is killed at any point, and missions continue.
//!
//! In a fleet with the stations `aster`, `basil` and `clove`, the voters are these three, the arm
//! and `fern`, the first of the robots by name. `aster` creates the cluster. So no node that may
//! coordinate first holds a role.

use crate::support::{fleet, task_began};
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::ledger::MissionState;
use consort_tests::{Fleet, RobotSpec, StationFleet, for_each_seed};
use std::cell::RefCell;
use std::time::Duration;
use tokio::time::Instant;

const SEEDS: [u64; 3] = [11, 12, 13];
const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

/// Matches a call for bids.
fn called(what: &EventKind) -> bool {
    matches!(what, EventKind::BidsRequested { .. })
}

fn awarded(what: &EventKind) -> bool {
    matches!(what, EventKind::Awarded { .. })
}

/// Asserts that the mission was carried out once and had no other effect.
async fn assert_carried_out_once(fleet: &mut Fleet, mission: &MissionId) {
    fleet.assert_completes(mission).await;
    fleet.assert_each_task_once(mission);
    fleet.assert_sample_delivered(ROOM);
    fleet.assert_exclusive_roles();
    // A later coordinator also finds the mission completed.
    let seed = fleet.seed;
    let end = |fleet: &Fleet| fleet.ledger(|ledger| ledger.mission(mission).map(|entry| entry.state.clone()));
    fleet
        .wait_until("the new coordinator to have it", SOON, |fleet| end(fleet) == Some(Some(MissionState::Completed)))
        .await;
    let number = fleet.ledger(|ledger| ledger.missions().count());
    assert_eq!(number, Some(1), "seed {seed}: missions in the ledger");
}

/// The voters see that its presence has ended; they do not wait for an election timeout, which is at least 300 ms.
#[test]
fn a_killed_coordinator_is_replaced_before_an_election_timeout() {
    let took = RefCell::new(vec![]);
    for_each_seed(1..11, async |seed| {
        let mut fleet = StationFleet::founded(seed, &["aster", "basil", "clove", "daisy", "elder"]).await;
        for _ in 0..2 {
            let coordinator = fleet.wait_for_coordinator().await;
            // Its voters follow it, and watch its presence.
            fleet.advance(Duration::from_secs(1)).await;
            let killed_at = Instant::now();
            fleet.kill(&coordinator).await;
            fleet.wait_for_coordinator().await;
            took.borrow_mut().push(killed_at.elapsed());
        }
    });
    let mut took = took.into_inner();
    took.sort();
    let (median, longest) = (took[took.len() / 2], took[took.len() - 1]);
    assert!(median < Duration::from_millis(100) && longest < Duration::from_millis(300), "{took:?}");
}

#[test]
fn the_next_coordinator_auctions_an_acknowledged_mission() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.kill("aster").await;
        let awards = fleet.event_log.count(awarded);
        assert_eq!(awards, 0, "seed {seed}: awards before the kill\n{}", fleet.event_log_text());
        assert_carried_out_once(&mut fleet, &mission).await;
    });
}

#[test]
fn the_next_coordinator_repeats_an_interrupted_auction() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        // A member that cannot be received keeps the auction open.
        fleet.network.block_outgoing("fern".parse().expect("a name"));
        let mission = fleet.submit("a", ROOM).await;
        fleet.wait_until("a call for bids", SOON, |fleet| fleet.has_event(called)).await;
        assert!(
            !fleet.has_event(|what| matches!(what, EventKind::Closed { .. } | EventKind::Awarded { .. })),
            "seed {seed}: the auction was open at the kill\n{}",
            fleet.event_log_text()
        );
        fleet.kill("aster").await;
        fleet.heal();
        assert_carried_out_once(&mut fleet, &mission).await;
        assert!(fleet.event_log.count(called) >= 2, "seed {seed}: called anew\n{}", fleet.event_log_text());
    });
}

#[test]
fn the_next_coordinator_keeps_a_committed_award() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        let mission = fleet.submit("a", ROOM).await;
        let held = |fleet: &Fleet| fleet.holder(&mission, "r1").is_some();
        fleet.wait_until("an award", SOON, held).await;
        let epoch = |fleet: &Fleet| {
            let epochs = fleet.ledger(|ledger| {
                let roles = &ledger.mission(&mission).expect("it is there").roles;
                roles.values().filter_map(|role| role.holder.as_ref().map(|holder| holder.epoch)).collect::<Vec<_>>()
            });
            epochs.expect("a coordinator")
        };
        let before = epoch(&fleet);
        let accepted = |what: &EventKind| matches!(what, EventKind::Started { .. });
        assert!(!fleet.has_event(accepted), "seed {seed}: no role has begun at the kill\n{}", fleet.event_log_text());
        fleet.kill("aster").await;
        fleet.wait_until("the next coordinator", SOON, |fleet| fleet.coordinating().is_some()).await;
        assert_carried_out_once(&mut fleet, &mission).await;
        assert_eq!(epoch(&fleet), before, "seed {seed}: epochs\n{}", fleet.event_log_text());
        assert_eq!(fleet.event_log.count(called), 1, "seed {seed}: calls\n{}", fleet.event_log_text());
    });
}

#[test]
fn a_mission_survives_a_coordinator_kill_during_any_task() {
    let points = ["navto_room", "authenticate_nurse", "deposit", "navto_lab", "pick_up_sample", "close_drawer_lab"];
    for_each_seed(21..27, async |seed| {
        let point = points[usize::try_from(seed - 21).expect("a small number")];
        let mut fleet = fleet(seed, ROOM).await;
        let mission = fleet.submit("a", ROOM).await;
        let began = task_began(point);
        fleet.wait_until(&format!("the beginning of {point}"), SOON, |fleet| fleet.has_event(&began)).await;
        fleet.kill("aster").await;
        assert_carried_out_once(&mut fleet, &mission).await;
        assert_eq!(fleet.event_log.count(called), 1, "seed {seed}: calls\n{}", fleet.event_log_text());
        let halted = fleet.event_log.count(|what| matches!(what, EventKind::Suspended { .. }));
        assert_eq!(halted, 0, "seed {seed}: a takeover is shorter than a lease\n{}", fleet.event_log_text());
    });
}

#[test]
fn five_voters_survive_two_coordinators_killed_in_one_mission() {
    for_each_seed(SEEDS, async |seed| {
        let robots = vec![RobotSpec::carrier("fern", "Dock"), RobotSpec::carrier("gorse", "IC Room 4")];
        let stations = ["aster", "basil", "clove", "daisy", "elder"];
        let mut fleet = Fleet::hospital(seed, robots, &stations, &[ROOM]).await;
        assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}: the first coordinator");
        let mission = fleet.submit("a", ROOM).await;
        fleet.wait_until("the way to the room", SOON, |fleet| fleet.has_event(task_began("navto_room"))).await;
        fleet.kill("aster").await;
        fleet.wait_until("the deposit", SOON, |fleet| fleet.has_event(task_began("deposit"))).await;
        let second = fleet.wait_for_coordinator().await;
        fleet.kill(second.as_str()).await;
        assert_carried_out_once(&mut fleet, &mission).await;
        let third = fleet.wait_for_coordinator().await;
        assert!(third != second && third.as_str() != "aster", "seed {seed}: {third} coordinates");
    });
}
