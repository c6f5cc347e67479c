//! Worked example of a skill: a robot of a whole fleet follows a path of 15 waypoints.

use crate::support::task_began;
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::lease::EndReason;
use consort_skills::actions::{FollowWaypoints, GoalStatus};
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use consort_world::world::WorldEvent as InWorld;
use serde_json::{Value, json};
use std::time::Duration;

const MISSION: &str = include_str!("../../examples/follow-path.yaml");
const SEEDS: [u64; 2] = [781, 782];
const SOON: Duration = Duration::from_secs(60);

/// Starts a fleet with a robot that can follow paths, away from the start of the path, and a robot
/// that cannot.
async fn fleet(seed: u64) -> Fleet {
    let robots =
        vec![RobotSpec::carrier("fern", "IC Room 4").with_skill("follow_path"), RobotSpec::carrier("gorse", "Dock")];
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[]).await;
    fleet.wait_for_coordinator().await;
    fleet
}

async fn submit(fleet: &Fleet) -> MissionId {
    let mission: Value = serde_saphyr::from_str(MISSION).expect("the example is YAML");
    let answer = fleet.request_answered(ApiCall::Submit, &json!({ "mission": mission, "request": "a" })).await;
    slug(answer["mission"].as_str().unwrap_or_else(|| panic!("seed {}: {answer}", fleet.seed)))
}

/// Returns the waypoints of the goal that the world received.
fn waypoints(fleet: &Fleet) -> Option<Vec<(f64, f64)>> {
    fleet.journal().iter().find_map(|entry| match &entry.event {
        InWorld::GoalStarted { goal, .. } => {
            let FollowWaypoints { waypoints } = goal.read()?.expect("the parameters of the action");
            Some(waypoints.iter().map(|waypoint| (waypoint.pose.x, waypoint.pose.y)).collect())
        }
        _ => None,
    })
}

fn distance(a: (f64, f64), b: (f64, f64)) -> f64 {
    (b.0 - a.0).hypot(b.1 - a.1)
}

#[test]
fn a_robot_follows_a_path_over_all_waypoints_in_order() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        let mission = submit(&fleet).await;
        fleet.wait_until("the path", SOON, |fleet| waypoints(fleet).is_some()).await;
        let path = waypoints(&fleet).expect("checked before");
        assert_eq!(path.len(), 15, "seed {seed}");
        assert!(
            distance(path[14], fleet.position("fern")) < 0.01,
            "seed {seed}: it begins at {:?}",
            fleet.position("fern")
        );
        // Positions every ten milliseconds, which is every six centimetres.
        let mut driven = vec![];
        fleet
            .wait_until("the end of the path", SOON, |fleet| {
                driven.push(fleet.position("fern"));
                let path_ended = |what: &EventKind| matches!(what, EventKind::TaskEnded { task, .. } if task.as_str() == "follow_path");
                fleet.has_event(path_ended)
            })
            .await;
        fleet.assert_completes(&mission).await;
        let mut at = 0;
        for (number, waypoint) in path.iter().enumerate() {
            let passed = driven[at..].iter().position(|place| distance(*place, *waypoint) < 0.1);
            at += passed
                .unwrap_or_else(|| panic!("seed {seed}: waypoint {number} at {waypoint:?} was not passed in turn"));
        }
        assert!(
            distance(fleet.position("fern"), path[14]) < 0.01,
            "seed {seed}: it ended at {:?}",
            fleet.position("fern")
        );
        assert_eq!(fleet.all_holders(&mission), ["fern".to_owned()].into(), "seed {seed}");
    });
}

#[test]
fn a_canceled_path_stops_the_robot_on_its_way() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        let mission = submit(&fleet).await;
        fleet
            .wait_until("the path", SOON, |fleet| {
                fleet.has_event(task_began("follow_path")) && waypoints(fleet).is_some()
            })
            .await;
        let path = waypoints(&fleet).expect("checked before");
        let fifth = path[4];
        fleet.wait_until("the fifth waypoint", SOON, |fleet| distance(fleet.position("fern"), fifth) < 0.2).await;
        fleet.request_answered(ApiCall::Cancel, &json!({ "mission": mission })).await;
        let halted = |what: &EventKind| matches!(what, EventKind::Halted { reason: EndReason::Canceled, .. });
        fleet.wait_until("a halt", Duration::from_secs(2), |fleet| fleet.has_event(halted)).await;
        fleet.wait_for_rest("fern").await;
        let stands = fleet.position("fern");
        let canceled = |fleet: &Fleet| {
            let ended = fleet.journal().iter().rev().find_map(|entry| match &entry.event {
                InWorld::GoalEnded { status, .. } => Some(status.clone()),
                _ => None,
            });
            ended == Some(GoalStatus::Canceled)
        };
        assert!(canceled(&fleet), "seed {seed}\n{}", fleet.event_log_text());
        fleet.assert_never("a move", Duration::from_secs(5), |fleet| fleet.position("fern") != stands).await;
        assert!(
            distance(stands, path[14]) > 1.0 && distance(stands, fifth) < 3.0,
            "seed {seed}: it stands at {stands:?}"
        );
        assert_eq!(fleet.wait_for_end(&mission).await.as_str(), "canceled", "seed {seed}");
    });
}
