//! Robots that leave while they hold a role, for good or for a while.

use crate::support::{release_reason, released, task_began};
use consort_fleet::node::NodeSettings;
use consort_protocol::ids::MissionId;
use consort_protocol::lease::LeaseTerms;
use consort_protocol::ledger::MissionState;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use consort_world::world::SampleHolder;
use serde_json::{Value, json};
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

/// `gorse` holds the role and is at this task; `fern` could take over; the arm and the stations are
/// voters.
async fn under_way(seed: u64, task: &'static str) -> (Fleet, MissionId) {
    let robots = vec![RobotSpec::carrier("gorse", "IC Room 4"), RobotSpec::carrier("fern", "Dock")];
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove", "dill"], &[ROOM]).await;
    fleet.wait_for_coordinator().await;
    let mission = fleet.submit("a", ROOM).await;
    fleet.wait_until(task, SOON, |fleet| fleet.has_event(task_began(task))).await;
    assert_eq!(fleet.holder(&mission, "r1").expect("held").as_str(), "gorse", "seed {seed}");
    (fleet, mission)
}

/// Waits until the view of the coordinator contains no such node.
async fn no_more(fleet: &Fleet, what: &str, limit: Duration, is: impl Fn(&Value) -> bool) {
    let gone = async |fleet: &Fleet| {
        let views = fleet.view("fleet").await;
        (!views["fleet"]["nodes"].as_array().expect("a list").iter().any(&is)).then_some(())
    };
    fleet.poll_until(what, limit, gone).await;
}

#[test]
fn a_leaving_robot_returns_its_role_and_is_removed() {
    for_each_seed([1201, 1202, 1203], async |seed| {
        let (mut fleet, mission) = under_way(seed, "navto_room").await;
        let began_to_leave = fleet.elapsed();
        let reply = fleet.leave("gorse").await;
        let left = fleet.elapsed();
        assert_eq!(
            (&reply["role_released"], &reply["successor"]),
            (&json!(true), &json!(null)),
            "seed {seed}: {reply}"
        );
        // The robot reports it by itself, long before its lease would have expired.
        let causes: Vec<_> = fleet.events().iter().filter_map(release_reason).collect();
        assert_eq!(
            causes,
            ["r1: gorse as r1 could not do navto_room: it leaves the fleet"],
            "seed {seed}\n{}",
            fleet.event_log_text()
        );
        assert!(left - began_to_leave < Duration::from_secs(1), "seed {seed}: {:?}", left - began_to_leave);
        fleet
            .wait_until("fern to begin", Duration::from_secs(2), |fleet| {
                fleet.role_intervals_of(&mission, "r1").last().is_some_and(|spell| spell.robot.as_str() == "fern")
            })
            .await;
        let is_gorse = |node: &Value| node["node"] == "gorse";
        no_more(&fleet, "that gorse is not alive", Duration::from_secs(3), |node| {
            is_gorse(node) && node["alive"] == true
        })
        .await;
        let place = fleet.position("gorse");
        fleet.assert_completes(&mission).await;
        assert_eq!(fleet.position("gorse"), place, "seed {seed}: it stands still");
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
        // Once removed, the robot is in no view.
        no_more(&fleet, "that gorse is forgotten", SOON, is_gorse).await;
        assert!(!fleet.presence_tokens().await.iter().any(|token| token.contains("gorse")), "seed {seed}");
    });
}

#[test]
fn a_robot_that_leaves_with_the_sample_needs_intervention() {
    for_each_seed([1211, 1212], async |seed| {
        let (mut fleet, mission) = under_way(seed, "navto_lab").await;
        let reply = fleet.leave("gorse").await;
        assert_eq!(reply["role_released"], true, "seed {seed}: {reply}");
        let MissionState::NeedsIntervention { cause, items, .. } = fleet.wait_for_end(&mission).await else {
            panic!("seed {seed}: it ended in another state\n{}", fleet.event_log_text())
        };
        assert!(cause.starts_with("gorse was lost as r1 and has the sample: "), "seed {seed}: {cause}");
        assert!(cause.ends_with("it leaves the fleet"), "seed {seed}: {cause}");
        assert!(items[0].certain && items[0].place.is_some(), "seed {seed}: {items:?}");
        assert_eq!(fleet.sample_holder(ROOM), SampleHolder::Drawer(slug("gorse")), "seed {seed}");
        let tasks = fleet.task_counts(&mission);
        assert_eq!(tasks["navto_lab"], (1, 0), "seed {seed}: no other robot began it\n{}", fleet.event_log_text());
    });
}

#[test]
fn a_stopped_robot_continues_if_it_returns_in_time() {
    for_each_seed([1221, 1222], async |seed| {
        let (mut fleet, mission) = under_way(seed, "navto_lab").await;
        fleet.stop("gorse").await;
        tokio::time::sleep(LeaseTerms::default().lease / 2).await;
        fleet.restart("gorse").await;
        fleet.assert_completes(&mission).await;
        assert_eq!(fleet.holder(&mission, "r1").expect("held").as_str(), "gorse", "seed {seed}");
        assert!(!fleet.has_event(released), "seed {seed}\n{}", fleet.event_log_text());
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
    });
}

#[test]
fn a_stopped_robot_is_replaced_after_its_lease() {
    for_each_seed([1231, 1232], async |seed| {
        let (mut fleet, mission) = under_way(seed, "navto_room").await;
        let stopped = fleet.elapsed();
        fleet.stop("gorse").await;
        fleet.wait_until("a release", SOON, |fleet| fleet.has_event(released)).await;
        let (terms, waited) = (LeaseTerms::default(), fleet.elapsed() - stopped);
        assert!(waited >= terms.grace + terms.lease / 2, "seed {seed}: after {waited:?}\n{}", fleet.event_log_text());
        fleet.assert_completes(&mission).await;
        assert_eq!(fleet.holder(&mission, "r1").expect("held").as_str(), "fern", "seed {seed}");
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
    });
}

/// Starts a fleet in which the robot `gorse` is the only possible voter.
async fn of_one_voter(seed: u64) -> Fleet {
    let robots = vec![RobotSpec::carrier("gorse", "IC Room 4")];
    let only_gorse = |settings: &mut NodeSettings| {
        settings.may_vote = settings.node == slug("gorse");
        settings.fleet.bootstrap_expect = 1;
    };
    Fleet::adjusted_hospital(seed, robots, &[], &[ROOM], Box::new(only_gorse)).await
}

fn must_stay(reply: &Value) -> bool {
    reply["error"].as_str().is_some_and(|problem| {
        problem.starts_with("gorse is the only voter, and there is no other node that may vote")
            && problem.ends_with("stop gorse (SIGTERM) and keep its data")
    })
}

#[test]
fn a_robot_that_may_not_leave_still_wins_missions() {
    for_each_seed([1241, 1242], async |seed| {
        let mut fleet = of_one_voter(seed).await;
        fleet.wait_for_coordinator().await;
        let reply = fleet.request_leave("gorse").await;
        assert!(must_stay(&reply), "seed {seed}: {reply}");
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
        assert_eq!(fleet.holder(&mission, "r1").expect("held").as_str(), "gorse", "seed {seed}");
        fleet.assert_sample_delivered(ROOM);
        // SIGTERM works in any case.
        fleet.stop("gorse").await;
    });
}

#[test]
fn a_robot_that_may_not_leave_keeps_its_role() {
    for_each_seed([1251, 1252], async |seed| {
        let mut fleet = of_one_voter(seed).await;
        fleet.wait_for_coordinator().await;
        let mission = fleet.submit("a", ROOM).await;
        fleet.wait_until("navto_room", SOON, |fleet| fleet.has_event(task_began("navto_room"))).await;
        let reply = fleet.request_leave("gorse").await;
        assert!(must_stay(&reply), "seed {seed}: {reply}");
        fleet.assert_completes(&mission).await;
        assert!(!fleet.has_event(released), "seed {seed}\n{}", fleet.event_log_text());
        assert_eq!(fleet.role_intervals_of(&mission, "r1").len(), 1, "seed {seed}\n{}", fleet.event_log_text());
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
    });
}
