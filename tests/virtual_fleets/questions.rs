//! Questions of robots to people, in the middle of a task.

use crate::support::{answer, escalated_request, is_for, kill_coordinator_during, open_request, person_requests};
use consort_protocol::ensemble::EnsembleSpec;
use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_skills::domain_file::DomainFile;
use consort_tests::{DomainSetup, Fleet, RobotSpec, for_each_seed, slug};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

const SEEDS: [u64; 3] = [971, 972, 973];
const SOON: Duration = Duration::from_secs(60);
const DOMAIN: &str = r#"{
    "domain": "visits",
    "tasks": { "visit": {
        "parameters": {
            "ask": { "type": "text" },
            "patience_s": { "type": "integer" },
            "other": { "type": "text", "optional": true },
            "other_after_s": { "type": "integer", "optional": true }
        },
        "results": { "answer": { "type": "text" } },
        "tree": "visit.xml",
        "estimate": { "time_s": "5.0" }
    } }
}"#;

/// The robot asks twice. Without an answer to the first question, it says so, and does not ask again.
const TREE: &str = r#"<root BTCPP_format="4" main_tree_to_execute="visit">
  <BehaviorTree ID="visit">
    <Fallback>
      <Sequence>
        <AskPerson role="{ask}" message="may I enter?" at="Dock" patience_s="{patience_s}"
                   escalate_to="{other}" escalate_after_s="{other_after_s}" answer="{first}"/>
        <AskPerson role="nurse" message="which bed?" answer="{answer}"/>
      </Sequence>
      <Script code="answer := 'nobody'"/>
    </Fallback>
  </BehaviorTree>
</root>"#;

/// Starts a fleet with a robot that visits and no simulated nurse, and submits a visit.
async fn visit(seed: u64, patience_s: u32, closed: bool) -> (Fleet, MissionId) {
    visit_with(&[], seed, json!({ "ask": "nurse", "patience_s": patience_s.to_string() }), closed).await
}

/// Starts such a visit whose first question escalates to another role after 60 s.
async fn escalating_visit(rooms: &'static [&'static str], seed: u64, ask: &str, other: &str) -> (Fleet, MissionId) {
    let parameters = json!({ "ask": ask, "patience_s": "3600", "other": other, "other_after_s": "60" });
    visit_with(rooms, seed, parameters, false).await
}

/// Starts a visit in a fleet with a simulated nurse in each of the rooms.
async fn visit_with(rooms: &'static [&'static str], seed: u64, parameters: Value, closed: bool) -> (Fleet, MissionId) {
    let trees = BTreeMap::from([("visit.xml".to_owned(), TREE.to_owned())]);
    let domain = DomainFile::check(serde_json::from_str(DOMAIN).expect("a domain"), &trees, &[]);
    let robots = vec!["member.robot".to_owned()];
    let hospital =
        EnsembleSpec { membership: robots, ..EnsembleSpec::with_any_skill_of(slug("hospital"), BTreeSet::new()) };
    let setup = DomainSetup { domain: domain.expect("a valid domain"), ensembles: vec![hospital], rooms, closed };
    let robots = vec![RobotSpec::carrier("amber", "Dock").with_skills(&["navigation", "visit"])];
    let mut fleet = Fleet::hospital_of_domain_setup(seed, robots, &["aster", "basil", "clove"], setup).await;
    fleet.wait_for_coordinator().await;
    let mission = json!({
        "mission": "visit", "roles": { "r1": { "kind": "managed", "on_loss": "restart" } },
        "root": { "task": "see", "type": "visit", "roles": ["r1"], "parameters": parameters },
        "result": { "answer": "see.answer" },
    });
    let reply = fleet.request_answered(ApiCall::Submit, &json!({ "mission": mission, "request": "a" })).await;
    let id = slug(reply["mission"].as_str().unwrap_or_else(|| panic!("{reply}")));
    (fleet, id)
}

/// Waits for the open request with this message.
async fn question(fleet: &Fleet, message: &str) -> Value {
    open_request(fleet, message, |request| request["parameters"]["message"] == message).await
}

fn done(request: &Value, text: &str) -> Value {
    json!({ "request": request["request"], "answer": "done", "results": { "answer": text }, "by": "Nia" })
}

async fn result(fleet: &Fleet, mission: &MissionId) -> Value {
    fleet.request_answered(ApiCall::Get, &json!({ "mission": mission })).await["result"]["answer"].clone()
}

/// The coordinator dies when it receives the first answer, and the node of the robot while the second
/// question is open. No question is asked twice.
#[test]
fn the_answer_reaches_the_robot_although_the_coordinator_and_the_node_of_the_robot_die() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, id) = visit(seed, 3600, seed == SEEDS[0]).await;
        let asked = question(&fleet, "may I enter?").await;
        let shown = (&asked["task_type"], &asked["role"], &asked["place"], &asked["robots"]["r1"]);
        assert_eq!(shown, (&json!("ask_person"), &json!("nurse"), &json!("Dock"), &json!("amber")), "seed {seed}");
        assert_eq!(asked["form"], json!({ "answer": "text" }), "seed {seed}");
        let first = done(&asked, "yes");
        if kill_coordinator_during(&mut fleet, ApiCall::Answer, &first).await.as_str() == "amber" {
            fleet.restart("amber").await;
        }
        let reply = answer(&fleet, &first).await;
        let by = reply["phase"]["answered"]["by"].as_str().unwrap_or_default().to_owned();
        assert!(by.starts_with("Nia"), "seed {seed}: {reply}");
        let asked = question(&fleet, "which bed?").await;
        fleet.kill("amber").await;
        fleet.restart("amber").await;
        answer(&fleet, &done(&asked, "the first")).await;
        fleet.assert_completes(&id).await;
        assert_eq!(result(&fleet, &id).await, "the first", "seed {seed}");
        let asked: Vec<_> = person_requests(&fleet).await.iter().map(|asked| asked["phase"].clone()).collect();
        assert_eq!(asked.len(), 2, "seed {seed}: {asked:?}");
    });
}

#[test]
fn without_an_answer_the_tree_decides_how_to_go_on() {
    for_each_seed(SEEDS, async |seed| {
        for (patience_s, kind) in [(3600, "declined"), (3600, "cannot"), (5, "")] {
            let (mut fleet, id) = visit(seed, patience_s, false).await;
            let asked = question(&fleet, "may I enter?").await;
            if !kind.is_empty() {
                answer(&fleet, &json!({ "request": asked["request"], "answer": kind, "by": "Nia" })).await;
            }
            fleet.assert_completes(&id).await;
            assert_eq!(result(&fleet, &id).await, "nobody", "seed {seed}: {kind}");
            let cause = if kind.is_empty() { "expired".to_owned() } else { format!("answered by Nia: {kind}") };
            let closed = |what: &EventKind| matches!(what, EventKind::QuestionClosed { cause: of, .. } if *of == cause);
            assert!(fleet.has_event(closed), "seed {seed}: {kind}\n{}", fleet.event_log_text());
            let late = fleet.request_answered(ApiCall::Answer, &done(&asked, "come in")).await;
            let error = late["error"].as_str().unwrap_or_default().to_owned();
            assert!(error.contains("is closed"), "seed {seed}: {late}");
        }
    });
}

#[test]
fn a_simulated_nurse_answers_the_questions_of_a_robot() {
    for_each_seed(SEEDS, async |seed| {
        let parameters = json!({ "ask": "nurse", "patience_s": "3600" });
        let (mut fleet, id) = visit_with(&["IC Room 6"], seed, parameters, seed == SEEDS[0]).await;
        fleet.assert_completes(&id).await;
        let given = result(&fleet, &id).await;
        assert!(given == "yes" || given == "no", "seed {seed}: {given}");
        let by: Vec<_> =
            person_requests(&fleet).await.iter().map(|asked| asked["phase"]["answered"]["by"].clone()).collect();
        assert_eq!(by, ["nurse", "nurse"], "seed {seed}");
    });
}

/// The robot is lost. Its successor asks anew.
#[test]
fn the_question_of_a_lost_robot_and_of_a_canceled_mission_is_withdrawn() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, id) = visit(seed, 3600, false).await;
        let first = question(&fleet, "may I enter?").await;
        fleet.kill("amber").await;
        let withdrawn = async |fleet: &Fleet| {
            let requests = person_requests(fleet).await;
            let all = requests.iter().all(|request| request["phase"].get("withdrawn").is_some());
            (all && !requests.is_empty()).then_some(())
        };
        fleet.poll_until("a withdrawn request", SOON, withdrawn).await;
        fleet.start_robot("amber").await;
        let second = question(&fleet, "may I enter?").await;
        assert_ne!(first["request"], second["request"], "seed {seed}");
        fleet.request_answered(ApiCall::Cancel, &json!({ "mission": id, "by": "Nia" })).await;
        fleet.poll_until("a withdrawn request", SOON, withdrawn).await;
        fleet.wait_for_end(&id).await;
    });
}

/// The coordinator dies before the escalation, and the node of the robot after it. The porter
/// answers; the nurse is late.
#[test]
fn an_escalated_question_is_answered_although_nodes_die() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, id) = escalating_visit(&[], seed, "nurse", "porter").await;
        let asked = question(&fleet, "may I enter?").await;
        assert!(is_for(&asked, "nurse") && !is_for(&asked, "porter"), "seed {seed}: {asked}");
        assert_eq!(asked["escalates_to"], "porter", "seed {seed}: {asked}");
        if fleet.kill_coordinator().await.as_str() == "amber" {
            fleet.restart("amber").await;
        }
        let first = escalated_request(&fleet, "see").await;
        let [due_ms, at_ms] = ["escalates_at_ms", "escalated_at_ms"].map(|name| first[name].as_u64().expect("a time"));
        assert!(at_ms >= due_ms, "seed {seed}: {first}");
        assert!(is_for(&first, "nurse") && is_for(&first, "porter"), "seed {seed}: {first}");
        fleet.kill("amber").await;
        fleet.restart("amber").await;
        assert_eq!(escalated_request(&fleet, "see").await, first, "seed {seed}");
        answer(
            &fleet,
            &json!({ "request": first["request"], "answer": "done", "results": { "answer": "yes" }, "by": "Pia" }),
        )
        .await;
        let late = fleet.request_answered(ApiCall::Answer, &done(&first, "no")).await;
        let expected = format!("request {id}.1 is closed; it was answered by Pia: done");
        assert_eq!(late["error"], expected, "seed {seed}");
        answer(&fleet, &done(&question(&fleet, "which bed?").await, "the first")).await;
        fleet.assert_completes(&id).await;
        assert_eq!(result(&fleet, &id).await, "the first", "seed {seed}");
        assert_eq!(person_requests(&fleet).await.len(), 2, "seed {seed}: a question was asked twice");
    });
}

/// The tree decides how to go on, whichever role has answered.
#[test]
fn people_to_whom_a_question_was_escalated_may_decline_it() {
    for_each_seed(SEEDS, async |seed| {
        for kind in ["declined", "cannot"] {
            let (mut fleet, id) = escalating_visit(&[], seed, "nurse", "porter").await;
            let asked = escalated_request(&fleet, "see").await;
            answer(&fleet, &json!({ "request": asked["request"], "answer": kind, "by": "Pia" })).await;
            fleet.assert_completes(&id).await;
            assert_eq!(result(&fleet, &id).await, "nobody", "seed {seed}: {kind}");
        }
    });
}

/// The simulated world has a nurse and no visitor: she answers, and not before the escalation.
#[test]
fn a_simulated_nurse_answers_a_question_that_was_escalated_to_her() {
    for_each_seed(SEEDS, async |seed| {
        let (mut fleet, id) = escalating_visit(&["IC Room 6"], seed, "visitor", "nurse").await;
        fleet.assert_completes(&id).await;
        let requests = person_requests(&fleet).await;
        let asked = requests.iter().find(|asked| asked["role"] == "visitor").expect("the escalated question");
        let [escalated_ms, answered_ms] =
            [&asked["escalated_at_ms"], &asked["phase"]["answered"]["at_ms"]].map(|at| at.as_u64().expect("a time"));
        assert!(answered_ms >= escalated_ms, "seed {seed}: {asked}");
        assert_eq!(asked["phase"]["answered"]["by"], "nurse", "seed {seed}: {asked}");
        let names = fleet.events().into_iter().map(|kind| kind.as_str());
        let of_questions: Vec<&str> =
            names.filter(|name| name.starts_with("question") || *name == "escalated").collect();
        let expected = ["question_asked", "escalated", "question_answered", "question_asked", "question_answered"];
        assert_eq!(of_questions, expected, "seed {seed}\n{}", fleet.event_log_text());
    });
}
