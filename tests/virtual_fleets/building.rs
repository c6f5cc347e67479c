//! What a building and its people do to missions.

use crate::usual::began;
use consort_protocol::event::Happening;
use consort_protocol::ledger::MissionState;
use consort_sim::world::{Deed, Obstacle};
use consort_tests::{Fleet, Member, slug, tell};
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

async fn fleet(seed: u64) -> Fleet {
    let robots = vec![Member::carrier("gorse", "IC Room 4")];
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[ROOM]).await;
    fleet.coordinator().await;
    fleet
}

/// She says so to the robot beside her, while she is asked and before.
#[test]
fn a_nurse_who_calls_the_mission_off_has_it_canceled() {
    for stage in ["approach", "deposit"] {
        tell([761, 762], async |seed| {
            let mut fleet = fleet(seed).await;
            let mission = fleet.submit("a", ROOM).await;
            let begun = |fleet: &Fleet| {
                fleet
                    .happened(|what| matches!(what, Happening::TaskBegan { task, .. } if task.as_str().contains(stage)))
            };
            fleet.until("that she is met", SOON, begun).await;
            let nurse = format!("nurse of {ROOM}");
            fleet.world.with(|world| world.has_person_do(&nurse.as_str().into(), Deed::Cancels, Some(&slug("gorse"))));
            let end = fleet.end_of(&mission).await;
            let story = format!("seed {seed}, {stage}: {end:?}\n{}", fleet.tale());
            // Once she was asked to, she may have handed the sample over before she changed her mind, for all the ledger knows.
            match &end {
                MissionState::Canceled { by, .. } => assert!(stage == "approach" && *by == nurse, "{story}"),
                MissionState::NeedsRescue { cause, items } => {
                    assert!(stage == "deposit" && cause.starts_with(&format!("canceled by {nurse}")), "{story}");
                    assert!(items.iter().all(|item| !item.certain), "{story}");
                    return;
                }
                _ => panic!("{story}"),
            }
            // What she said counts for this mission alone.
            let next = fleet.submit("b", ROOM).await;
            fleet.completes(&next).await;
        });
    }
}

/// There is no other way to the room: the robot says so, and does not wait for ever.
#[test]
fn a_corridor_that_is_closed_fails_the_drive_that_has_no_other_way() {
    tell([771, 772], async |seed| {
        let mut fleet = fleet(seed).await;
        let cleaning = Obstacle::between("cleaning", slug("IC Corridor 3"), slug("IC Corridor 6"));
        fleet.world.with(|world| world.close_way(&cleaning)).expect("a lane of the map");
        let mission = fleet.submit("a", ROOM).await;
        fleet.until("the drive", SOON, |fleet| fleet.happened(began("navto_room"))).await;
        let end = fleet.end_of(&mission).await;
        let story = format!("seed {seed}: {end:?}\n{}", fleet.tale());
        let closed = "no route from IC Corridor 3 to IC Room 6: the ways between them are closed";
        assert!(format!("{end:?}").contains(closed) && fleet.tale().contains("cleaning stands in it"), "{story}");
    });
}
