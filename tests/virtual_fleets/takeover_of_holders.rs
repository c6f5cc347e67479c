//! The killed coordinator holds a role itself.

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

/// All five nodes are voters. `amber` creates the cluster and is near the room, so that it also
/// wins the role.
async fn led_by_a_carrier(seed: u64) -> (Fleet, MissionId) {
    let robots = vec![RobotSpec::carrier("amber", "IC Room 4"), RobotSpec::carrier("birch", "Dock")];
    let mut fleet = Fleet::hospital(seed, robots, &["post-1", "post-2"], &[ROOM]).await;
    assert_eq!(fleet.wait_for_coordinator().await.as_str(), "amber", "seed {seed}: the coordinator");
    let mission = fleet.submit("a", ROOM).await;
    (fleet, mission)
}

/// `lab-arm` creates the cluster with the posts; mobile robots are not among the five voters.
async fn fleet_coordinated_by_the_arm(seed: u64) -> (Fleet, MissionId) {
    let robots = vec![RobotSpec::carrier("amber", "IC Room 4"), RobotSpec::carrier("birch", "Dock")];
    let posts = ["post-1", "post-2", "post-3", "post-4"];
    let mut fleet = Fleet::hospital(seed, robots, &posts, &[ROOM]).await;
    assert_eq!(fleet.wait_for_coordinator().await.as_str(), "lab-arm", "seed {seed}: the coordinator");
    let mission = fleet.submit("a", ROOM).await;
    (fleet, mission)
}

#[test]
fn a_carrier_killed_before_custody_is_replaced_after_lease_and_grace() {
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
            panic!("seed {seed}: expected a single release\n{}", fleet.event_log_text())
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
            // Only the interrupted task began twice, and the killed robot ended none of its tasks.
            // The coordinator asks the nurse, whichever node that is.
            if task == "deposit" {
                assert_eq!((began.len(), ended.len()), (1, 1), "seed {seed}: {task}\n{}", fleet.event_log_text());
                continue;
            }
            let who: &[&str] = match task.as_str() {
                "navto_room" => &["amber", "birch"],
                "pick_up_sample" => &["lab-arm"],
                _ => &["birch"],
            };
            let context = format!("seed {seed}: {task}\n{}", fleet.event_log_text());
            assert_eq!(began, who, "{context}");
            assert_eq!(ended, who[who.len() - 1..], "{context}");
        }
    });
}

/// Formats held items as `amber (r1) at IC Room 6!`, or with `?` if the item is not certain.
fn left(items: &[HeldItem]) -> Vec<String> {
    let line = |kept: &HeldItem| {
        let place = kept.place.as_ref().map_or("?", |place| place.as_str());
        format!("{} ({}) at {place}{}", kept.robot, kept.role, if kept.certain { "!" } else { "?" })
    };
    items.iter().map(line).collect()
}

#[test]
fn a_carrier_killed_with_the_sample_needs_intervention() {
    // The other participant is killed too, so that the result of the handover is unknown. When the
    // nurse begins, the ledger contains the signal to her; when the arm begins, either robot may
    // have the sample.
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
            let MissionState::NeedsIntervention { cause, items, .. } = fleet.wait_for_end(&mission).await else {
                panic!("seed {seed}, {point}: the mission ended in another state\n{}", fleet.event_log_text())
            };
            if other == Some("lab-arm") {
                // The order of the two releases is open, and only the place of the first is stated.
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
                "seed {seed}: no other robot began\n{}",
                fleet.event_log_text()
            );
            // The other robot is free for the next mission.
            let free = |fleet: &Fleet| fleet.ledger(|ledger| ledger.held_by(&slug("lab-arm")).is_none());
            assert_eq!(free(&fleet), Some(true), "seed {seed}");
            fleet
                .wait_until("the arm to halt its role", SOON, |fleet| {
                    fleet.role_intervals_of(&mission, "lab_arm").iter().all(|spell| spell.to.is_some())
                })
                .await;
        });
    }
}

#[test]
fn a_carrier_killed_after_the_handover_has_done_its_part() {
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
            "seed {seed}: no other robot began\n{}",
            fleet.event_log_text()
        );
    });
}

#[test]
fn an_arm_that_restarts_at_once_receives_its_role_again() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, mission) = fleet_coordinated_by_the_arm(seed).await;
        fleet.wait_until("the way to the room", SOON, |fleet| fleet.has_event(task_began("navto_room"))).await;
        fleet.kill("lab-arm").await;
        let second = fleet.wait_for_coordinator().await;
        fleet.start_robot("lab-arm").await;
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
        // It came back without a ledger. It neither created another cluster nor replaced the
        // coordinator.
        assert_eq!(fleet.coordinating(), Some(second), "seed {seed}\n{}", fleet.event_log_text());
        let elections = fleet.event_log.count(|what| matches!(what, EventKind::Elected { .. }));
        assert_eq!(elections, 2, "seed {seed}: elections\n{}", fleet.event_log_text());
    });
}

#[test]
fn a_mission_waits_with_a_reason_until_its_arm_returns() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, mission) = fleet_coordinated_by_the_arm(seed).await;
        fleet.wait_until("the way to the room", SOON, |fleet| fleet.has_event(task_began("navto_room"))).await;
        fleet.kill("lab-arm").await;
        fleet.wait_until("the arm to be given up", SOON, |fleet| fleet.has_event(released)).await;
        let why = |fleet: &Fleet| {
            fleet.ledger(|ledger| ledger.mission(&mission)?.auction.as_ref()?.failure.clone()).flatten()
        };
        fleet.wait_until("an auction without a result", SOON, |fleet| why(fleet).is_some()).await;
        assert_eq!(
            why(&fleet).as_deref(),
            Some("no viable bid for lab_arm"),
            "seed {seed}\n{}",
            fleet.event_log_text()
        );
        assert_eq!(fleet.state(&mission).as_deref(), Some("pending"), "seed {seed}");
        // The carrier keeps its role and waits in the laboratory for an arm to hand the sample
        // over.
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
