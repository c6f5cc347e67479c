//! Effects of the building and its people on missions.

use crate::support::task_began;
use consort_protocol::event::EventKind;
use consort_protocol::ledger::MissionState;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use consort_world::world::{Obstacle, PersonAction};
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

async fn fleet(seed: u64) -> Fleet {
    let robots = vec![RobotSpec::carrier("gorse", "IC Room 4")];
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[ROOM]).await;
    fleet.wait_for_coordinator().await;
    fleet
}

/// She reports it to the robot next to her, while the robot asks her and before.
#[test]
fn a_nurse_can_cancel_the_mission_at_the_robot() {
    for stage in ["approach", "deposit"] {
        for_each_seed([761, 762], async |seed| {
            let mut fleet = fleet(seed).await;
            let mission = fleet.submit("a", ROOM).await;
            let begun = |fleet: &Fleet| {
                fleet.has_event(
                    |what| matches!(what, EventKind::TaskBegan { task, .. } if task.as_str().contains(stage)),
                )
            };
            fleet.wait_until("that she is met", SOON, begun).await;
            let nurse = format!("nurse of {ROOM}");
            fleet.world.with(|world| {
                world.trigger_person_action(&nurse.as_str().into(), PersonAction::Cancels, Some(&slug("gorse")));
            });
            let end = fleet.wait_for_end(&mission).await;
            let context = format!("seed {seed}, {stage}: {end:?}\n{}", fleet.event_log_text());
            // After the robot asked her, she may have handed the sample over before she changed her
            // mind. The ledger cannot exclude that.
            match &end {
                MissionState::Canceled { by, .. } => assert!(stage == "approach" && *by == nurse, "{context}"),
                MissionState::NeedsIntervention { cause, items, .. } => {
                    assert!(stage == "deposit" && cause.starts_with(&format!("canceled by {nurse}")), "{context}");
                    assert!(items.iter().all(|item| !item.certain), "{context}");
                    return;
                }
                _ => panic!("{context}"),
            }
            // Her cancellation applies to this mission only.
            let next = fleet.submit("b", ROOM).await;
            fleet.assert_completes(&next).await;
        });
    }
}

/// There is no other route to the room. The robot reports that and does not wait forever.
#[test]
fn a_drive_fails_if_its_only_corridor_is_closed() {
    for_each_seed([771, 772], async |seed| {
        let mut fleet = fleet(seed).await;
        let cleaning = Obstacle::between("cleaning", slug("IC Corridor 3"), slug("IC Corridor 6"));
        fleet.world.with(|world| world.add_obstacle(&cleaning)).expect("a lane of the map");
        let mission = fleet.submit("a", ROOM).await;
        fleet.wait_until("the drive", SOON, |fleet| fleet.has_event(task_began("navto_room"))).await;
        let end = fleet.wait_for_end(&mission).await;
        let context = format!("seed {seed}: {end:?}\n{}", fleet.event_log_text());
        let closed = "no route from IC Corridor 3 to IC Room 6: the ways between them are closed";
        assert!(
            format!("{end:?}").contains(closed) && fleet.event_log_text().contains("cleaning is in the way"),
            "{context}"
        );
    });
}
