//! A robot that renews its lease but completes no step loses its role.

use super::task_failures::{SkillFault, fails_with_others, set_faults};
use crate::support::{release_reason, released, task_began};
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::lease::LeaseTerms;
use consort_protocol::ledger::MissionState;
use consort_tests::{Fleet, RobotSpec, for_each_seed};
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

/// Longer than any step of a working robot, and shorter than the robot's own timeout of a task with
/// another participant: ten minutes of world time, of which ten seconds pass in a second.
const STALL_AFTER: Duration = Duration::from_secs(25);

/// `gorse` is near and wins; at the named task it stops forever. `fern` could take over.
async fn stalled_mission(seed: u64, stall_after: Duration, at: &'static str) -> (Fleet, MissionId) {
    // It approaches the nurse and later the arm.
    set_faults(match at {
        "approach_nurse" => &[SkillFault::Stalls],
        _ => &[SkillFault::Passes, SkillFault::Stalls],
    });
    let robots = vec![
        RobotSpec::carrier("gorse", "IC Room 4").with_speed(1.5).with_library(fails_with_others),
        RobotSpec::carrier("fern", "Dock").with_speed(1.5),
    ];
    let adjust = Box::new(move |settings: &mut consort_fleet::node::NodeSettings| {
        settings.fleet.stall_timeout = stall_after;
    });
    let mut fleet = Fleet::adjusted_hospital(seed, robots, &["aster", "basil", "clove"], &[ROOM], adjust).await;
    fleet.wait_for_coordinator().await;
    let mission = fleet.submit("a", ROOM).await;
    fleet.wait_until(at, SOON, |fleet| fleet.has_event(task_began(at))).await;
    assert_eq!(fleet.holder(&mission, "r1").expect("held").as_str(), "gorse", "seed {seed}");
    (fleet, mission)
}

#[test]
fn a_stalled_role_moves_to_another_robot() {
    for_each_seed([1101, 1102, 1103], async |seed| {
        let (mut fleet, mission) = stalled_mission(seed, STALL_AFTER, "approach_nurse").await;
        let stood = fleet.elapsed();
        let given_up = |fleet: &Fleet| fleet.has_event(released);
        fleet.wait_until("the role to be released", STALL_AFTER * 2, given_up).await;
        let waited = fleet.elapsed() - stood;
        // The coordinator stops renewing and releases the role when the lease has certainly
        // expired.
        let (terms, second) = (LeaseTerms::default(), Duration::from_secs(1));
        let expected = STALL_AFTER + terms.lease - second..STALL_AFTER + terms.lease + terms.grace + second * 2;
        assert!(expected.contains(&waited), "seed {seed}: {waited:?}\n{}", fleet.event_log_text());
        // `gorse` received the release and stands still. The arm has waited just as long for others
        // and keeps its role.
        let halted = |what: &EventKind| matches!(what, EventKind::Halted { .. });
        fleet.wait_until("gorse to halt its role", SOON, |fleet| fleet.has_event(halted)).await;
        fleet.assert_completes(&mission).await;
        let causes: Vec<_> = fleet.events().iter().filter_map(release_reason).collect();
        assert_eq!(causes, ["r1: gorse as r1 ended no step for 25 s"], "seed {seed}\n{}", fleet.event_log_text());
        assert_eq!(
            fleet.holder(&mission, "r1").expect("held").as_str(),
            "fern",
            "seed {seed}\n{}",
            fleet.event_log_text()
        );
        let own = |what: &EventKind| matches!(what, EventKind::TaskFailed { .. } | EventKind::TaskRetried { .. });
        assert!(!fleet.has_event(own), "seed {seed}: it gave up by itself\n{}", fleet.event_log_text());
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
    });
}

#[test]
fn a_robot_that_stalls_with_the_sample_needs_intervention() {
    for_each_seed([1111, 1112], async |seed| {
        let (mut fleet, mission) = stalled_mission(seed, STALL_AFTER, "approach_arm").await;
        let MissionState::NeedsIntervention { cause, items, .. } = fleet.wait_for_end(&mission).await else {
            panic!("seed {seed}: it ended in another state\n{}", fleet.event_log_text())
        };
        assert_eq!(cause, "gorse was lost as r1 and has the sample: gorse as r1 ended no step for 25 s", "seed {seed}");
        let kept: Vec<_> = items.iter().map(|kept| (kept.robot.as_str(), kept.certain)).collect();
        assert_eq!(kept, [("gorse", true)], "seed {seed}");
        assert!(items[0].place.is_some(), "seed {seed}: {items:?}");
    });
}

#[test]
fn a_stall_limit_of_zero_leaves_stalls_to_the_task_timeout() {
    for_each_seed([1121], async |seed| {
        let (mut fleet, mission) = stalled_mission(seed, Duration::ZERO, "approach_nurse").await;
        let given_up = |fleet: &Fleet| fleet.has_event(released);
        fleet.assert_never("a release", STALL_AFTER * 2, given_up).await;
        // After ten minutes the robot itself interrupts the task; the second attempt succeeds.
        fleet.assert_completes(&mission).await;
        assert_eq!(
            fleet.holder(&mission, "r1").expect("held").as_str(),
            "gorse",
            "seed {seed}\n{}",
            fleet.event_log_text()
        );
        let own = |what: &EventKind| matches!(what, EventKind::TaskRetried { .. });
        assert_eq!(fleet.event_log.count(own), 1, "seed {seed}\n{}", fleet.event_log_text());
        fleet.assert_sample_delivered(ROOM);
    });
}
