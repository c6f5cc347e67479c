//! Requests to people while robots are lost and replaced.

use crate::support::task_began;
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::MissionState;
use consort_skills::actions::RobotBackend;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use consort_world::world::{PersonAction, SampleHolder};
use serde_json::{Value, json};
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const OTHER: &str = "PC Room 2";
const SOON: Duration = Duration::from_secs(60);

async fn submit(fleet: &mut Fleet, mission: Value) -> MissionId {
    let answer = fleet.request_answered(ApiCall::Submit, &json!({ "mission": mission, "request": "a" })).await;
    slug(answer["mission"].as_str().unwrap_or_else(|| panic!("{answer}")))
}

/// She leaves after the robot has met her and stays away for `away_s` of world time. Afterwards
/// either the robot has the sample or the mission has failed.
#[test]
fn a_nurse_who_leaves_and_returns_does_not_fail_the_mission() {
    let nurse = format!("nurse of {ROOM}").as_str().into();
    for (task, away_s, comes_back) in [
        ("authenticate_nurse", 100.0, true),
        ("open_drawer_for_nurse", 100.0, true),
        ("authenticate_nurse", 0.0, false),
    ] {
        for_each_seed([721, 722], async |seed| {
            let mut fleet =
                Fleet::hospital(seed, vec![RobotSpec::carrier("amber", "IC Room 4")], &["post"], &[ROOM]).await;
            let mission = fleet.submit("a", ROOM).await;
            fleet.wait_until("the meeting", SOON, |fleet| fleet.has_event(task_began(task))).await;
            fleet.world.with(|world| world.trigger_person_action(&nurse, PersonAction::WalksAway, None));
            if comes_back {
                // The world runs ten times as fast as the nodes.
                let away = Duration::from_secs_f64(away_s / 10.0);
                fleet
                    .assert_never("an end", away, |fleet| {
                        fleet.mission_state(&mission).is_some_and(|state| state.is_final())
                    })
                    .await;
                fleet.world.with(|world| world.return_person(&nurse));
                fleet.assert_completes(&mission).await;
                fleet.assert_each_task_once(&mission);
            } else {
                let end = fleet.wait_for_end(&mission).await;
                let MissionState::Failed { cause, .. } = &end else { panic!("seed {seed}: {task}: {end:?}") };
                assert!(cause.contains("has walked away; waited for 120 s"), "seed {seed}: {cause}");
            }
        });
    }
}

/// Returns the tasks of meeting a nurse in a room; the task names end with `mark`.
fn meeting(role: &str, room: &str, mark: &str) -> Vec<Value> {
    let task = |name: &str, of: &str, role: &str, parameters: Value| json!({ "task": format!("{name}{mark}"), "type": of, "roles": [role], "parameters": parameters });
    vec![
        task("navto_room", "navigation", role, json!({ "to": room })),
        task("approach", "approach_person", role, json!({ "person_role": "nurse" })),
        task("open", "operate_drawer", role, json!({ "action": "open" })),
        task("deposit", "deposit", "nurse", json!({ "into_role": role })),
        task("close", "operate_drawer", role, json!({ "action": "close" })),
    ]
}

/// `amber` is lost with the sample; `birch` fetches another sample from the nurse of another room.
/// A late answer to the first request changes nothing.
#[test]
fn an_old_request_is_not_answered_in_the_recovery_branch() {
    for_each_seed([711, 712], async |seed| {
        let robots = vec![RobotSpec::carrier("amber", "IC Room 4"), RobotSpec::carrier("birch", "Dock")];
        let stations = ["post-1", "post-2", "post-3"];
        let mut fleet = Fleet::hospital(seed, robots, &stations, &[ROOM, OTHER]).await;
        fleet.wait_for_coordinator().await;
        let mut tasks = meeting("r1", ROOM, "");
        tasks[3]["acquires"] = json!({ "sample": "r1" });
        tasks.push(
            json!({ "task": "navto_lab", "type": "navigation", "roles": ["r1"], "parameters": { "to": "Laboratory" } }),
        );
        let managed = json!({ "kind": "managed" });
        let mission = json!({
            "mission": "another", "roles": { "nurse": { "kind": "unmanaged" }, "r1": managed, "r2": managed },
            "root": { "task": "fetch", "method": "sequential", "tasks": tasks },
            "recovery": { "task": "again", "method": "sequential", "tasks": meeting("r2", OTHER, "-2") },
        });
        let mission = submit(&mut fleet, mission).await;
        fleet.wait_until("the way to the laboratory", SOON, |fleet| fleet.has_event(task_began("navto_lab"))).await;
        fleet.kill("amber").await;
        fleet.wait_until("another way to a room", SOON, |fleet| fleet.has_event(task_began("navto_room-2"))).await;

        let late = json!({ "request": format!("{mission}.1"), "answer": "cannot", "by": "Nia" });
        let reply = fleet.request_answered(ApiCall::Answer, &late).await;
        let expected = format!("request {mission}.1 is closed; it was answered by nurse: done");
        assert_eq!(reply["error"], expected, "seed {seed}");

        let MissionState::NeedsIntervention { cause, .. } = fleet.wait_for_end(&mission).await else {
            panic!("seed {seed}: it ended in another state\n{}", fleet.event_log_text())
        };
        assert!(cause.starts_with("the recovery branch was completed; the sample is with amber"), "{cause}");
        let tasks = fleet.task_counts(&mission);
        let story = format!("seed {seed}: {tasks:?}\n{}", fleet.event_log_text());
        assert_eq!((tasks["deposit"], tasks["deposit-2"], tasks["close-2"]), ((1, 1), (1, 1), (1, 1)), "{story}");
        assert_eq!(fleet.sample_holder(ROOM), SampleHolder::Drawer(slug("amber")), "{story}");
        assert_eq!(fleet.sample_holder(OTHER), SampleHolder::Drawer(slug("birch")), "{story}");
    });
}

/// Returns a mission in which the task of the nurse waits for no signal of a robot, so that she may
/// be asked at once.
fn at_her_leisure(room: &str) -> Value {
    let mut of_robot = meeting("r1", room, "");
    let deposit = of_robot.remove(3);
    // The robot waits there with an open drawer for as long as she needs.
    of_robot[3] = json!({ "task": "stay", "type": "wait", "roles": ["r1"], "parameters": { "seconds": "60" } });
    json!({
        "mission": "leisure", "roles": { "nurse": { "kind": "unmanaged" }, "r1": { "kind": "managed" } },
        "root": { "task": "fetch", "method": "unordered", "tasks": [
            deposit,
            { "task": "come", "method": "sequential", "tasks": of_robot },
        ] },
    })
}

/// No robot can take the role at first. Before the fix she was asked at once without a receiving
/// robot, and the result failed the mission.
#[test]
fn a_nurse_is_asked_to_meet_a_robot_once_there_is_a_holder() {
    for_each_seed([731, 732], async |seed| {
        let robots = vec![RobotSpec::carrier("gorse", "IC Room 4").with_skill("wait")];
        let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[ROOM]).await;
        fleet.wait_for_coordinator().await;
        fleet.kill("gorse").await;
        let mission = submit(&mut fleet, at_her_leisure(ROOM)).await;
        let requested = |fleet: &Fleet| fleet.has_event(task_began("deposit"));
        fleet.assert_never("a request without a robot", Duration::from_secs(10), requested).await;
        assert_eq!(fleet.state(&mission).as_deref(), Some("pending"), "seed {seed}\n{}", fleet.event_log_text());
        fleet.start_robot("gorse").await;
        fleet.wait_until("a request to her", SOON, requested).await;
        fleet
            .wait_until("that gorse has the sample", SOON, |fleet| {
                fleet.sample_holder(ROOM) == SampleHolder::Drawer(slug("gorse"))
            })
            .await;
        let ended = |kind: &EventKind| matches!(kind, EventKind::TaskEnded { task, .. } if task.as_str() == "deposit");
        fleet.wait_until("the end of her task", SOON, |fleet| fleet.has_event(ended)).await;
        let tasks = fleet.task_counts(&mission);
        assert_eq!(tasks["deposit"], (1, 1), "seed {seed}: {tasks:?}\n{}", fleet.event_log_text());
    });
}

/// The nurse answers and measures with results of the declared values, which a robot then uses, and attends
/// for the declared time. The coordinator is killed while she measures.
#[test]
fn a_simulated_nurse_states_results_and_takes_the_declared_time() {
    for_each_seed([751, 752, 753], async |seed| {
        let robots = vec![RobotSpec::carrier("amber", ROOM).with_skill("wait")];
        let mut fleet = Fleet::hospital(seed, robots, &["aster", "basil", "clove"], &[ROOM]).await;
        fleet.wait_for_coordinator().await;
        let nurse = |task: &str, of: &str, parameters: Value| json!({ "task": task, "type": of, "roles": ["nurse"], "parameters": parameters });
        let mission = json!({
            "mission": "by-nurse", "roles": { "nurse": { "kind": "unmanaged" },
                "r1": { "kind": "managed", "on_loss": "restart" } },
            "root": { "task": "all", "method": "sequential", "tasks": [
                nurse("ask", "ask_person", json!({ "message": "may I enter?", "at": ROOM })),
                nurse("measure", "measure_vital_signs", json!({})),
                { "task": "stay", "type": "wait", "roles": ["r1"], "parameters": { "seconds": "${measure.pulse_bpm}" } },
                nurse("look", "attend", json!({ "at": ROOM })),
            ] },
            "result": { "answer": "ask.answer", "pulse": "measure.pulse_bpm" },
        });
        let id = submit(&mut fleet, mission).await;
        fleet.wait_until("the measurement", SOON, |fleet| fleet.has_event(task_began("measure"))).await;
        if fleet.kill_coordinator().await.as_str() == "amber" {
            fleet.start_robot("amber").await;
        }
        fleet.assert_completes(&id).await;
        let view = fleet.request_answered(ApiCall::Get, &json!({ "mission": id })).await;
        let (answer, pulse) = (&view["result"]["answer"], &view["result"]["pulse"]);
        assert!(answer == "yes" || answer == "no", "seed {seed}: {answer}");
        assert!([62, 70, 78, 96].iter().any(|declared| pulse == declared), "seed {seed}: {pulse}");
        let ended = |kind: &EventKind| matches!(kind, EventKind::TaskEnded { task, .. } if task.as_str() == "look");
        let (began, ended) = (fleet.event_log.times(task_began("look")), fleet.event_log.times(ended));
        // The world runs ten times as fast as the nodes, and she takes 30 to 60 s.
        let took_s = (ended[0] - began[0]).as_secs_f64();
        assert!((2.9..7.0).contains(&took_s), "seed {seed}: {took_s} s\n{}", fleet.event_log_text());
    });
}

/// The node of the nurses is killed while a nurse has an open request, and the mission is canceled
/// meanwhile. Before the fix the request was forgotten: she handed her sample to the next robot for
/// the ended mission and had none for the new mission.
#[test]
fn a_request_to_a_nurse_is_canceled_after_a_restart_of_its_node() {
    for_each_seed([741, 742], async |seed| {
        let robots = vec![RobotSpec::carrier("amber", "IC Room 4").with_skill("wait")];
        let mut fleet = Fleet::hospital(seed, robots, &["post-1", "post-2", "post-3"], &[ROOM]).await;
        fleet.wait_for_coordinator().await;
        let mission = submit(&mut fleet, at_her_leisure(ROOM)).await;
        fleet.wait_until("a request to her", SOON, |fleet| fleet.has_event(task_began("deposit"))).await;
        let open_requests = |fleet: &Fleet| fleet.world.with(|world| world.open_person_requests());
        fleet.wait_until("her open request", SOON, move |fleet| !open_requests(fleet).is_empty()).await;
        fleet.kill("world").await;
        let answer = fleet.request_answered(ApiCall::Cancel, &json!({ "mission": mission, "by": "a nurse" })).await;
        assert_eq!(answer["state"]["canceled"]["by"], "a nurse", "seed {seed}: {answer}");
        assert_eq!(open_requests(&fleet).len(), 1, "seed {seed}: the request is still open");
        fleet.start_world().await;
        fleet
            .wait_until("the end of the request", Duration::from_secs(10), move |fleet| open_requests(fleet).is_empty())
            .await;

        let next = fleet.submit("b", ROOM).await;
        fleet.assert_completes(&next).await;
        assert_eq!(fleet.task_counts(&next)["deposit"], (1, 1), "seed {seed}\n{}", fleet.event_log_text());
    });
}
