//! Answers of people to requests, through any node.

use crate::support::{self, answer, escalated, escalated_request, is_for, kill_coordinator_during, task_began};
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::MissionState;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::{Value, json};
use std::time::Duration;

const SEEDS: [u64; 3] = [761, 762, 763];

/// A doctor measures by hand what a robot then uses, and a nurse signs. The simulated world has nurses and no
/// doctor, so the measurement is left to real people.
fn mission(patience_s: u32) -> Value {
    json!({
        "mission": "by-hand",
        "roles": { "doctor": { "kind": "unmanaged" }, "nurse": { "kind": "unmanaged" },
            "r1": { "kind": "managed", "on_loss": "restart" } },
        "root": { "task": "all", "method": "sequential", "tasks": [
            { "task": "come", "type": "navigation", "roles": ["r1"], "parameters": { "to": "Dock" } },
            { "task": "measure", "type": "measure_vital_signs", "roles": ["doctor"], "patience_s": patience_s },
            { "task": "stay", "type": "wait", "roles": ["r1"], "parameters": { "seconds": "${measure.pulse_bpm}" } },
            { "task": "sign", "type": "attend", "roles": ["nurse"], "parameters": { "at": "Dock" } },
        ] },
        "result": { "pulse": "measure.pulse_bpm" },
    })
}

async fn fleet(seed: u64) -> Fleet {
    fleet_with(seed, &["aster", "basil", "clove"]).await
}

async fn fleet_with(seed: u64, stations: &[&str]) -> Fleet {
    let robots = vec![RobotSpec::carrier("amber", "Dock").with_skills(&["navigation", "operate_drawer", "wait"])];
    let mut fleet = Fleet::hospital(seed, robots, stations, &["IC Room 6"]).await;
    fleet.wait_for_coordinator().await;
    fleet
}

async fn submit(fleet: &Fleet, patience_s: u32) -> MissionId {
    let request = json!({ "mission": mission(patience_s), "request": "a" });
    let answer = fleet.request_answered(ApiCall::Submit, &request).await;
    slug(answer["mission"].as_str().unwrap_or_else(|| panic!("{answer}")))
}

async fn open_request(fleet: &Fleet, task: &str) -> Value {
    support::open_request(fleet, task, |request| request["task"] == task).await
}

fn measured(request: &Value, by: &str, pulse: i64) -> Value {
    let results = json!({ "temperature_c": 36.6, "pulse_bpm": pulse, "oxygen_percent": 98 });
    let form = request["form"].as_object().expect("a form");
    let results: Value = form.keys().map(|name| (name.clone(), results[name].clone())).collect();
    json!({ "request": request["request"], "answer": "done", "results": results, "by": by })
}

/// Starts a fleet with a mission that waits for the answer to its measurement. Returns the mission and
/// the request.
async fn asked(seed: u64, patience_s: u32) -> (Fleet, MissionId, Value) {
    let fleet = fleet(seed).await;
    let id = submit(&fleet, patience_s).await;
    let request = open_request(&fleet, "measure").await;
    (fleet, id, request)
}

/// The coordinator dies when it receives the answer. The next coordinator has the request, and the answer
/// counts once.
#[test]
fn the_first_answer_counts_although_the_coordinator_dies() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, id, request) = asked(seed, 3600).await;
        assert_eq!((&request["mission"], &request["role"]), (&json!(id), &json!("doctor")), "seed {seed}: {request}");
        let first = measured(&request, "Nia", 60);
        if kill_coordinator_during(&mut fleet, ApiCall::Answer, &first).await.as_str() == "amber" {
            fleet.start_robot("amber").await;
        }
        let reply = answer(&fleet, &first).await;
        assert_eq!(reply["phase"]["answered"]["by"], "Nia", "seed {seed}: {reply}");
        let reply = answer(&fleet, &measured(&request, "Ria", 99)).await;
        let expected = format!("request {id}.1 is closed; it was answered by Nia: done");
        assert_eq!(reply["error"], expected, "seed {seed}");

        // A simulated nurse signs.
        fleet.assert_completes(&id).await;
        assert_eq!(fleet.task_counts(&id)["sign"].1, 1, "seed {seed}\n{}", fleet.event_log_text());
        let view = fleet.request_answered(ApiCall::Get, &json!({ "mission": id })).await;
        assert_eq!(view["result"]["pulse"], 60, "seed {seed}: {}", view["result"]);
        let stays = fleet.events().into_iter().filter(|kind| task_began("stay")(kind)).count();
        assert_eq!(stays, 1, "seed {seed}\n{}", fleet.event_log_text());
    });
}

#[test]
fn of_two_answers_at_once_one_counts() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, id, request) = asked(seed, 3600).await;
        let answers = [("Nia", 55), ("Ria", 66)].map(|(by, pulse)| measured(&request, by, pulse));
        let (a, b) = tokio::join!(answer(&fleet, &answers[0]), answer(&fleet, &answers[1]));
        let by = |reply: &Value| reply["phase"]["answered"]["by"].as_str().map(str::to_owned);
        let (winner, loser) = match (by(&a), by(&b)) {
            (Some(winner), None) => (winner, b),
            (None, Some(winner)) => (winner, a),
            other => panic!("seed {seed}: {other:?}"),
        };
        let expected = format!("request {id}.1 is closed; it was answered by {winner}: done");
        assert_eq!(loser["error"], expected, "seed {seed}");
        fleet.assert_completes(&id).await;
        let view = fleet.request_answered(ApiCall::Get, &json!({ "mission": id })).await;
        assert_eq!(view["result"]["pulse"], if winner == "Nia" { 55 } else { 66 }, "seed {seed}");
    });
}

#[test]
fn an_answer_that_does_not_fit_changes_nothing() {
    for_each_seed(SEEDS[..1].iter().copied(), async |seed| {
        let (mut fleet, id, request) = asked(seed, 3600).await;
        let with = |field: &str, value: Value| {
            let mut changed = measured(&request, "Nia", 60);
            changed[field] = value;
            changed
        };
        let results = |name: &str, value: Value| {
            let mut results = measured(&request, "Nia", 60)["results"].clone();
            results[name] = value;
            with("results", results)
        };
        for (wrong, expected) in [
            (with("request", json!(format!("{id}.7"))), format!("there is no request {id}.7; see api/requests")),
            (with("request", json!("by-hand-9.1")), "there is no mission by-hand-9".to_owned()),
            (with("request", json!("what")), "\"what\" is not a request to a person".to_owned()),
            (with("results", json!({})), "is missing; it is a".to_owned()),
            (
                results("pulse_bpm", json!("fast")),
                "the result `pulse_bpm` is `fast`, but it must be a whole number".to_owned(),
            ),
            (results("pulse", json!(1)), "the task has no result `pulse`".to_owned()),
            (with("answer", json!("declined")), "`results` belong to the answer `done`".to_owned()),
            (with("minutes", json!(5)), "`minutes` belongs to the answer `later`".to_owned()),
            (with("answer", json!("perhaps")), "perhaps".to_owned()),
        ] {
            let reply = fleet.request_answered(ApiCall::Answer, &wrong).await;
            let error = reply["error"].as_str().unwrap_or_else(|| panic!("{wrong}: {reply}"));
            assert!(error.contains(&expected), "{wrong}: {error}");
        }
        assert_eq!(open_request(&fleet, "measure").await["request"], request["request"]);
        answer(&fleet, &measured(&request, "Nia", 60)).await;
        fleet.assert_completes(&id).await;
    });
}

/// A request without an answer expires, and later if a person has put it off.
#[test]
fn a_request_expires_when_patience_is_over() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, id, request) = asked(seed, 20).await;
        let later = json!({ "request": request["request"], "answer": "later", "minutes": 1, "by": "Nia" });
        let reply = answer(&fleet, &later).await;
        assert_eq!(reply["phase"]["open"]["postponed"]["by"], "Nia", "seed {seed}: {reply}");
        fleet
            .assert_never("an end", Duration::from_secs(60), |fleet| {
                fleet.mission_state(&id).is_some_and(|state| state.is_final())
            })
            .await;
        let MissionState::Failed { cause, .. } = fleet.wait_for_end(&id).await else { panic!("seed {seed}") };
        assert!(cause.starts_with("nobody answered measure within 8"), "seed {seed}: {cause}");
        assert!(cause.ends_with("s as doctor"), "seed {seed}: {cause}");
        let failed =
            |kind: &EventKind| matches!(kind, EventKind::TaskFailed { task, .. } if task.as_str() == "measure");
        assert!(fleet.has_event(failed), "seed {seed}\n{}", fleet.event_log_text());
        let late = fleet.request_answered(ApiCall::Answer, &measured(&request, "Nia", 60)).await;
        assert_eq!(late["error"], format!("request {id}.1 is closed; it was expired"), "seed {seed}");
    });
}

/// "I cannot" ends the mission at once, with the reason.
#[test]
fn a_person_who_cannot_ends_the_mission_with_the_reason() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, id, request) = asked(seed, 3600).await;
        let cannot = json!({ "request": request["request"], "answer": "cannot", "note": "no cuff here", "by": "Nia" });
        answer(&fleet, &cannot).await;
        let MissionState::Failed { cause, .. } = fleet.wait_for_end(&id).await else { panic!("seed {seed}") };
        assert_eq!(cause, "Nia as doctor could not do measure: no cuff here", "seed {seed}");
    });
}

/// Submits a mission that calls a visitor with an alert, which escalates to another role. Returns the mission and
/// the request.
async fn visitor_called(fleet: &Fleet, to: &str, after_s: u64) -> (MissionId, Value) {
    let alert = json!({ "task": "call", "type": "alert", "roles": ["visitor"],
        "parameters": { "message": "a robot is here", "level": "urgent", "at": "Dock" },
        "escalate": { "to": to, "after_s": after_s } });
    let come = json!({ "task": "come", "type": "navigation", "roles": ["r1"], "parameters": { "to": "Dock" } });
    let mission = json!({
        "mission": "visit", "roles": { "visitor": { "kind": "unmanaged" }, "r1": { "kind": "managed" } },
        "root": { "task": "all", "method": "sequential", "tasks": [come, alert] },
    });
    let submitted = json!({ "mission": mission, "by": "Nia", "request": "a" });
    let reply = fleet.request_answered(ApiCall::Submit, &submitted).await;
    let id = slug(reply["mission"].as_str().unwrap_or_else(|| panic!("{reply}")));
    (id, open_request(fleet, "call").await)
}

/// The simulated world has no person in the role, so the request waits for a real person. It names the role
/// of its escalation.
#[test]
fn a_request_for_a_role_that_the_world_lacks_is_left_to_others() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        let (id, request) = visitor_called(&fleet, "porter", 300).await;
        assert_eq!((&request["place"], &request["escalates_to"]), (&json!("Dock"), &json!("porter")), "{request}");
        let asked_ms = request["asked_at_ms"].as_u64().expect("a time");
        assert_eq!(request["escalates_at_ms"], asked_ms + 300_000);
        assert_eq!(request["escalated_at_ms"], Value::Null, "seed {seed}: {request}");
        fleet
            .assert_never("an end", Duration::from_secs(30), |fleet| {
                fleet.mission_state(&id).is_some_and(|state| state.is_final())
            })
            .await;
        answer(&fleet, &json!({ "request": request["request"], "answer": "done", "by": "Ria" })).await;
        fleet.assert_completes(&id).await;
        let view = fleet.request_answered(ApiCall::Get, &json!({ "mission": id })).await;
        assert_eq!(view["by"], "Nia", "seed {seed}: {view}");
    });
}

/// Kills the coordinator. A robot starts again.
async fn replace_coordinator(fleet: &mut Fleet) {
    if fleet.kill_coordinator().await.as_str() == "amber" {
        fleet.start_robot("amber").await;
    }
}

/// Without an answer the porter is asked, too, once and not before the time. He answers.
#[test]
fn a_request_without_an_answer_is_escalated_to_another_role() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        let (id, request) = visitor_called(&fleet, "porter", 60).await;
        assert!(is_for(&request, "visitor") && !is_for(&request, "porter"), "seed {seed}: {request}");
        fleet
            .assert_never("an early escalation", Duration::from_secs(50), |fleet| {
                fleet.has_event(escalated("call", "porter"))
            })
            .await;
        let request = escalated_request(&fleet, "call").await;
        let [due_ms, at_ms] =
            ["escalates_at_ms", "escalated_at_ms"].map(|name| request[name].as_u64().expect("a time"));
        assert!((due_ms..due_ms + 10_000).contains(&at_ms), "seed {seed}: {request}");
        assert!(is_for(&request, "visitor") && is_for(&request, "porter"), "seed {seed}: {request}");
        answer(&fleet, &json!({ "request": request["request"], "answer": "done", "by": "Pia" })).await;
        fleet.assert_completes(&id).await;
        let escalations = fleet.events().into_iter().filter(escalated("call", "porter")).count();
        assert_eq!(escalations, 1, "seed {seed}\n{}", fleet.event_log_text());
    });
}

/// The simulated world has nurses and no visitor: a nurse answers, and not before the escalation.
#[test]
fn simulated_people_answer_a_request_that_was_escalated_to_them() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        let (id, request) = visitor_called(&fleet, "nurse", 60).await;
        fleet
            .assert_never("an early answer", Duration::from_secs(50), |fleet| {
                fleet.mission_state(&id).is_some_and(|state| state.is_final())
            })
            .await;
        fleet.assert_completes(&id).await;
        let escalations = fleet.events().into_iter().filter(escalated("call", "nurse")).count();
        assert_eq!(escalations, 1, "seed {seed}\n{}", fleet.event_log_text());
        let late = json!({ "request": request["request"], "answer": "done", "by": "Ria" });
        let late = fleet.request_answered(ApiCall::Answer, &late).await;
        let expected = format!("request {id}.1 is closed; it was answered by nurse: done");
        assert_eq!(late["error"], expected, "seed {seed}");
    });
}

/// The coordinator dies before the time of the escalation, and the next coordinator escalates; another dies
/// after it, and the mark stays.
#[test]
fn an_escalation_happens_although_coordinators_die() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet_with(seed, &["aster", "basil", "clove", "daisy", "elder"]).await;
        let (id, _) = visitor_called(&fleet, "porter", 60).await;
        replace_coordinator(&mut fleet).await;
        let first = escalated_request(&fleet, "call").await;
        replace_coordinator(&mut fleet).await;
        let again = escalated_request(&fleet, "call").await;
        assert_eq!(again, first, "seed {seed}");
        answer(&fleet, &json!({ "request": first["request"], "answer": "done", "by": "Pia" })).await;
        fleet.assert_completes(&id).await;
    });
}
