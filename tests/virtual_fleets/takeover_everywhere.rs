//! The coordinator is killed after n observations, for every fifth n.

use consort_protocol::ledger::MissionState;
use consort_tests::{Fleet, RobotSpec, for_each_seed};
use std::cell::RefCell;
use std::time::Duration;

const ROOM: &str = "PC Room 8";

/// Kills the coordinator after `nth` observations since the request. Returns `None` if the mission
/// had ended before.
async fn killed_after(seed: u64, nth: usize, stations: &[&'static str]) -> Option<(Fleet, String, MissionState)> {
    let robots = vec![RobotSpec::carrier("amber", "PC Room 8"), RobotSpec::carrier("birch", "PC Room 2")];
    let robots = robots.into_iter().map(|robot| robot.with_speed(1.5)).collect();
    let mut fleet = Fleet::hospital(seed, robots, stations, &[ROOM]).await;
    let coordinator = fleet.wait_for_coordinator().await.to_string();
    let before = fleet.event_log.len();
    let mission = fleet.submit("a", ROOM).await;
    fleet
        .wait_until(&format!("{nth} things"), Duration::from_secs(60), |fleet| {
            fleet.event_log.len() >= before + nth || fleet.mission_state(&mission).is_some_and(|state| state.is_final())
        })
        .await;
    if fleet.mission_state(&mission).is_some_and(|state| state.is_final()) {
        return None;
    }
    fleet.kill(&coordinator).await;
    let end = fleet.wait_for_end(&mission).await;
    fleet.assert_exclusive_roles();
    if end == MissionState::Completed {
        fleet.assert_sample_delivered(ROOM);
    }
    if fleet.all_holders(&mission).iter().all(|robot| *robot != coordinator) {
        assert_eq!(end, MissionState::Completed, "seed {seed}, killed after {nth}\n{}", fleet.event_log_text());
        fleet.assert_each_task_once(&mission);
    }
    Some((fleet, coordinator, end))
}

/// Returns the final states of missions whose coordinator was killed after a multiple of `every`
/// observations.
fn ends(every: usize, first_seed: u64, stations: &[&'static str], coordinates: &str) -> Vec<MissionState> {
    let ends = RefCell::new(vec![]);
    for nth in (0..).step_by(every) {
        let before = ends.borrow().len();
        for_each_seed([first_seed + nth as u64 % 7], async |seed| {
            if let Some((fleet, coordinator, end)) = killed_after(seed, nth, stations).await {
                assert_eq!(coordinator, coordinates, "seed {seed}, killed after {nth}\n{}", fleet.event_log_text());
                ends.borrow_mut().push(end);
            }
        });
        if ends.borrow().len() == before {
            break;
        }
    }
    ends.into_inner()
}

#[test]
fn missions_complete_after_the_kill_of_a_coordinator_without_a_role() {
    let ends = ends(5, 50, &["aba", "abb"], "aba");
    assert!(ends.len() > 8, "the mission was over after {} kills", ends.len());
    assert!(ends.iter().all(|end| *end == MissionState::Completed), "{ends:?}");
}

#[test]
fn a_killed_coordinator_is_replaced_or_its_sample_is_located() {
    let (completed, otherwise): (Vec<_>, Vec<_>) =
        ends(5, 60, &["post-1", "post-2"], "amber").into_iter().partition(|end| *end == MissionState::Completed);
    for end in &otherwise {
        let MissionState::NeedsIntervention { items, .. } = end else { panic!("{end:?}") };
        let [stranded] = &items[..] else { panic!("the sample alone: {end:?}") };
        assert_eq!((stranded.item.as_str(), stranded.robot.as_str()), ("sample", "amber"), "{end:?}");
        assert!(stranded.place.is_some(), "{end:?}");
    }
    assert!(completed.len() > 3 && otherwise.len() > 3, "completed {completed:?}, not completed {otherwise:?}");
}
