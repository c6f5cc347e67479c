//! A robot is lost with the sample in its drawer.

use crate::support::task_began;
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::lease::EndReason;
use consort_protocol::ledger::MissionState;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::json;
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);
const SKILLS: [&str; 6] =
    ["navigation", "approach_person", "authenticate_person", "operate_drawer", "approach_robot", "wait"];

/// Kills `amber` while it drives to the laboratory with the sample.
async fn lost_on_its_way(seed: u64, kind: &str) -> (Fleet, MissionId) {
    let robots = vec![
        RobotSpec::carrier("amber", "IC Room 4").with_skills(&SKILLS),
        RobotSpec::carrier("birch", "Dock").with_skills(&SKILLS),
    ];
    let mut fleet = Fleet::hospital(seed, robots, &["post-1", "post-2", "post-3", "post-4"], &[ROOM]).await;
    fleet.wait_for_coordinator().await;
    let request = json!({ "mission": kind, "parameters": { "room": ROOM }, "request": "a" });
    let mission =
        slug(fleet.request_answered(ApiCall::Submit, &request).await["mission"].as_str().expect("acknowledged"));
    fleet.wait_until("the way to the laboratory", SOON, |fleet| fleet.has_event(task_began("navto_lab"))).await;
    fleet.kill("amber").await;
    (fleet, mission)
}

/// Returns the number of samples in the drawer of `amber`.
fn samples_in_drawer(fleet: &Fleet) -> Option<usize> {
    fleet.world.with(|world| world.robot_report(&slug("amber")).map(|it| it.in_drawer.len()))
}

#[test]
fn a_recovery_branch_sends_another_robot_to_the_sample() {
    for_each_seed([601, 602], async |seed| {
        let (mut fleet, mission) = lost_on_its_way(seed, "lab-samples-watched").await;
        fleet.wait_until("a robot to stand by", SOON, |fleet| fleet.has_event(task_began("stand_by"))).await;
        assert_eq!(fleet.holder(&mission, "watch").expect("held").as_str(), "birch", "seed {seed}");
        let (x, y) = (fleet.position("amber"), fleet.position("birch"));
        let apart = ((x.0 - y.0).powi(2) + (x.1 - y.1).powi(2)).sqrt();
        assert!(apart < 30.0, "seed {seed}: {apart} m apart\n{}", fleet.event_log_text());
        let replaced = |what: &EventKind| matches!(what, EventKind::Halted { reason: EndReason::Replaced, .. });
        assert_eq!(fleet.event_log.count(replaced), 1, "seed {seed}: the arm\n{}", fleet.event_log_text());

        let MissionState::NeedsIntervention { cause, items, .. } = fleet.wait_for_end(&mission).await else {
            panic!("seed {seed}: it ended in another state\n{}", fleet.event_log_text())
        };
        assert!(cause.starts_with("the recovery branch was completed; the sample is with amber at "), "{cause}");
        let kept: Vec<_> = items.iter().map(|kept| (kept.robot.as_str(), kept.certain)).collect();
        assert_eq!(kept, [("amber", true)], "seed {seed}");
        let views = fleet.view(&format!("mission/{mission}")).await;
        let view = &views[&format!("mission/{mission}")];
        assert_eq!((&view["branch"], &view["released"]), (&json!("recovery"), &json!(1)), "seed {seed}: {view}");
        assert_eq!(view["items"][0]["robot"], "amber", "seed {seed}: {view}");
        fleet.assert_exclusive_roles();
    });
}

#[test]
fn only_a_person_resolves_a_mission_that_needs_intervention() {
    for_each_seed([611, 612], async |seed| {
        let (mut fleet, mission) = lost_on_its_way(seed, "lab-samples").await;
        let MissionState::NeedsIntervention { cause, items, .. } = fleet.wait_for_end(&mission).await else {
            panic!("seed {seed}: it ended in another state\n{}", fleet.event_log_text())
        };
        assert!(
            cause.starts_with("amber was lost as r1 and has the sample: amber silent for "),
            "seed {seed}: {cause}"
        );
        assert_eq!(items.len(), 1, "seed {seed}: {items:?}");
        assert!(items[0].certain && items[0].place.is_some(), "seed {seed}: {items:?}");
        let halted = |what: &EventKind| matches!(what, EventKind::Halted { reason: EndReason::NeedsIntervention, .. });
        fleet.wait_until("the arm to halt its role", SOON, |fleet| fleet.has_event(halted)).await;

        // The state survives a takeover. The robot receives no role after its restart until a
        // person has resolved the mission.
        fleet.kill("lab-arm").await;
        fleet.wait_for_coordinator().await;
        fleet.start_robot("lab-arm").await;
        fleet.start_robot("amber").await;
        fleet.kill("birch").await;
        let next = fleet.submit("b", ROOM).await;
        let why = |fleet: &Fleet| {
            let intervention = |what| match what {
                EventKind::Closed { mission, record } if mission == next => serde_json::to_string(&record).ok(),
                _ => None,
            };
            fleet.events().into_iter().filter_map(intervention).next_back().unwrap_or_default()
        };
        fleet.wait_until("amber to be refused", SOON, |fleet| why(fleet).contains("carries_item")).await;
        assert_eq!(samples_in_drawer(&fleet), Some(1), "seed {seed}");
        let answer = fleet.request_answered(ApiCall::Resolve, &json!({ "mission": mission, "by": "Nia" })).await;
        let cause = format!("{cause}; resolved by Nia");
        assert_eq!(answer["state"], json!({ "failed": { "cause": cause, "class": "robot" } }), "seed {seed}");
        // Otherwise its drawer would be full in the next mission.
        assert_eq!(samples_in_drawer(&fleet), Some(0), "seed {seed}");
        fleet.wait_until("amber to be given work", SOON, |fleet| fleet.holder(&next, "r1").is_some()).await;
        // A repeated request is acknowledged again; a request of another person comes too late.
        let answer = fleet.request_answered(ApiCall::Resolve, &json!({ "mission": mission, "by": "Nia" })).await;
        assert_eq!(answer["state"], json!({ "failed": { "cause": cause, "class": "robot" } }), "seed {seed}");
        let answer = fleet.request_answered(ApiCall::Resolve, &json!({ "mission": mission, "by": "Tom" })).await;
        let error = answer["error"].as_str().expect("an error");
        assert!(
            error.contains("is failed; only a mission that needs intervention can be resolved"),
            "seed {seed}: {error}"
        );
    });
}

/// The mission is resolved while the host of the simulated robots is unreachable, and its coordinator is lost then.
#[test]
fn the_robots_of_a_resolved_mission_are_emptied_once_their_host_is_back() {
    for_each_seed([621, 622], async |seed| {
        let (mut fleet, mission) = lost_on_its_way(seed, "lab-samples").await;
        fleet.wait_for_end(&mission).await;
        fleet.cut_off(&["world"]);
        let resolve = json!({ "mission": mission, "by": "Nia" });
        let answer = fleet.request_answered(ApiCall::Resolve, &resolve).await;
        assert_eq!(answer["state"]["failed"]["class"], "robot", "seed {seed}: {answer}");
        fleet.kill_coordinator().await;
        fleet.wait_for_coordinator().await;
        tokio::time::sleep(Duration::from_secs(20)).await; // virtual time
        assert_eq!(samples_in_drawer(&fleet), Some(1), "seed {seed}: nobody can reach it");
        fleet.heal();
        fleet.wait_until("the drawer to be emptied", SOON, |fleet| samples_in_drawer(fleet) == Some(0)).await;
    });
}
