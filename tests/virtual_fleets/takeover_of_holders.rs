//! The coordinator that is killed holds a role itself.

use crate::support::{released, task_began};
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::lease::LeaseTerms;
use consort_protocol::ledger::{HeldItem, MissionState};
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use std::time::Duration;

const SEEDS: [u64; 3] = [31, 32, 33];
const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

/// All five are voters; `amber` founds the ledger, and is near the room, so that it also wins the role.
async fn led_by_a_carrier(seed: u64) -> (Fleet, MissionId) {
    let robots = vec![RobotSpec::carrier("amber", "IC Room 4"), RobotSpec::carrier("birch", "Dock")];
    let mut fleet = Fleet::hospital(seed, robots, &["post-1", "post-2"], &[ROOM]).await;
    assert_eq!(fleet.wait_for_coordinator().await.as_str(), "amber", "seed {seed}: who coordinates");
    let mission = fleet.submit("a", ROOM).await;
    (fleet, mission)
}

/// `lab-arm` founds the ledger with the posts; robots that move are not among the five voters.
async fn led_by_the_arm(seed: u64) -> (Fleet, MissionId) {
    let robots = vec![RobotSpec::carrier("amber", "IC Room 4"), RobotSpec::carrier("birch", "Dock")];
    let posts = ["post-1", "post-2", "post-3", "post-4"];
    let mut fleet = Fleet::hospital(seed, robots, &posts, &[ROOM]).await;
    assert_eq!(fleet.wait_for_coordinator().await.as_str(), "lab-arm", "seed {seed}: who coordinates");
    let mission = fleet.submit("a", ROOM).await;
    (fleet, mission)
}

#[test]
fn a_carrier_killed_before_it_told_anybody_is_replaced_after_lease_and_grace() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, mission) = led_by_a_carrier(seed).await;
        fleet.wait_until("the way to the room", SOON, |fleet| fleet.has_event(task_began("navto_room"))).await;
        assert_eq!(fleet.holder(&mission, "r1").expect("held").as_str(), "amber", "seed {seed}");
        fleet.kill("amber").await;
        let killed = fleet.elapsed();
        fleet.assert_completes(&mission).await;
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
        let [given_up] = fleet.event_log.times(released)[..] else {
            panic!("seed {seed}: one release\n{}", fleet.event_log_text())
        };
        let terms = LeaseTerms::default();
        let silence = given_up - killed;
        assert!(
            silence >= terms.lease + terms.grace,
            "seed {seed}: given up after {silence:?}\n{}",
            fleet.event_log_text()
        );
        assert!(
            silence < terms.lease + terms.grace + Duration::from_secs(2),
            "seed {seed}: given up only after {silence:?}\n{}",
            fleet.event_log_text()
        );
        for (task, (began, ended)) in fleet.event_log.task_executors(&mission) {
            // Only what the dead one was at was begun twice, and it ended none of its tasks.
            let who: &[&str] = match task.as_str() {
                "navto_room" => &["amber", "birch"],
                "deposit" => &["world"],
                "pick_up_sample" => &["lab-arm"],
                _ => &["birch"],
            };
            let story = format!("seed {seed}: {task}\n{}", fleet.event_log_text());
            assert_eq!(began, who, "{story}");
            assert_eq!(ended, who[who.len() - 1..], "{story}");
        }
    });
}

/// The items that are left, as `amber (r1) at IC Room 6!`, or `?` if it is not certain.
fn left(items: &[HeldItem]) -> Vec<String> {
    let line = |kept: &HeldItem| {
        let place = kept.place.as_ref().map_or("?", |place| place.as_str());
        format!("{} ({}) at {place}{}", kept.robot, kept.role, if kept.certain { "!" } else { "?" })
    };
    items.iter().map(line).collect()
}

#[test]
fn a_carrier_killed_with_the_sample_leaves_a_mission_that_needs_rescue_and_says_where() {
    // The other one is killed with it, so that nobody can tell how the handing over ended. When the nurse begins, the
    // ledger knows that she was told; when the arm begins, either may have the sample.
    let points = [
        ("deposit", Some("world"), "may have", vec!["amber (r1) at IC Room 6?"]),
        ("deposit", None, "has", vec!["amber (r1) at IC Room 6!"]),
        ("navto_lab", None, "has", vec!["amber (r1) at IC Room 6!"]),
        ("pick_up_sample", Some("lab-arm"), "may have", vec![]),
    ];
    for (point, other, has, items_left) in points {
        for_each_seed([31, 32], async |seed| {
            let (mut fleet, mission) = led_by_a_carrier(seed).await;
            fleet.wait_until(point, SOON, |fleet| fleet.has_event(task_began(point))).await;
            fleet.kill("amber").await;
            if let Some(other) = other {
                fleet.kill(other).await;
            }
            let MissionState::NeedsRescue { cause, items } = fleet.wait_for_end(&mission).await else {
                panic!("seed {seed}, {point}: the mission ended otherwise\n{}", fleet.event_log_text())
            };
            if other == Some("lab-arm") {
                // Which of the two is given up first is open, and only its place is said.
                assert!(cause.contains(" may have the sample: "), "seed {seed}, {point}: {cause}");
                let robots: Vec<_> = items.iter().map(|kept| (kept.robot.as_str(), kept.certain)).collect();
                assert_eq!(robots, [("amber", false), ("lab-arm", false)], "seed {seed}, {point}");
                return;
            }
            let expected = format!("amber was lost as r1 and {has} the sample: amber silent for ");
            assert!(cause.starts_with(&expected), "seed {seed}, {point}: {cause}");
            assert_eq!(left(&items), items_left, "seed {seed}, {point}\n{}", fleet.event_log_text());
            assert_eq!(
                fleet.task_counts(&mission)["navto_room"],
                (1, 1),
                "seed {seed}: nobody else began\n{}",
                fleet.event_log_text()
            );
            // The other robot is free for what comes next.
            let free = |fleet: &Fleet| fleet.ledger(|ledger| ledger.held_by(&slug("lab-arm")).is_none());
            assert_eq!(free(&fleet), Some(true), "seed {seed}");
            fleet
                .wait_until("the arm to put its role down", SOON, |fleet| {
                    fleet.role_intervals_of(&mission, "lab_arm").iter().all(|spell| spell.to.is_some())
                })
                .await;
        });
    }
}

#[test]
fn a_carrier_killed_when_the_arm_has_the_sample_has_done_its_part() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, mission) = led_by_a_carrier(seed).await;
        fleet.wait_until("the handing over", SOON, |fleet| fleet.has_event(task_began("pick_up_sample"))).await;
        fleet.kill("amber").await;
        fleet.assert_completes(&mission).await;
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
        assert_eq!(fleet.event_log.count(released), 1, "seed {seed}\n{}", fleet.event_log_text());
        assert_eq!(
            fleet.task_counts(&mission)["navto_room"],
            (1, 1),
            "seed {seed}: nobody else began\n{}",
            fleet.event_log_text()
        );
    });
}

#[test]
fn an_arm_killed_and_restarted_at_once_is_given_its_role_anew() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, mission) = led_by_the_arm(seed).await;
        fleet.wait_until("the way to the room", SOON, |fleet| fleet.has_event(task_began("navto_room"))).await;
        fleet.kill("lab-arm").await;
        let second = fleet.wait_for_coordinator().await;
        fleet.start_robot("lab-arm").await;
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
        // It came back without a ledger, and neither founded another nor unseated anybody.
        assert_eq!(fleet.coordinating(), Some(second), "seed {seed}\n{}", fleet.event_log_text());
        let elections = fleet.event_log.count(|what| matches!(what, EventKind::Elected { .. }));
        assert_eq!(elections, 2, "seed {seed}: elections\n{}", fleet.event_log_text());
    });
}

#[test]
fn an_arm_that_stays_away_holds_the_mission_up_with_the_reason_until_it_returns() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, mission) = led_by_the_arm(seed).await;
        fleet.wait_until("the way to the room", SOON, |fleet| fleet.has_event(task_began("navto_room"))).await;
        fleet.kill("lab-arm").await;
        fleet.wait_until("the arm to be given up", SOON, |fleet| fleet.has_event(released)).await;
        let why = |fleet: &Fleet| {
            fleet.ledger(|ledger| ledger.mission(&mission)?.auction.as_ref()?.failure.clone()).flatten()
        };
        fleet.wait_until("an auction in vain", SOON, |fleet| why(fleet).is_some()).await;
        assert_eq!(
            why(&fleet).as_deref(),
            Some("no viable bid for lab_arm"),
            "seed {seed}\n{}",
            fleet.event_log_text()
        );
        assert_eq!(fleet.state(&mission).as_deref(), Some("pending"), "seed {seed}");
        // The carrier goes on with what it holds, and waits in the laboratory for somebody to hand over to.
        let arrived =
            |what: &EventKind| matches!(what, EventKind::TaskEnded { task, .. } if task.as_str() == "navto_lab");
        fleet.wait_until("the carrier in the laboratory", SOON, |fleet| fleet.has_event(arrived)).await;
        fleet
            .assert_never("the meeting", Duration::from_secs(10), |fleet| fleet.has_event(task_began("approach_arm")))
            .await;
        fleet.start_robot("lab-arm").await;
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
    });
}
