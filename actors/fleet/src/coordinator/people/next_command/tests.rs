use super::super::test_ledger::{asking, clerk, ledger};
use super::*;
use consort_protocol::ledger::{AnswerContent, CommandOutcome, Ledger, MissionState, PersonAnswer};
use consort_protocol::scalar::Scalar;
use std::collections::{BTreeMap, BTreeSet};

const NOW_MS: u64 = 1_700_000_000_000;

fn apply(ledger: &mut Ledger, command: Command) -> CommandOutcome {
    ledger.apply(Epoch { term: 2, index: 9 }, command)
}

fn next(ledger: &Ledger) -> Option<PersonStep> {
    next_step(ledger.missions().next().unwrap(), &clerk(), Some(NOW_MS))
}

/// Applies the commands of the clerk's role until it waits. Returns their names.
fn advance(ledger: &mut Ledger) -> Vec<&'static str> {
    let mut names = vec![];
    while let Some(step) = next(ledger) {
        let mission = ledger.missions().next().unwrap().id.clone();
        let (name, command) = match step {
            PersonStep::Progress(command) => ("progress", command),
            PersonStep::Ask { branch, step } => {
                ("ask", Command::AskPerson { mission, branch, role: clerk(), step, asked_ms: NOW_MS })
            }
            other => panic!("{other:?}"),
        };
        names.push(name);
        assert_eq!(apply(ledger, command), CommandOutcome::Done);
    }
    names
}

/// The robot has opened its box and signals it.
fn robot_opens(ledger: &mut Ledger, branch: Branch) {
    let entry = ledger.missions().next().unwrap();
    let (role, holder) = entry.role_holders().pop_first().expect("a holder");
    let (mission, epoch, outcomes) = (entry.id.clone(), holder.epoch, BTreeMap::new());
    let ended = BTreeSet::from([0, 1]);
    let progress = Command::Progress { mission, role, epoch, branch, ended, outcomes };
    assert_eq!(apply(ledger, progress), CommandOutcome::Done);
}

fn answer(ledger: &mut Ledger, number: u32, by: &str, content: AnswerContent) -> CommandOutcome {
    let mission = ledger.missions().next().unwrap().id.clone();
    let answer = PersonAnswer { by: by.to_owned(), content, note: String::new(), at_ms: NOW_MS };
    let request = PersonRequestId { mission, number };
    apply(ledger, Command::AnswerPerson { request, answer, places: BTreeMap::new() })
}

fn done() -> AnswerContent {
    AnswerContent::Done(BTreeMap::new())
}

#[test]
fn a_person_is_asked_once_the_robot_is_ready_and_the_first_answer_counts() {
    let (mut ledger, _) = ledger(false);
    assert_eq!(next(&ledger), None, "the box is closed");
    robot_opens(&mut ledger, Branch::Main);
    assert_eq!(advance(&mut ledger), ["progress", "ask"]);
    let open = ledger.open_person_requests();
    let [(entry, request)] = open[..] else { panic!("{open:?}") };
    let task = entry.requested_task(request).expect("its task");
    assert_eq!((request.task.as_str(), task.parameters["into_role"].as_str()), ("deposit", "r1"));
    assert_eq!(request.robots.values().map(|held| held.robot.as_str()).collect::<Vec<_>>(), ["amber"]);

    assert_eq!(answer(&mut ledger, 1, "Nia", AnswerContent::Later(NOW_MS + 60_000)), CommandOutcome::Done);
    assert_eq!(next(&ledger), None, "it stays open");
    assert_eq!(answer(&mut ledger, 1, "Nia", done()), CommandOutcome::Done);
    assert_eq!(answer(&mut ledger, 1, "Nia", done()), CommandOutcome::Done, "she repeats her answer");
    let other = AnswerContent::Done(BTreeMap::from([("dust_g".to_owned(), Scalar::Integer(3))]));
    for (by, content) in [("Ria", done()), ("Nia", AnswerContent::Cannot), ("Nia", other)] {
        let CommandOutcome::Refused(problem) = answer(&mut ledger, 1, by, content) else { panic!("{by}") };
        assert_eq!(problem.to_string(), "request fetch-1.1 is closed; it was answered by Nia: done");
    }
    assert_eq!(advance(&mut ledger), ["progress"], "the robot is told");
    let state = &ledger.missions().next().unwrap().state;
    assert_eq!(*state, MissionState::Running, "the robot closes its box");
}

#[test]
fn a_person_who_declines_fails_the_mission() {
    let (mut ledger, mission) = ledger(false);
    robot_opens(&mut ledger, Branch::Main);
    advance(&mut ledger);
    assert_eq!(answer(&mut ledger, 1, "Nia", AnswerContent::Declined), CommandOutcome::Done);
    let MissionState::Failed { cause, .. } = &ledger.mission(&mission).unwrap().state else { panic!("it continues") };
    assert_eq!(cause, "Nia as clerk declined to do deposit");
    let refused = answer(&mut ledger, 1, "Ria", done());
    assert!(matches!(refused, CommandOutcome::Refused(_)), "{refused:?}");
}

/// The parcel is lost: another robot meets the clerk. An answer to the former request does not
/// count for the new request.
#[test]
fn a_request_is_withdrawn_when_the_robot_is_lost() {
    let (mut main, mission) = ledger(false);
    robot_opens(&mut main, Branch::Main);
    advance(&mut main);
    let entry = main.mission(&mission).unwrap();
    let (role, held) = entry.role_holders().pop_first().unwrap();
    let release = Command::Release {
        mission: mission.clone(),
        role,
        epoch: held.epoch,
        cause: "silent".to_owned(),
        class: None,
        moved_nothing: false,
        place: None,
        gave_way: false,
    };
    assert_eq!(apply(&mut main, release), CommandOutcome::Done);
    assert!(main.open_person_requests().is_empty());
    let CommandOutcome::Refused(problem) = answer(&mut main, 1, "Nia", done()) else { panic!("it counts") };
    assert!(problem.to_string().contains("fetch-1.1 is closed; it was withdrawn: "), "{problem}");
}

#[test]
fn a_request_may_be_put_off_again() {
    let (mut ledger, mission) = ledger(false);
    robot_opens(&mut ledger, Branch::Main);
    advance(&mut ledger);
    for _ in 0..5 {
        assert_eq!(answer(&mut ledger, 1, "Nia", AnswerContent::Later(NOW_MS + 60_000)), CommandOutcome::Done);
    }
    let request = ledger.mission(&mission).unwrap().person_request(1).unwrap();
    assert_eq!(request.phase.to_string(), "put off by Nia");
}

#[test]
fn a_request_is_escalated_once_and_expires_only_with_patience() {
    let (mut ledger, mission) = ledger(false);
    robot_opens(&mut ledger, Branch::Main);
    let Some(PersonStep::Progress(progress)) = next(&ledger) else { panic!("no progress") };
    apply(&mut ledger, progress);
    assert_eq!(next_step(ledger.mission(&mission).unwrap(), &clerk(), None), None, "without the time");
    advance(&mut ledger);
    let request = PersonRequestId { mission: mission.clone(), number: 1 };
    let at = |ledger: &Ledger, now_ms| next_step(ledger.mission(&mission).unwrap(), &clerk(), Some(now_ms));
    assert_eq!(at(&ledger, NOW_MS + 29_999), None);
    assert_eq!(at(&ledger, NOW_MS + 30_000), Some(PersonStep::Escalate(request.clone())));
    let escalate = Command::EscalatePersonRequest { request: request.clone(), now_ms: NOW_MS + 30_000 };
    assert_eq!(apply(&mut ledger, escalate), CommandOutcome::Done);
    assert_eq!(at(&ledger, u64::MAX), None, "a request without patience does not expire");
    let expire = Command::ExpirePersonRequest { request, now_ms: u64::MAX, places: BTreeMap::new() };
    assert_eq!(apply(&mut ledger, expire), CommandOutcome::Done);
    assert_eq!(ledger.open_person_requests().len(), 1, "the command does not fit");
}

#[test]
fn a_question_is_escalated_once_and_then_expires() {
    let (mut ledger, mission) = ledger(false);
    let asked = asking(&ledger, true, NOW_MS);
    assert_eq!(apply(&mut ledger, asked), CommandOutcome::Done);
    let r1 = RoleId::new("r1").unwrap();
    let request = PersonRequestId { mission: mission.clone(), number: 1 };
    let at = |ledger: &Ledger, after_ms: u64| {
        let mut steps = question_steps(ledger.mission(&mission).unwrap(), Some(NOW_MS + after_ms));
        (steps.next(), steps.next())
    };
    let step = |step: PersonStep| (Some(((mission.clone(), r1.clone()), step)), None);
    assert_eq!(at(&ledger, 29_999), (None, None));
    assert_eq!(at(&ledger, 30_000), step(PersonStep::Escalate(request.clone())));
    let escalate = Command::EscalatePersonRequest { request: request.clone(), now_ms: NOW_MS + 30_000 };
    assert_eq!(apply(&mut ledger, escalate), CommandOutcome::Done);
    assert_eq!(at(&ledger, 59_999), (None, None));
    assert_eq!(at(&ledger, 60_000), step(PersonStep::Expire(request)));
}
