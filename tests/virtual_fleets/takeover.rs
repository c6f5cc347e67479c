//! The coordinator is killed at any point, and missions go on.
//!
//! In a fleet with the stations `aster`, `basil` and `clove`, the voters are these three, the arm and `fern`, the first
//! of the robots by name; `aster` founds the ledger. None of the nodes that may coordinate first holds a role that way.

use crate::support::{fleet, task_began};
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::ledger::MissionState;
use consort_tests::{Fleet, RobotSpec, for_each_seed};
use std::time::Duration;

const SEEDS: [u64; 3] = [11, 12, 13];
const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

/// `fern` is far away and `gorse` near, so that `gorse` carries.
fn called(what: &EventKind) -> bool {
    matches!(what, EventKind::Called { .. })
}

fn awarded(what: &EventKind) -> bool {
    matches!(what, EventKind::Awarded { .. })
}

/// The mission was carried out once, and nobody noticed more than that.
async fn carried_out_once(fleet: &mut Fleet, mission: &MissionId) {
    fleet.assert_completes(mission).await;
    fleet.assert_each_task_once(mission);
    fleet.assert_sample_delivered(ROOM);
    fleet.assert_exclusive_roles();
    // A coordinator that only came later finds the mission ended, too.
    let seed = fleet.seed;
    let end = |fleet: &Fleet| fleet.ledger(|ledger| ledger.mission(mission).map(|entry| entry.state.clone()));
    fleet
        .wait_until("the new coordinator to know", SOON, |fleet| end(fleet) == Some(Some(MissionState::Completed)))
        .await;
    let number = fleet.ledger(|ledger| ledger.missions().count());
    assert_eq!(number, Some(1), "seed {seed}: missions in the ledger");
}

#[test]
fn killed_as_soon_as_the_request_is_acknowledged_it_leaves_the_auction_to_the_next() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.kill("aster").await;
        let awards = fleet.event_log.count(awarded);
        assert_eq!(awards, 0, "seed {seed}: awards before the kill\n{}", fleet.event_log_text());
        carried_out_once(&mut fleet, &mission).await;
    });
}

#[test]
fn killed_while_bids_come_in_it_leaves_a_new_auction_to_the_next() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        // A member that is not heard holds the auction open.
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
        carried_out_once(&mut fleet, &mission).await;
        assert!(fleet.event_log.count(called) >= 2, "seed {seed}: called anew\n{}", fleet.event_log_text());
    });
}

#[test]
fn killed_when_the_award_is_committed_and_nobody_knows_it_leaves_the_award_in_force() {
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
            epochs.expect("somebody coordinates")
        };
        let before = epoch(&fleet);
        let accepted = |what: &EventKind| matches!(what, EventKind::Started { .. });
        assert!(!fleet.has_event(accepted), "seed {seed}: nobody has begun at the kill\n{}", fleet.event_log_text());
        fleet.kill("aster").await;
        fleet.wait_until("the next coordinator", SOON, |fleet| fleet.coordinating().is_some()).await;
        carried_out_once(&mut fleet, &mission).await;
        assert_eq!(epoch(&fleet), before, "seed {seed}: epochs\n{}", fleet.event_log_text());
        assert_eq!(fleet.event_log.count(called), 1, "seed {seed}: calls\n{}", fleet.event_log_text());
    });
}

#[test]
fn killed_at_any_point_of_the_execution_it_is_not_missed() {
    let points = ["navto_room", "authenticate_nurse", "deposit", "navto_lab", "pick_up_sample", "close_drawer_lab"];
    for_each_seed(21..27, async |seed| {
        let point = points[usize::try_from(seed - 21).expect("a small number")];
        let mut fleet = fleet(seed, ROOM).await;
        let mission = fleet.submit("a", ROOM).await;
        let began = task_began(point);
        fleet.wait_until(&format!("the beginning of {point}"), SOON, |fleet| fleet.has_event(&began)).await;
        fleet.kill("aster").await;
        carried_out_once(&mut fleet, &mission).await;
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
        assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}: who coordinates first");
        let mission = fleet.submit("a", ROOM).await;
        fleet.wait_until("the way to the room", SOON, |fleet| fleet.has_event(task_began("navto_room"))).await;
        fleet.kill("aster").await;
        fleet.wait_until("the deposit", SOON, |fleet| fleet.has_event(task_began("deposit"))).await;
        let second = fleet.wait_for_coordinator().await;
        fleet.kill(second.as_str()).await;
        carried_out_once(&mut fleet, &mission).await;
        let third = fleet.wait_for_coordinator().await;
        assert!(third != second && third.as_str() != "aster", "seed {seed}: {third} coordinates");
    });
}
