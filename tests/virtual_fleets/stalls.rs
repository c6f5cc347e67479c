//! A robot that holds a role, answers and renews, and ends no step: in time the role is taken from it.

use super::setbacks::{Mishap, mishaps, stumbles_in_company};
use crate::usual::{began, released, why_released};
use consort_protocol::event::Happening;
use consort_protocol::ids::MissionId;
use consort_protocol::lease::LeaseTerms;
use consort_protocol::ledger::MissionState;
use consort_tests::{Fleet, Member, tell};
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

/// Longer than any step of a robot that is at work, and shorter than the robot's own patience with a task that takes somebody
/// else: ten minutes in the world, of which ten pass in a second.
const STALL_AFTER: Duration = Duration::from_secs(25);

/// `gorse` is near and wins; at the task named it stands still for ever. `fern` could take over.
async fn stands_still(seed: u64, stall_after: Duration, at: &'static str) -> (Fleet, MissionId) {
    // It approaches the nurse, who stands still, and then the arm.
    mishaps(match at {
        "approach_nurse" => &[Mishap::Stalls],
        _ => &[Mishap::Passes, Mishap::Stalls],
    });
    let robots = vec![
        Member::carrier("gorse", "IC Room 4").at_speed(1.5).trained(stumbles_in_company),
        Member::carrier("fern", "Dock").at_speed(1.5),
    ];
    let adjust = Box::new(move |settings: &mut consort_actors::node::NodeSettings| {
        settings.fleet.stall_after = stall_after;
    });
    let mut fleet = Fleet::adjusted_hospital(seed, robots, &["aster", "basil", "clove"], &[ROOM], adjust).await;
    fleet.coordinator().await;
    let mission = fleet.submit("a", ROOM).await;
    fleet.until(at, SOON, |fleet| fleet.happened(began(at))).await;
    assert_eq!(fleet.holder(&mission, "r1").expect("held").as_str(), "gorse", "seed {seed}");
    (fleet, mission)
}

#[test]
fn a_role_that_makes_no_progress_is_taken_from_its_holder_and_carried_out_by_another() {
    tell([1101, 1102, 1103], async |seed| {
        let (mut fleet, mission) = stands_still(seed, STALL_AFTER, "approach_nurse").await;
        let stood = fleet.elapsed();
        let given_up = |fleet: &Fleet| fleet.happened(released);
        fleet.until("the role to be released", STALL_AFTER * 2, given_up).await;
        let waited = fleet.elapsed() - stood;
        // It is renewed no more, and loses the role when its lease has certainly run out.
        let (terms, second) = (LeaseTerms::default(), Duration::from_secs(1));
        let expected = STALL_AFTER + terms.lease - second..STALL_AFTER + terms.lease + terms.grace + second * 2;
        assert!(expected.contains(&waited), "seed {seed}: {waited:?}\n{}", fleet.tale());
        // It heard so, and stands still; the arm has waited just as long, for others, and keeps its role.
        let halted = |what: &Happening| matches!(what, Happening::Halted { .. });
        fleet.until("gorse to put its role down", SOON, |fleet| fleet.happened(halted)).await;
        fleet.completes(&mission).await;
        let causes: Vec<_> = fleet.happenings().iter().filter_map(why_released).collect();
        assert_eq!(causes, ["r1: gorse as r1 ended no step for 25 s"], "seed {seed}\n{}", fleet.tale());
        assert_eq!(fleet.holder(&mission, "r1").expect("held").as_str(), "fern", "seed {seed}\n{}", fleet.tale());
        let own = |what: &Happening| matches!(what, Happening::TaskFailed { .. } | Happening::TaskRetried { .. });
        assert!(!fleet.happened(own), "seed {seed}: it gave up by itself\n{}", fleet.tale());
        fleet.sample_delivered(ROOM);
        fleet.one_role_one_robot();
    });
}

#[test]
fn a_robot_that_makes_no_progress_with_the_sample_in_its_drawer_needs_rescue() {
    tell([1111, 1112], async |seed| {
        let (mut fleet, mission) = stands_still(seed, STALL_AFTER, "approach_arm").await;
        let MissionState::NeedsRescue { cause, items } = fleet.end_of(&mission).await else {
            panic!("seed {seed}: it ended otherwise\n{}", fleet.tale())
        };
        assert_eq!(cause, "gorse was lost as r1 and has the sample: gorse as r1 ended no step for 25 s", "seed {seed}");
        let kept: Vec<_> = items.iter().map(|kept| (kept.robot.as_str(), kept.certain)).collect();
        assert_eq!(kept, [("gorse", true)], "seed {seed}");
        assert!(items[0].place.is_some(), "seed {seed}: {items:?}");
    });
}

#[test]
fn with_a_time_of_zero_a_holder_is_left_to_its_own_patience() {
    tell([1121], async |seed| {
        let (mut fleet, mission) = stands_still(seed, Duration::ZERO, "approach_nurse").await;
        let given_up = |fleet: &Fleet| fleet.happened(released);
        fleet.never("a release", STALL_AFTER * 2, given_up).await;
        // After its ten minutes the robot itself breaks the task off, and does it on the second attempt.
        fleet.completes(&mission).await;
        assert_eq!(fleet.holder(&mission, "r1").expect("held").as_str(), "gorse", "seed {seed}\n{}", fleet.tale());
        let own = |what: &Happening| matches!(what, Happening::TaskRetried { .. });
        assert_eq!(fleet.chronicle.count(own), 1, "seed {seed}\n{}", fleet.tale());
        fleet.sample_delivered(ROOM);
    });
}
