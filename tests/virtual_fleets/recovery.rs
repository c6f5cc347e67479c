//! If a robot cannot finish a role, another robot takes it where that helps.

use crate::support::task_began;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, TaskId};
use consort_protocol::message::FailureKind;
use consort_skills::actions::RobotBackend;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use consort_world::world::SampleHolder;
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

fn gave_up(kind: FailureKind) -> impl Fn(&EventKind) -> bool {
    move |what| matches!(what, EventKind::GaveUp { kind: of, .. } if *of == kind)
}

fn goes_on(what: &EventKind) -> bool {
    matches!(what, EventKind::LowCharge { .. })
}

/// `gorse` is nearer and wins; `fern` could take the role too.
async fn submitted(seed: u64, gorse: RobotSpec) -> (Fleet, MissionId) {
    let robots = vec![gorse, RobotSpec::carrier("fern", "Dock")];
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[ROOM]).await;
    fleet.wait_for_coordinator().await;
    let mission = fleet.submit("a", ROOM).await;
    fleet.wait_until("an award", SOON, |fleet| fleet.holder(&mission, "r1").is_some()).await;
    assert_eq!(
        fleet.holder(&mission, "r1").expect("held").as_str(),
        "gorse",
        "seed {seed}\n{}",
        fleet.event_log_text()
    );
    (fleet, mission)
}

#[test]
fn a_robot_with_a_fast_draining_battery_returns_its_role() {
    for_each_seed([501, 502, 503], async |seed| {
        let gorse =
            RobotSpec::carrier("gorse", "PC Room 8").with_speed(1.0).with_charge(0.2).with_discharge_factor(8.0);
        let (mut fleet, mission) = submitted(seed, gorse).await;
        fleet.wait_until("gorse to give up", SOON, |fleet| fleet.has_event(gave_up(FailureKind::Battery))).await;
        let body = fleet.world.telemetry(&slug("gorse")).expect("a body");
        assert!(body.able && body.battery.get() > 0.05, "seed {seed}: {body:?}\n{}", fleet.event_log_text());
        fleet.assert_completes(&mission).await;
        assert_eq!(
            fleet.holder(&mission, "r1").expect("held").as_str(),
            "fern",
            "seed {seed}\n{}",
            fleet.event_log_text()
        );
        let body = fleet.world.telemetry(&slug("gorse")).expect("a body");
        assert!(body.able, "seed {seed}: stranded after all\n{}", fleet.event_log_text());
        assert_eq!(
            fleet.event_log.count(gave_up(FailureKind::Battery)),
            1,
            "seed {seed}: once\n{}",
            fleet.event_log_text()
        );
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
    });
}

#[test]
fn a_robot_with_the_sample_continues_on_a_low_battery() {
    for_each_seed([511, 512], async |seed| {
        let gorse = RobotSpec::carrier("gorse", "IC Room 4").with_charge(0.145).with_discharge_factor(1.6);
        let (mut fleet, mission) = submitted(seed, gorse).await;
        fleet.assert_completes(&mission).await;
        let story = format!("seed {seed}\n{}", fleet.event_log_text());
        assert_eq!(fleet.event_log.count(goes_on), 1, "{story}");
        assert_eq!(fleet.event_log.count(gave_up(FailureKind::Battery)), 0, "{story}");
        fleet.assert_each_task_once(&mission);
        fleet.assert_sample_delivered(ROOM);
    });
}

#[test]
fn a_barely_viable_bid_is_not_returned() {
    for_each_seed([521, 522], async |seed| {
        // The remaining charge exceeds the useful charge by less than a thousandth.
        let (mut fleet, mission) = submitted(seed, RobotSpec::carrier("gorse", "IC Room 4").with_charge(0.1365)).await;
        fleet.assert_completes(&mission).await;
        assert_eq!(fleet.holder(&mission, "r1").expect("held").as_str(), "gorse", "seed {seed}");
        let any = |what: &EventKind| goes_on(what) || gave_up(FailureKind::Battery)(what);
        assert_eq!(fleet.event_log.count(any), 0, "seed {seed}\n{}", fleet.event_log_text());
    });
}

#[test]
fn a_robot_without_its_checkpoint_is_replaced_before_custody() {
    for_each_seed([531], async |seed| {
        let (mut fleet, mission) = submitted(seed, RobotSpec::carrier("gorse", "IC Room 4")).await;
        let drives = task_began("navto_room");
        fleet.wait_until("the way to the room", SOON, |fleet| fleet.has_event(&drives)).await;
        fleet.kill("gorse").await;
        fleet.start_robot("gorse").await;
        fleet.assert_completes(&mission).await;
        let released = fleet.event_log.count(|what| matches!(what, EventKind::Released { .. }));
        assert_eq!(released, 1, "seed {seed}\n{}", fleet.event_log_text());
        fleet.assert_sample_delivered(ROOM);
        fleet.assert_exclusive_roles();
    });
}

#[test]
fn a_robot_with_the_sample_but_no_checkpoint_needs_intervention() {
    for_each_seed([541, 542], async |seed| {
        let (mut fleet, mission) = submitted(seed, RobotSpec::carrier("gorse", "IC Room 4")).await;
        let drives = task_began("navto_lab");
        fleet.wait_until("the way to the laboratory", SOON, |fleet| fleet.has_event(&drives)).await;
        fleet.kill("gorse").await;
        fleet.start_robot("gorse").await;
        let story = |fleet: &Fleet| format!("seed {seed}\n{}", fleet.event_log_text());
        fleet
            .wait_until("the need of intervention", SOON, |fleet| {
                fleet.state(&mission).as_deref() == Some("needs_intervention")
            })
            .await;
        assert_eq!(fleet.sample_holder(ROOM), SampleHolder::Drawer(slug("gorse")), "{}", story(&fleet));
        let place = fleet.position("gorse");
        fleet.assert_never("a drive", Duration::from_secs(10), |fleet| fleet.position("gorse") != place).await;
        assert_eq!(fleet.task_counts(&mission)["navto_lab"], (1, 0), "{}", story(&fleet));
    });
}

/// `gorse` drives to a room, or otherwise to another room, and then to the dock.
#[test]
fn an_alternative_is_taken_before_the_role_is_returned() {
    use super::task_failures::{SkillFault, fails_as_listed, set_faults};
    for_each_seed([551, 552], async |seed| {
        set_faults(&[SkillFault::Fails, SkillFault::Crashes]);
        let robots = vec![RobotSpec::carrier("gorse", "IC Room 4").with_library(fails_as_listed)];
        let mut fleet = Fleet::hospital(seed, robots, &["aster"], &[ROOM]).await;
        fleet.wait_for_coordinator().await;
        let drive = |task: &str, to: &str| serde_json::json!({ "task": task, "type": "navigation", "roles": ["r1"], "parameters": { "to": to } });
        let look = serde_json::json!({
            "task": "look", "method": "sequential", "tasks": [drive("navto_room", ROOM)],
            "alternatives": [{ "method": "sequential", "tasks": [drive("navto_other", "PC Room 1"), drive("navto_next", "PC Room 2")] }],
        });
        let root = serde_json::json!({ "task": "patrol", "method": "sequential", "tasks": [look, drive("navto_dock", "Dock")] });
        let mission = serde_json::json!({
            "mission": "patrol", "title": "Look into a room", "roles": { "r1": { "kind": "managed" } }, "root": root,
        });
        let answer = fleet
            .request_answered(
                consort_protocol::keys::ApiCall::Submit,
                &serde_json::json!({ "mission": mission, "request": "a" }),
            )
            .await;
        let mission: MissionId = slug(answer["mission"].as_str().unwrap_or_else(|| panic!("{answer}")));
        fleet.assert_completes(&mission).await;
        let tasks: Vec<_> = fleet.task_counts(&mission).into_iter().collect();
        let expected =
            [("navto_dock", (1, 1)), ("navto_next", (1, 1)), ("navto_other", (1, 1)), ("navto_room", (2, 0))];
        assert_eq!(
            tasks,
            expected.map(|(task, counts)| (task.to_owned(), counts)),
            "seed {seed}\n{}",
            fleet.event_log_text()
        );
        let ways: Vec<(TaskId, Vec<TaskId>)> = fleet
            .events()
            .into_iter()
            .filter_map(|what| match what {
                EventKind::Alternative { task, tasks, .. } => Some((task, tasks)),
                _ => None,
            })
            .collect();
        assert_eq!(ways, [(slug("navto_room"), vec![slug("navto_other"), slug("navto_next")])], "seed {seed}");
        let unwanted = |what: &EventKind| matches!(what, EventKind::TaskFailed { .. } | EventKind::Released { .. });
        assert!(!fleet.has_event(unwanted), "seed {seed}\n{}", fleet.event_log_text());
    });
}
