//! What a robot cannot carry to its end another one does, where that helps.

use crate::usual::began;
use consort_protocol::event::Happening;
use consort_protocol::ids::{MissionId, TaskId};
use consort_protocol::message::FailureKind;
use consort_sim::world::Keeper;
use consort_skills::actions::BodyHost;
use consort_tests::{Fleet, Member, slug, tell};
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

fn gave_up(kind: FailureKind) -> impl Fn(&Happening) -> bool {
    move |what| matches!(what, Happening::GaveUp { kind: of, .. } if *of == kind)
}

fn goes_on(what: &Happening) -> bool {
    matches!(what, Happening::ChargeShort { .. })
}

/// `gorse` is nearer and wins; `fern` could do it, too.
async fn submitted(seed: u64, gorse: Member) -> (Fleet, MissionId) {
    let robots = vec![gorse, Member::carrier("fern", "Dock")];
    let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[ROOM]).await;
    fleet.coordinator().await;
    let mission = fleet.submit("a", ROOM).await;
    fleet.until("an award", SOON, |fleet| fleet.holder(&mission, "r1").is_some()).await;
    assert_eq!(fleet.holder(&mission, "r1").expect("held").as_str(), "gorse", "seed {seed}\n{}", fleet.tale());
    (fleet, mission)
}

#[test]
fn a_battery_that_drains_faster_than_forecast_gives_the_role_back_before_it_is_empty() {
    tell([501, 502, 503], async |seed| {
        let gorse = Member::carrier("gorse", "PC Room 8").at_speed(1.0).charged(0.2).thirsty(8.0);
        let (mut fleet, mission) = submitted(seed, gorse).await;
        fleet.until("gorse to give up", SOON, |fleet| fleet.happened(gave_up(FailureKind::Battery))).await;
        let body = fleet.world.telemetry(&slug("gorse")).expect("a body");
        assert!(body.able && body.battery.get() > 0.05, "seed {seed}: {body:?}\n{}", fleet.tale());
        fleet.completes(&mission).await;
        assert_eq!(fleet.holder(&mission, "r1").expect("held").as_str(), "fern", "seed {seed}\n{}", fleet.tale());
        let body = fleet.world.telemetry(&slug("gorse")).expect("a body");
        assert!(body.able, "seed {seed}: stranded after all\n{}", fleet.tale());
        assert_eq!(fleet.chronicle.count(gave_up(FailureKind::Battery)), 1, "seed {seed}: once\n{}", fleet.tale());
        fleet.sample_delivered(ROOM);
        fleet.one_role_one_robot();
    });
}

#[test]
fn a_robot_that_carries_the_sample_goes_on_although_its_battery_falls_short() {
    tell([511, 512], async |seed| {
        let gorse = Member::carrier("gorse", "IC Room 4").charged(0.145).thirsty(1.6);
        let (mut fleet, mission) = submitted(seed, gorse).await;
        fleet.completes(&mission).await;
        let story = format!("seed {seed}\n{}", fleet.tale());
        assert_eq!(fleet.chronicle.count(goes_on), 1, "{story}");
        assert_eq!(fleet.chronicle.count(gave_up(FailureKind::Battery)), 0, "{story}");
        fleet.each_task_once(&mission);
        fleet.sample_delivered(ROOM);
    });
}

#[test]
fn a_bid_that_was_only_just_taken_is_not_given_back() {
    tell([521, 522], async |seed| {
        // What is left is more than the useful charge by less than a thousandth.
        let (mut fleet, mission) = submitted(seed, Member::carrier("gorse", "IC Room 4").charged(0.1365)).await;
        fleet.completes(&mission).await;
        assert_eq!(fleet.holder(&mission, "r1").expect("held").as_str(), "gorse", "seed {seed}");
        let any = |what: &Happening| goes_on(what) || gave_up(FailureKind::Battery)(what);
        assert_eq!(fleet.chronicle.count(any), 0, "seed {seed}\n{}", fleet.tale());
    });
}

#[test]
fn a_robot_that_came_back_having_forgotten_its_role_is_replaced_before_custody() {
    tell([531], async |seed| {
        let (mut fleet, mission) = submitted(seed, Member::carrier("gorse", "IC Room 4")).await;
        let drives = began("navto_room");
        fleet.until("the way to the room", SOON, |fleet| fleet.happened(&drives)).await;
        fleet.kill("gorse").await;
        fleet.start_robot("gorse").await;
        fleet.completes(&mission).await;
        let released = fleet.chronicle.count(|what| matches!(what, Happening::Released { .. }));
        assert_eq!(released, 1, "seed {seed}\n{}", fleet.tale());
        fleet.sample_delivered(ROOM);
        fleet.one_role_one_robot();
    });
}

#[test]
fn a_robot_that_came_back_having_forgotten_that_it_carries_the_sample_needs_rescue() {
    tell([541, 542], async |seed| {
        let (mut fleet, mission) = submitted(seed, Member::carrier("gorse", "IC Room 4")).await;
        let drives = began("navto_lab");
        fleet.until("the way to the laboratory", SOON, |fleet| fleet.happened(&drives)).await;
        fleet.kill("gorse").await;
        fleet.start_robot("gorse").await;
        let story = |fleet: &Fleet| format!("seed {seed}\n{}", fleet.tale());
        fleet.until("a call for rescue", SOON, |fleet| fleet.state(&mission).as_deref() == Some("needs_rescue")).await;
        assert_eq!(fleet.keeper(ROOM), Keeper::Drawer(slug("gorse")), "{}", story(&fleet));
        let place = fleet.position("gorse");
        fleet.never("a drive", Duration::from_secs(10), |fleet| fleet.position("gorse") != place).await;
        assert_eq!(fleet.tasks(&mission)["navto_lab"], (1, 0), "{}", story(&fleet));
    });
}

/// `gorse` is to go to a room, or else to another, and then to the dock.
#[test]
fn where_a_mission_gives_another_way_it_is_taken_before_anybody_is_asked_for_help() {
    use super::setbacks::{Mishap, mishaps, stumbles};
    tell([551, 552], async |seed| {
        mishaps(&[Mishap::Fails, Mishap::Crashes]);
        let robots = vec![Member::carrier("gorse", "IC Room 4").trained(stumbles)];
        let mut fleet = Fleet::hospital(seed, robots, &["aster"], &[ROOM]).await;
        fleet.coordinator().await;
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
            .answer(consort_protocol::keys::ApiCall::Submit, &serde_json::json!({ "mission": mission, "request": "a" }))
            .await;
        let mission: MissionId = slug(answer["mission"].as_str().unwrap_or_else(|| panic!("{answer}")));
        fleet.completes(&mission).await;
        let tasks: Vec<_> = fleet.tasks(&mission).into_iter().collect();
        let expected =
            [("navto_dock", (1, 1)), ("navto_next", (1, 1)), ("navto_other", (1, 1)), ("navto_room", (2, 0))];
        assert_eq!(tasks, expected.map(|(task, counts)| (task.to_owned(), counts)), "seed {seed}\n{}", fleet.tale());
        let ways: Vec<(TaskId, Vec<TaskId>)> = fleet
            .happenings()
            .into_iter()
            .filter_map(|what| match what {
                Happening::Alternative { task, tasks, .. } => Some((task, tasks)),
                _ => None,
            })
            .collect();
        assert_eq!(ways, [(slug("navto_room"), vec![slug("navto_other"), slug("navto_next")])], "seed {seed}");
        let unwanted = |what: &Happening| matches!(what, Happening::TaskFailed { .. } | Happening::Released { .. });
        assert!(!fleet.happened(unwanted), "seed {seed}\n{}", fleet.tale());
    });
}
