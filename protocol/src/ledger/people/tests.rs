use super::*;
use crate::auction::{AuctionId, AuctionRecord};
use crate::ids::{RequestId, TaskType};
use crate::ledger::{Command, Submission};
use crate::mission::{Method, Mission, Role, TaskBody, TaskNode, TaskOrder};
use crate::plan::{Division, LocalPlan, Step, StepAction};

const ASKED_MS: u64 = 1_000_000;
/// Award of role `r1`.
const AWARD: Epoch = Epoch { term: 1, index: 2 };

fn role(name: &str) -> RoleId {
    RoleId::new(name).unwrap()
}

fn apply(ledger: &mut Ledger, command: Command) -> CommandOutcome {
    ledger.apply(Epoch { term: 1, index: 1 }, command)
}

/// Escalation to the head after 30 s.
fn escalation() -> Option<Box<Escalation>> {
    Some(Box::new(Escalation { to: role("head"), after_s: 30 }))
}

/// A mission in which a clerk signs and a robot waits.
fn submitted() -> (Ledger, MissionId) {
    let task = |name: &str, of: &str, escalation| {
        let spec = TaskSpec::of(TaskType::new(name).unwrap(), vec![role(of)]);
        (TaskId::new(name).unwrap(), TaskSpec { escalation, ..spec })
    };
    let tasks = [task("sign", "clerk", escalation()), task("wait", "r1", None)];
    let root = TaskBody::Abstract(Method::of(TaskOrder::Sequential, vec![1, 2]));
    let nodes = tasks.iter().map(|(id, spec)| (id.clone(), TaskBody::Elementary(spec.clone())));
    let nodes = std::iter::once((TaskId::new("root").unwrap(), root)).chain(nodes);
    let kinds = [("clerk", RoleKind::Unmanaged), ("r1", RoleKind::Managed)];
    let mission = Mission {
        name: TaskId::new("permit").unwrap(),
        roles: kinds.into_iter().map(|(name, kind)| (role(name), Role::of(kind))).collect(),
        ensembles: vec![],
        energy_max: None,
        tasks: nodes.map(|(id, body)| TaskNode { id, body }).collect(),
        results: BTreeMap::new(),
    };
    let plans = tasks.into_iter().map(|(id, spec)| {
        let of = spec.roles[0].clone();
        (of.clone(), LocalPlan::of(of, vec![Step { action: StepAction::Task { id, spec }, after: vec![] }]))
    });
    let division = Division { plans: plans.collect() };
    let mut ledger = Ledger::default();
    let submission = Submission::of(RequestId::new("a").unwrap(), mission, division);
    apply(&mut ledger, Command::Submit(Box::new(submission)));
    let mission = ledger.missions().next().unwrap().id.clone();
    (ledger, mission)
}

/// The clerk has been asked to sign.
fn with_task() -> (Ledger, PersonRequestId) {
    let (mut ledger, mission) = submitted();
    let (branch, role) = (Branch::Main, role("clerk"));
    apply(&mut ledger, Command::AskPerson { mission: mission.clone(), branch, role, step: 0, asked_ms: ASKED_MS });
    (ledger, PersonRequestId { mission, number: 1 })
}

/// The robot that waits has asked the clerk a question.
fn with_question() -> (Ledger, PersonRequestId) {
    let (mut ledger, mission) = submitted();
    let auction = AuctionRecord::empty(AuctionId { mission: mission.clone(), term: 1, round: 1 });
    let holders = BTreeMap::from([(role("r1"), RobotId::new("amber").unwrap())]);
    let award = Command::Award { mission: mission.clone(), branch: Branch::Main, holders, auction };
    assert_eq!(ledger.apply(AWARD, award), CommandOutcome::Awarded { epoch: AWARD });
    report(&mut ledger, &mission, true, ASKED_MS);
    (ledger, PersonRequestId { mission, number: 1 })
}

/// The same request of a task and of a question.
fn requests() -> [(Ledger, PersonRequestId); 2] {
    [with_task(), with_question()]
}

/// The robot reports its question, or that it no longer asks.
fn report(ledger: &mut Ledger, mission: &MissionId, is_open: bool, asked_ms: u64) {
    let (to, message) = (role("clerk"), "may I enter?".to_owned());
    let question = PersonQuestion { to, message, at: None, patience_s: Some(120), escalation: escalation() };
    let question = TaskQuestion { task: TaskId::new("wait").unwrap(), number: 1, question, is_open };
    let (mission, role) = (mission.clone(), role("r1"));
    let command = Command::SetQuestion { mission, role, epoch: AWARD, question, asked_ms };
    assert_eq!(apply(ledger, command), CommandOutcome::Done);
}

fn entry<'a>(ledger: &'a Ledger, request: &PersonRequestId) -> &'a PersonRequestEntry {
    ledger.mission(&request.mission).unwrap().person_request(request.number).unwrap()
}

/// Applies the command after so many seconds. Returns the time of the escalation in seconds after
/// the request.
fn escalate(ledger: &mut Ledger, request: &PersonRequestId, after_s: u64) -> Option<u64> {
    let command = Command::EscalatePersonRequest { request: request.clone(), now_ms: ASKED_MS + after_s * 1000 };
    assert_eq!(apply(ledger, command), CommandOutcome::Done);
    let escalation = entry(ledger, request).escalation.as_ref().expect("it is stated");
    assert_eq!(escalation.to, role("head"));
    escalation.escalated_ms.map(|at_ms| (at_ms - ASKED_MS) / 1000)
}

/// Answers as a person. Returns the text of the refusal; empty without one.
fn answer(ledger: &mut Ledger, request: &PersonRequestId, by: &str, content: AnswerContent) -> String {
    let answer = PersonAnswer { by: by.to_owned(), content, note: String::new(), at_ms: ASKED_MS };
    match apply(ledger, Command::AnswerPerson { request: request.clone(), answer, places: BTreeMap::new() }) {
        CommandOutcome::Refused(problem) => problem.to_string(),
        _ => String::new(),
    }
}

fn done() -> AnswerContent {
    AnswerContent::Done(BTreeMap::new())
}

#[test]
fn a_request_is_escalated_once_and_not_before_its_time() {
    for (mut ledger, request) in requests() {
        let asked = |ledger: &Ledger| entry(ledger, &request).asked_roles().cloned().collect::<Vec<_>>();
        assert_eq!(escalate(&mut ledger, &request, 29), None);
        assert_eq!(asked(&ledger), [role("clerk")]);
        let times = [31, 40].map(|after_s| escalate(&mut ledger, &request, after_s));
        assert_eq!(times, [Some(31), Some(31)]);
        assert_eq!(asked(&ledger), [role("clerk"), role("head")]);
        assert!(entry(&ledger, &request).is_open());
    }
}

#[test]
fn an_answered_request_is_not_escalated() {
    for (mut ledger, request) in requests() {
        assert_eq!(answer(&mut ledger, &request, "Nia", done()), "");
        assert_eq!(escalate(&mut ledger, &request, 31), None);
    }
}

#[test]
fn a_request_that_is_put_off_is_escalated_later() {
    for (mut ledger, request) in requests() {
        assert_eq!(answer(&mut ledger, &request, "Nia", AnswerContent::Later(ASKED_MS + 60_000)), "");
        assert_eq!(escalate(&mut ledger, &request, 89), None);
        assert_eq!(escalate(&mut ledger, &request, 90), Some(90));
    }
}

#[test]
fn the_first_answer_to_an_escalated_request_counts() {
    for (first, second) in [("Nia", "head"), ("head", "Nia")] {
        for (mut ledger, request) in requests() {
            escalate(&mut ledger, &request, 31);
            assert_eq!(answer(&mut ledger, &request, first, done()), "");
            let refused = answer(&mut ledger, &request, second, done());
            assert_eq!(refused, format!("request {request} is closed; it was answered by {first}: done"));
        }
    }
}

/// The mission continues: the robot decides how to go on.
#[test]
fn people_with_the_other_role_may_decline_a_question_as_the_first_may() {
    for content in [AnswerContent::Declined, AnswerContent::Cannot] {
        let (mut ledger, request) = with_question();
        escalate(&mut ledger, &request, 31);
        assert_eq!(answer(&mut ledger, &request, "head", content), "");
        assert!(!entry(&ledger, &request).is_open());
        assert_eq!(ledger.mission(&request.mission).unwrap().state, MissionState::Running);
    }
}

/// A robot that has restarted reports its question again.
#[test]
fn a_repeated_question_stays_escalated() {
    let (mut ledger, request) = with_question();
    escalate(&mut ledger, &request, 31);
    report(&mut ledger, &request.mission, true, ASKED_MS + 40_000);
    let asked: Vec<PersonRequestId> =
        ledger.mission(&request.mission).unwrap().person_requests().map(|(id, _)| id).collect();
    assert_eq!(asked, std::slice::from_ref(&request));
    assert_eq!(entry(&ledger, &request).escalated_to(), Some(&role("head")));
}

#[test]
fn a_withdrawn_question_is_not_escalated() {
    let (mut ledger, request) = with_question();
    report(&mut ledger, &request.mission, false, ASKED_MS + 1000);
    assert_eq!(escalate(&mut ledger, &request, 31), None);
}

#[test]
fn an_escalated_question_expires_and_the_mission_continues() {
    let (mut ledger, request) = with_question();
    escalate(&mut ledger, &request, 31);
    let (now_ms, places) = (ASKED_MS + 120_000, BTreeMap::new());
    apply(&mut ledger, Command::ExpirePersonRequest { request: request.clone(), now_ms, places });
    assert_eq!(entry(&ledger, &request).phase, PersonRequestPhase::Expired);
    assert_eq!(ledger.mission(&request.mission).unwrap().state, MissionState::Running);
}
