//! A restarted robot node continues its role if it still holds it.

use crate::support::{released, task_began};
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use consort_world::world::{LoggedEvent, SampleHolder, WorldEvent as InWorld};
use std::cell::Cell;
use std::collections::BTreeMap;
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

fn resumed(what: &EventKind) -> bool {
    matches!(what, EventKind::Resumed { .. })
}

/// `gorse` is near and wins; the stations and the arm are voters.
async fn under_way(seed: u64, others: &[&'static str], task: &'static str) -> (Fleet, MissionId) {
    let mut robots = vec![RobotSpec::carrier("gorse", "IC Room 4")];
    robots.extend(others.iter().map(|name| RobotSpec::carrier(name, "Dock")));
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove", "dill"], &[ROOM]).await;
    fleet.wait_for_coordinator().await;
    let mission = fleet.submit("a", ROOM).await;
    fleet.wait_until(task, SOON, |fleet| fleet.has_event(task_began(task))).await;
    assert_eq!(fleet.holder(&mission, "r1").expect("held").as_str(), "gorse", "seed {seed}");
    (fleet, mission)
}

/// Asserts that the first holders completed the mission, and that no task was repeated except the
/// task that a crash interrupted.
fn assert_done_once(fleet: &Fleet, mission: &MissionId, begun_twice: &[&str]) {
    let context = fleet.event_log_text();
    let tasks: BTreeMap<String, (usize, usize)> = fleet.task_counts(mission);
    for (task, (began, ended)) in &tasks {
        let expected = if begun_twice.contains(&task.as_str()) { 2 } else { 1 };
        assert_eq!((*began, *ended), (expected, 1), "seed {}: {task}\n{context}", fleet.seed);
    }
    assert!(!fleet.has_event(released), "seed {}\n{context}", fleet.seed);
    fleet.assert_sample_delivered(ROOM);
    fleet.assert_exclusive_roles();
}

/// Waits until the checkpoint store of a robot is empty.
async fn wait_for_empty_checkpoint(fleet: &Fleet, robot: &str) {
    let what = format!("the empty checkpoint store of {robot}");
    fleet.poll_until(&what, SOON, async |fleet| fleet.checkpoint(robot).await.is_none().then_some(())).await;
}

#[test]
fn a_carrier_that_restarts_within_its_lease_continues() {
    for_each_seed([301, 302, 303], async |seed| {
        let (mut fleet, mission) = under_way(seed, &["fern"], "navto_lab").await;
        fleet.kill("gorse").await;
        // From a restart at once, while the simulated robot still drives, to a restart after the
        // world noticed the missing driver.
        tokio::time::sleep(Duration::from_millis(50 + (seed - 301) * 1500)).await;
        fleet.restart("gorse").await;
        fleet.assert_completes(&mission).await;
        assert_done_once(&fleet, &mission, &["navto_lab"]);
        assert_eq!(fleet.event_log.count(resumed), 1, "seed {seed}\n{}", fleet.event_log_text());
        wait_for_empty_checkpoint(&fleet, "gorse").await;
    });
}

#[test]
fn a_robot_that_restarts_too_late_loses_its_role_and_is_free() {
    for_each_seed([311, 312], async |seed| {
        let (mut fleet, mission) = under_way(seed, &["fern"], "navto_room").await;
        fleet.kill("gorse").await;
        fleet
            .wait_until("fern to take over", SOON, |fleet| {
                fleet.role_intervals_of(&mission, "r1").last().is_some_and(|spell| spell.robot.as_str() == "fern")
            })
            .await;
        fleet.restart("gorse").await;
        let halted = |fleet: &Fleet| {
            let entries = fleet.event_log.entries();
            let gorse = entries.iter().filter(|(_, entry)| entry.node().as_str() == "gorse");
            gorse.filter_map(|(_, entry)| entry.event_kind()).any(|what| matches!(what, EventKind::Halted { .. }))
        };
        fleet.wait_until("gorse to learn it", SOON, halted).await;
        wait_for_empty_checkpoint(&fleet, "gorse").await;
        let place = fleet.position("gorse");
        fleet.assert_completes(&mission).await;
        assert_eq!(fleet.position("gorse"), place, "seed {seed}: it stood still\n{}", fleet.event_log_text());
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
        assert_eq!(fleet.event_log.count(resumed), 0, "seed {seed}\n{}", fleet.event_log_text());
        let doers = &fleet.event_log.task_executors(&mission)["navto_room"];
        assert_eq!(*doers, (vec!["gorse".to_owned(), "fern".into()], vec!["fern".into()]), "seed {seed}");

        let next = fleet.submit("b", ROOM).await;
        fleet.wait_until("an award", SOON, |fleet| fleet.holder(&next, "r1").is_some()).await;
        assert_eq!(fleet.holder(&next, "r1").expect("held").as_str(), "gorse", "seed {seed}: the nearest again");
    });
}

#[test]
fn an_unreadable_checkpoint_is_discarded() {
    let pages: [&[u8]; 3] = [&[], &[99, 1, 2, 3], &[2, 1, 255, 255, 255]];
    for (page, seed) in pages.into_iter().zip(321..) {
        for_each_seed([seed], async |seed| {
            let (mut fleet, mission) = under_way(seed, &[], "navto_room").await;
            fleet.kill("gorse").await;
            fleet.overwrite_checkpoint("gorse", page.to_vec()).await;
            fleet.restart("gorse").await;
            fleet.wait_until("the role to be released", SOON, |fleet| fleet.has_event(released)).await;
            fleet.assert_completes(&mission).await;
            assert_eq!(fleet.event_log.count(resumed), 0, "seed {seed}\n{}", fleet.event_log_text());
            fleet.assert_sample_delivered(ROOM);
            fleet.assert_exclusive_roles();
        });
    }
}

#[test]
fn a_restarted_robot_is_not_free_until_its_role_is_settled() {
    for_each_seed([331], async |seed| {
        let (mut fleet, mission) = under_way(seed, &[], "navto_room").await;
        fleet.kill("gorse").await;
        // It reaches no node that could answer.
        fleet.cut_off(&["gorse"]);
        fleet.restart("gorse").await;
        let place = fleet.position("gorse");
        let availability = |fleet: &Fleet| {
            let me = slug("gorse");
            fleet.knowledge_of("gorse", &me).map(|worker| worker.availability)
        };
        use consort_protocol::knowledge::Availability;
        let held = Availability::Holding { mission: mission.clone(), role: slug("r1"), suspended: true };
        fleet
            .wait_until("it to report that it holds a role", SOON, |fleet| availability(fleet) == Some(held.clone()))
            .await;
        fleet
            .assert_never("something else", Duration::from_secs(20), |fleet| availability(fleet) != Some(held.clone()))
            .await;
        assert!(
            fleet.position("gorse") == place && !fleet.has_event(resumed),
            "seed {seed}\n{}",
            fleet.event_log_text()
        );
        fleet.heal();
        fleet.assert_completes(&mission).await;
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
    });
}

/// Room of the missions that crashes interrupt.
const NEAR_ROOM: &str = "PC Room 8";

/// Starts a mission of a fast robot. Returns it after `nth` observations since the request; `None` if it had ended before.
async fn under_way_for(seed: u64, nth: usize) -> Option<(Fleet, MissionId)> {
    let room = NEAR_ROOM;
    let robots = vec![RobotSpec::carrier("gorse", room).with_speed(1.5)];
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove", "dill"], &[room]).await;
    fleet.wait_for_coordinator().await;
    let before = fleet.event_log.len();
    let mission = fleet.submit("a", room).await;
    let over = |fleet: &Fleet| fleet.mission_state(&mission).is_some_and(|state| state.is_final());
    fleet
        .wait_until(&format!("{nth} things"), SOON, |fleet| fleet.event_log.len() >= before + nth || over(fleet))
        .await;
    let is_over = over(&fleet);
    (!is_over).then_some((fleet, mission))
}

/// Kills `robot` after `nth` observations since the request and restarts it. Returns false if the
/// mission had ended before.
async fn interrupted(seed: u64, nth: usize, robot: &'static str, away: Duration) -> bool {
    let Some((mut fleet, mission)) = under_way_for(seed, nth).await else { return false };
    fleet.kill(robot).await;
    tokio::time::sleep(away).await;
    fleet.restart(robot).await;
    fleet.assert_completes(&mission).await;
    let context = format!("seed {seed}: {robot} killed after {nth} things\n{}", fleet.event_log_text());
    let tasks = fleet.task_counts(&mission);
    let again = tasks.values().filter(|(began, _)| *began > 1).count();
    assert!(again <= 1 && tasks.values().all(|(began, _)| *began <= 2), "{tasks:?}\n{context}");
    assert!(tasks.values().all(|(_, ended)| *ended == 1), "{tasks:?}\n{context}");
    fleet.assert_sample_delivered(NEAR_ROOM);
    fleet.assert_exclusive_roles();
    true
}

/// Runs a test with a crash after more and more observations, until the mission ends before the
/// crash. Returns the number of crashes.
fn at_any_step(step: usize, seed: impl Fn(u64) -> u64, test: impl AsyncFn(u64, usize, Duration) -> bool) -> usize {
    for (kills, nth) in (0..).step_by(step).enumerate() {
        let (number, went_on) = (nth as u64, Cell::new(true));
        let away = Duration::from_millis(40 + (number * 379) % 3000);
        for_each_seed([seed(number)], async |seed| went_on.set(test(seed, nth, away).await));
        if !went_on.get() {
            return kills;
        }
    }
    unreachable!("every mission ends")
}

#[test]
fn a_carrier_may_crash_at_any_step() {
    let kills =
        at_any_step(3, |nth| 340 + nth % 7, async |seed, nth, away| interrupted(seed, nth, "gorse", away).await);
    assert!(kills > 10, "the mission was over after {kills} kills");
}

#[test]
fn an_arm_may_crash_at_any_step() {
    let kills =
        at_any_step(2, |nth| 350 + nth % 7, async |seed, nth, away| interrupted(seed, nth, "lab-arm", away).await);
    assert!(kills > 15, "the mission was over after {kills} kills");
}

#[test]
fn a_goal_that_ended_during_a_restart_is_not_repeated() {
    // From the moment at which the arm reaches into the drawer until its lease has almost expired.
    for (seed, away_ms) in [(371, 0), (372, 150), (373, 700), (374, 3200)] {
        for_each_seed([seed], async |seed| {
            let (mut fleet, mission) = under_way(seed, &["fern"], "pick_up_sample").await;
            let reaches = |entry: &LoggedEvent| matches!(&entry.event, InWorld::GoalStarted { robot, .. } if *robot == slug("lab-arm"));
            fleet
                .wait_until("the arm to reach into the drawer", SOON, |fleet| fleet.journal().iter().any(reaches))
                .await;
            fleet.kill("lab-arm").await;
            if away_ms > 0 {
                let taken = |fleet: &Fleet| fleet.sample_holder(ROOM) == SampleHolder::Arm(slug("lab-arm"));
                fleet.wait_until("the arm to have the sample", SOON, taken).await;
                tokio::time::sleep(Duration::from_millis(away_ms)).await;
            }
            fleet.restart("lab-arm").await;
            fleet.assert_completes(&mission).await;
            assert_done_once(&fleet, &mission, &["pick_up_sample"]);
            let failed = |what: &EventKind| matches!(what, EventKind::TaskRetried { .. });
            assert!(!fleet.has_event(failed), "seed {seed}\n{}", fleet.event_log_text());
        });
    }
}

/// Kills the world host after `nth` observations since the request and restarts it. Returns false
/// if the mission had ended before.
async fn world_interrupted(seed: u64, nth: usize, away: Duration) -> bool {
    let Some((mut fleet, mission)) = under_way_for(seed, nth).await else { return false };
    fleet.kill("world").await;
    tokio::time::sleep(away).await;
    fleet.start_world().await;
    fleet.assert_completes(&mission).await;
    let context = format!("seed {seed}: the world's node killed after {nth} things\n{}", fleet.event_log_text());
    let tasks = fleet.task_counts(&mission);
    assert!(tasks.values().all(|(_, ended)| (1..=2).contains(ended)), "{tasks:?}\n{context}");
    assert!(!fleet.has_event(released), "{context}");
    fleet.assert_sample_delivered(NEAR_ROOM);
    fleet.assert_exclusive_roles();
    true
}

#[test]
fn the_tasks_of_people_survive_restarts_of_their_node() {
    let kills = at_any_step(4, |nth| 360 + nth % 5, world_interrupted);
    assert!(kills > 8, "the mission was over after {kills} kills");
}
