//! A role has at most a single active holder under all network faults.

use crate::support::{released, task_began};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, RoleId};
use consort_protocol::keys::{ApiCall, Key};
use consort_protocol::knowledge::Availability;
use consort_protocol::lease::{EndReason, LEASE_REACTION, LeaseTerms};
use consort_skills::actions::NavigateToPose;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use consort_world::world::{LoggedEvent, WorldEvent as InWorld};
use serde_json::json;
use std::time::Duration;

const SEEDS: [u64; 3] = [81, 82, 83];
const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);
/// Interval at which a robot checks its lease.
const BEAT: Duration = Duration::from_millis(260);

fn suspended(what: &EventKind) -> bool {
    matches!(what, EventKind::Suspended { .. })
}

fn replaced(what: &EventKind) -> bool {
    matches!(what, EventKind::Halted { reason: EndReason::Replaced, .. })
}

/// Starts a mission; a carrier is on its long way to the room and has sent no signal yet.
async fn under_way(seed: u64) -> (Fleet, MissionId) {
    fleet_with_clock_rates(seed, 1.0, [0.6, 0.7]).await
}

/// Same, but the clocks of the carriers count `rate` seconds per second; all other clocks are
/// right.
async fn fleet_with_clock_rates(seed: u64, rate: f64, speeds: [f64; 2]) -> (Fleet, MissionId) {
    let [fern, gorse] = speeds;
    let robots = [
        RobotSpec::carrier("fern", "Dock").with_speed(fern),
        RobotSpec::carrier("gorse", "PC Room 8").with_speed(gorse),
    ];
    let robots = robots.into_iter().map(|robot| robot.with_clock(rate)).collect();
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[ROOM]).await;
    assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}: the coordinator");
    let mission = fleet.submit("a", ROOM).await;
    fleet.wait_until("the way to the room", SOON, |fleet| fleet.has_event(task_began("navto_room"))).await;
    (fleet, mission)
}

fn holder(fleet: &Fleet, mission: &MissionId) -> (String, String) {
    let holder = fleet.holder(mission, "r1").expect("held").to_string();
    let other = if holder == "gorse" { "fern" } else { "gorse" };
    (holder, other.to_owned())
}

/// Returns an instant of the world at which both carriers drove, if there is any.
fn two_drivers(fleet: &Fleet) -> Option<String> {
    let mut driving: Vec<(String, u64)> = vec![];
    let mut drives = 0;
    let mut clash = None;
    for LoggedEvent { time, event: what } in fleet.journal() {
        match what {
            InWorld::GoalStarted { robot, id, goal } if goal.is::<NavigateToPose>() => {
                drives += 1;
                driving.push((robot.to_string(), id.0));
            }
            InWorld::GoalEnded { robot, id, .. } => driving.retain(|one| *one != (robot.to_string(), id.0)),
            _ => {}
        }
        let first = driving.first().map(|(robot, _)| robot);
        if driving.iter().any(|(robot, _)| Some(robot) != first) {
            clash.get_or_insert_with(|| format!("{driving:?} at {time:?}"));
        }
    }
    assert!(drives > 1, "seed {}: {drives} drives in the journal", fleet.seed);
    clash
}

/// Leaves a robot only its link to the world host, so that nothing but its own lease stops it.
fn isolate_with_driver(fleet: &Fleet, robot: &str) {
    for node in fleet.running().iter().filter(|node| **node != robot && *node != "world") {
        let (robot, node) = (slug::<NodeId>(robot), slug::<NodeId>(node));
        fleet.network.cut(robot.clone(), node.clone());
        fleet.network.cut(node, robot);
    }
}

/// Asserts that the holder suspends in time, that the role moves to the other carrier only
/// afterwards, and that only the other carrier completes the mission.
async fn replaced_in_time(fleet: &mut Fleet, mission: &MissionId, latest: Duration) {
    let seed = fleet.seed;
    let (old, new) = holder(fleet, mission);
    let cut = fleet.elapsed();
    fleet.wait_until("the suspension", SOON, |fleet| fleet.has_event(suspended)).await;
    let stopped = fleet.elapsed() - cut;
    assert!(stopped <= latest + BEAT, "seed {seed}: suspended only after {stopped:?}\n{}", fleet.event_log_text());
    fleet.wait_for_rest(&old).await;
    let place = fleet.position(&old);
    fleet.wait_until("the release", SOON, |fleet| fleet.has_event(released)).await;
    assert!(
        fleet.event_log.times(suspended) < fleet.event_log.times(released),
        "seed {seed}\n{}",
        fleet.event_log_text()
    );
    fleet
        .wait_until("the other to begin", SOON, |fleet| {
            fleet.role_intervals_of(mission, "r1").last().is_some_and(|spell| spell.robot.as_str() == new)
        })
        .await;
    assert_eq!(fleet.position(&old), place, "seed {seed}: it stands still\n{}", fleet.event_log_text());
    fleet.heal();
    fleet.wait_until("the previous holder to halt its role", SOON, |fleet| fleet.has_event(replaced)).await;
    fleet.assert_completes(mission).await;
    fleet.assert_sample_delivered(ROOM);
    fleet.assert_exclusive_roles();
    assert_eq!(two_drivers(fleet), None, "seed {seed}\n{}", fleet.event_log_text());
    let doers = &fleet.event_log.task_executors(mission)["navto_room"];
    assert_eq!(*doers, (vec![old, new.clone()], vec![new]), "seed {seed}\n{}", fleet.event_log_text());
}

#[test]
fn an_isolated_robot_suspends_before_it_is_replaced() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, mission) = under_way(seed).await;
        let (old, _) = holder(&fleet, &mission);
        fleet.cut_off(&[&old]);
        replaced_in_time(&mut fleet, &mission, LeaseTerms::default().lease).await;
    });
}

#[test]
fn a_robot_that_reaches_only_its_driver_still_suspends() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, mission) = under_way(seed).await;
        let (old, _) = holder(&fleet, &mission);
        isolate_with_driver(&fleet, &old);
        replaced_in_time(&mut fleet, &mission, LeaseTerms::default().lease).await;
    });
}

#[test]
fn a_robot_keeps_moving_through_a_short_isolation() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, mission) = under_way(seed).await;
        let (old, _) = holder(&fleet, &mission);
        fleet.cut_off(&[&old]);
        fleet.assert_never("a suspension", Duration::from_millis(2500), |fleet| fleet.has_event(suspended)).await;
        fleet.heal();
        fleet.assert_completes(&mission).await;
        fleet.assert_each_task_once(&mission);
        fleet.assert_sample_delivered(ROOM);
        assert!(!fleet.has_event(suspended) && !fleet.has_event(released), "seed {seed}\n{}", fleet.event_log_text());
    });
}

#[test]
fn a_coordinator_cut_off_with_a_holder_stops_renewing_its_lease() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, mission) = under_way(seed).await;
        let (old, _) = holder(&fleet, &mission);
        fleet.cut_off(&["aster", &old]);
        // It may renew as long as its check-quorum period lasts.
        let terms = LeaseTerms::default();
        replaced_in_time(&mut fleet, &mission, terms.leadership_age_max() + terms.lease).await;
        let coordinator = fleet.wait_for_coordinator().await;
        assert_ne!(coordinator.as_str(), "aster", "seed {seed}");
        let down = fleet.event_log.count(|what| matches!(what, EventKind::SteppedDown { .. }));
        assert_eq!(down, 1, "seed {seed}: the previous coordinator has noticed\n{}", fleet.event_log_text());
    });
}

#[test]
fn an_isolated_robot_rests_within_the_drift_bound() {
    let terms = LeaseTerms::default();
    let drift = terms.drift_max(LEASE_REACTION);
    for (seed, rate) in [(84, 1.0), (85, 1.0 / (1.0 + drift)), (86, 1.0 + drift)] {
        for_each_seed([seed], async |seed| {
            let (mut fleet, mission) = fleet_with_clock_rates(seed, rate, [0.6, 0.7]).await;
            let (old, new) = holder(&fleet, &mission);
            isolate_with_driver(&fleet, &old);
            let cut = fleet.elapsed();
            // The robot is also at rest between two legs of its way.
            fleet.wait_until("the suspension", SOON, |fleet| fleet.has_event(suspended)).await;
            fleet.wait_until("the robot to be at rest", SOON, |fleet| is_at_rest(fleet, &old)).await;
            let rested = fleet.elapsed() - cut;
            let latest = terms.lease.mul_f64(1.0 + drift) + LEASE_REACTION;
            assert!(rested <= latest, "seed {seed}: at rest only after {rested:?}\n{}", fleet.event_log_text());
            assert!(!fleet.has_event(released), "seed {seed}: given away before\n{}", fleet.event_log_text());
            let goals = fleet.goal_counts(&old);
            fleet
                .wait_until("the other to be done with the room", SOON, |fleet| {
                    let done = &fleet.event_log.task_executors(&mission)["navto_room"].1;
                    *done == [new.clone()]
                })
                .await;
            assert_eq!(fleet.goal_counts(&old), goals, "seed {seed}: it never moved again\n{}", fleet.event_log_text());
            assert_eq!(two_drivers(&fleet), None, "seed {seed}\n{}", fleet.event_log_text());
            fleet.heal();
            fleet.assert_completes(&mission).await;
            fleet.assert_sample_delivered(ROOM);
            fleet.assert_exclusive_roles();
        });
    }
}

#[test]
fn two_robots_drive_if_a_clock_exceeds_the_drift_bound() {
    for_each_seed([87], async |seed| {
        let (mut fleet, mission) = fleet_with_clock_rates(seed, 0.3, [0.15, 0.16]).await;
        let (old, new) = holder(&fleet, &mission);
        isolate_with_driver(&fleet, &old);
        fleet
            .wait_until("the other to begin", SOON, |fleet| {
                fleet.role_intervals_of(&mission, "r1").last().is_some_and(|spell| spell.robot.as_str() == new)
            })
            .await;
        fleet.wait_until("two to drive", SOON, |fleet| two_drivers(fleet).is_some()).await;
    });
}

fn is_at_rest(fleet: &Fleet, robot: &str) -> bool {
    let (started, ended) = fleet.goal_counts(robot);
    started == ended
}

#[test]
fn a_robot_whose_node_dies_at_the_end_of_its_lease_rests_in_time() {
    for_each_seed([88, 89, 90, 91], async |seed| {
        // Slow enough that no leg of the way ends by itself.
        let (mut fleet, mission) = fleet_with_clock_rates(seed, 1.0, [0.06, 0.07]).await;
        let (old, _) = holder(&fleet, &mission);
        fleet.wait_until("the robot to drive", SOON, |fleet| !is_at_rest(fleet, &old)).await;
        isolate_with_driver(&fleet, &old);
        let (cut, lease) = (fleet.elapsed(), LeaseTerms::default().lease);
        // Its node commands the driver until shortly before it would suspend.
        let almost = lease - Duration::from_millis(700);
        fleet.assert_never("a suspension", almost, |fleet| fleet.has_event(suspended)).await;
        fleet.kill(&old).await;
        assert!(!is_at_rest(&fleet, &old), "seed {seed}: it drives");
        fleet.wait_until("the robot to be at rest", SOON, |fleet| is_at_rest(fleet, &old)).await;
        let rested = fleet.elapsed() - cut;
        assert!(rested <= lease + LEASE_REACTION, "seed {seed}: at rest only after {rested:?}");
        fleet.heal();
        fleet.assert_completes(&mission).await;
        fleet.assert_sample_delivered(ROOM);
        assert_eq!(two_drivers(&fleet), None, "seed {seed}\n{}", fleet.event_log_text());
    });
}

/// The machine of the holder is suspended for longer than lease and grace. When it resumes, its node restarts at once, or a
/// while later: until it has noticed the suspension, the former process goes on.
#[test]
fn a_node_whose_machine_was_suspended_restarts_and_does_nothing_twice() {
    for (seed, unnoticed_ms) in [(95, 0), (96, 100), (97, 1_000)] {
        for_each_seed([seed], async |seed| {
            // Slow enough that no leg of the way ends by itself.
            let (mut fleet, mission) = fleet_with_clock_rates(seed, 1.0, [0.06, 0.07]).await;
            let (old, new) = holder(&fleet, &mission);
            fleet.wait_until("the robot to drive", SOON, |fleet| !is_at_rest(fleet, &old)).await;
            fleet.network.pause(&slug(&old));
            let paused = fleet.elapsed();
            fleet.wait_until("the body to be at rest", SOON, |fleet| is_at_rest(fleet, &old)).await;
            let rested = fleet.elapsed() - paused;
            let latest = LeaseTerms::default().lease + LEASE_REACTION;
            assert!(rested <= latest, "seed {seed}: at rest only after {rested:?}\n{}", fleet.event_log_text());
            assert!(!fleet.has_event(released), "seed {seed}: given away before\n{}", fleet.event_log_text());
            let goals = fleet.goal_counts(&old);
            fleet
                .wait_until("the other to begin", SOON, |fleet| {
                    fleet.role_intervals_of(&mission, "r1").last().is_some_and(|spell| spell.robot.as_str() == new)
                })
                .await;

            fleet.network.resume(&slug(&old));
            let unnoticed = Duration::from_millis(unnoticed_ms);
            fleet.assert_never("a goal of the robot", unnoticed, |fleet| fleet.goal_counts(&old) != goals).await;
            fleet.kill(&old).await;
            fleet.restart(&old).await;
            fleet.assert_completes(&mission).await;
            fleet.assert_sample_delivered(ROOM);
            fleet.assert_exclusive_roles();
            assert_eq!(fleet.goal_counts(&old), goals, "seed {seed}: it never moved again\n{}", fleet.event_log_text());
            assert_eq!(two_drivers(&fleet), None, "seed {seed}\n{}", fleet.event_log_text());
            let context = fleet.event_log_text();
            assert_eq!(fleet.event_log.count(released), 1, "seed {seed}\n{context}");
            for (task, (began, ended)) in fleet.event_log.task_executors(&mission) {
                // Only the interrupted drive began twice.
                let expected = if task == "navto_room" { 2 } else { 1 };
                assert_eq!((began.len(), ended.len()), (expected, 1), "seed {seed}: {task}\n{context}");
            }
            let is_free = |fleet: &Fleet| {
                let record = fleet.knowledge_of("aster", &slug(&old));
                record.is_some_and(|robot| robot.availability == Availability::Free)
            };
            fleet.wait_until("the robot to be free", SOON, is_free).await;
        });
    }
}

#[test]
fn a_robot_that_leaves_releases_its_role_when_its_body_is_at_rest() {
    for_each_seed([92, 93, 94], async |seed| {
        // Slow enough that no leg of the way ends by itself.
        let (mut fleet, mission) = fleet_with_clock_rates(seed, 1.0, [0.06, 0.07]).await;
        let (old, _) = holder(&fleet, &mission);
        fleet.wait_until("the robot to drive", SOON, |fleet| !is_at_rest(fleet, &old)).await;
        // The robot cannot cancel its goal, and the driver cannot report the end.
        let (robot, world) = (slug::<NodeId>(&old), slug::<NodeId>("world"));
        fleet.network.cut(robot.clone(), world.clone());
        fleet.network.cut(world, robot);
        let (leave, bus) = (fleet.keys().write(&Key::Leave(slug(&old))), fleet.requests.clone());
        let left =
            tokio::spawn(async move { bus.query(&leave, vec![].into(), SOON).await.expect("a query").recv().await });
        fleet.wait_until("the release", SOON, |fleet| fleet.has_event(released)).await;
        assert!(is_at_rest(&fleet, &old), "seed {seed}: its goal continues\n{}", fleet.event_log_text());
        fleet.assert_completes(&mission).await;
        fleet.assert_sample_delivered(ROOM);
        assert_eq!(two_drivers(&fleet), None, "seed {seed}\n{}", fleet.event_log_text());
        assert!(left.await.expect("no panic").is_some(), "seed {seed}: a reply");
    });
}

#[test]
fn a_blocked_bus_does_not_keep_a_robot_from_suspending() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, mission) = under_way(seed).await;
        let (holder, _) = holder(&fleet, &mission);
        fleet.network.block(&slug(&holder));
        // The robot is called for bids and cannot reply. No robot has the skill, so no other robot moves.
        let mission_of_nobody = json!({
            "mission": "sterilize", "roles": { "r1": { "kind": "managed" } },
            "root": { "task": "all", "type": "disinfect", "roles": ["r1"] },
        });
        fleet.request_answered(ApiCall::Submit, &json!({ "mission": mission_of_nobody, "request": "b" })).await;
        fleet.wait_until("the end of the lease", SOON, |fleet| fleet.has_event(suspended)).await;
        fleet.network.unblock(&slug(&holder));
        fleet.assert_completes(&mission).await;
        assert_eq!(two_drivers(&fleet), None, "seed {seed}");
    });
}

/// The robot with the best bid replies to every call for bids, and never receives its award. A stolen key
/// can do the same.
#[test]
fn a_robot_that_bids_and_never_confirms_delays_a_mission_once() {
    for_each_seed(SEEDS, async |seed| {
        let robots = [("gorse", "PC Room 8"), ("fern", "Dock")].map(|(name, place)| RobotSpec::carrier(name, place));
        let mut fleet = Fleet::hospital(seed, robots.to_vec(), &["aster", "basil", "clove"], &["PC Room 8"]).await;
        assert_eq!(fleet.wait_for_coordinator().await.as_str(), "aster", "seed {seed}: the coordinator");
        fleet.network.block_queries(slug("gorse"), &fleet.keys().write(&Key::Award(slug("gorse"))));
        let mission = fleet.submit("a", "PC Room 8").await;
        fleet.assert_completes(&mission).await;
        let awarded: Vec<String> = fleet
            .events()
            .into_iter()
            .filter_map(|what| match what {
                EventKind::Awarded { holders, .. } => Some(holders.get(&slug::<RoleId>("r1"))?.to_string()),
                _ => None,
            })
            .collect();
        assert_eq!(awarded, ["gorse", "fern"], "seed {seed}\n{}", fleet.event_log_text());
    });
}
