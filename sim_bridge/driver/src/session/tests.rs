use super::*;
use crate::messages::OfferedAction;
use consort_skills::actions::{JsonObject, Undock, Wait};
use consort_skills::domain_file::DomainFile;
use serde_json::json;

const KEEP: Duration = Duration::from_millis(900);

fn at(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn dock() -> PlaceId {
    "Dock".parse().unwrap()
}

fn wait() -> Goal {
    Goal::from(Wait { time: Seconds::new(2.0).unwrap() })
}

fn hello(resumes: bool) -> SessionEvent {
    let actions = BTreeMap::from([("wait".parse().unwrap(), OfferedAction::default())]);
    SessionEvent::Message(DriverMessage::Hello { protocol: 1, driver: "test".to_owned(), actions, resumes })
}

fn result(id: u64, status: ResultStatus) -> SessionEvent {
    SessionEvent::Message(DriverMessage::Result {
        id: GoalId(id),
        status,
        code: None,
        message: None,
        results: JsonObject::new(),
    })
}

fn ended(how: &str) -> SessionEvent {
    SessionEvent::Ended(how.to_owned())
}

fn new() -> DriverSession {
    let form = json!({
        "domain": "cleaning",
        "actions": {
            "press": {
                "cancel": { "within_s": 5.5 },
                "feedback": { "force_n": { "type": "number", "minimum": 0 }, "phase": { "type": "text" } },
            },
        },
        "readings": { "dust": { "type": "number", "minimum": 0 }, "bag": { "type": "text" } },
    });
    let form = serde_json::from_value(form).unwrap();
    let contract = Contract::new([&DomainFile::check(form, &BTreeMap::new(), &[]).unwrap()]);
    DriverSession::new("ada".parse().unwrap(), contract, Pose::default(), BatteryShare::FULL)
}

/// Returns a session at time 0, after the hello of its driver.
fn ready(resumes: bool) -> DriverSession {
    let mut session = new();
    assert_eq!(session.tick(&dock(), at(0))[0], SessionAction::Spawn);
    session.handle(hello(resumes), at(0));
    session
}

/// The messages among the actions.
fn sent(actions: Vec<SessionAction>) -> Vec<NodeMessage> {
    let message = |action| match action {
        SessionAction::Send(message) => Some(message),
        SessionAction::Spawn | SessionAction::Kill(_) | SessionAction::Log(_) => None,
    };
    actions.into_iter().filter_map(message).collect()
}

fn start(session: &mut DriverSession, id: u64, now: Duration) -> Vec<NodeMessage> {
    session.permit(GoalId(id), KEEP, now);
    sent(session.start(GoalId(id), wait(), now))
}

fn goal_message(id: u64, keep_for_ms: u64, resumed: bool) -> NodeMessage {
    let parameters = JsonObject::from_iter([("time".to_owned(), 2.0.into())]);
    NodeMessage::Goal { id: GoalId(id), action: "wait".parse().unwrap(), parameters, keep_for_ms, resumed, since: None }
}

fn outcome(id: u64, status: GoalStatus) -> Vec<GoalOutcome> {
    vec![GoalOutcome { id: GoalId(id), status }]
}

/// Returns the message of the only ended goal, which was aborted with this code.
fn abort_message(session: &mut DriverSession, code: ErrorCode) -> String {
    let mut outcomes = session.take_ended();
    assert_eq!(outcomes.len(), 1);
    match outcomes.remove(0).status {
        GoalStatus::Aborted(error) => {
            assert_eq!(error.code, code);
            error.message
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_goal_is_sent_with_its_permission_and_ends_with_the_result() {
    let mut session = ready(false);
    assert_eq!(start(&mut session, 7, at(10)), [goal_message(7, 900, false)]);
    assert_eq!(start(&mut session, 7, at(20)), [], "a repeated id");
    assert!(matches!(session.status(GoalId(7)), Some(GoalStatus::Executing(_))));
    let renewed = sent(session.permit(GoalId(7), at(500), at(300)));
    assert_eq!(renewed, [NodeMessage::Keep { id: GoalId(7), keep_for_ms: 500 }]);
    session.handle(result(7, ResultStatus::Succeeded), at(400));
    assert_eq!(session.take_ended(), outcome(7, GoalStatus::succeeded()));
    session.handle(result(7, ResultStatus::Aborted), at(410));
    assert_eq!((session.take_ended(), session.status(GoalId(7))), (vec![], Some(GoalStatus::succeeded())));
    assert_eq!(session.goal(GoalId(7)), Some(wait()));
}

#[test]
fn the_driver_learns_since_when_an_earlier_process_of_the_node_may_have_begun_a_goal() {
    let mut session = ready(false);
    session.permit(GoalId(7), KEEP, at(0));
    let goal = Goal { since: Some(GoalId(5)), ..wait() };
    let sent = sent(session.start(GoalId(7), goal, at(0)));
    assert!(matches!(&sent[..], [NodeMessage::Goal { since: Some(GoalId(5)), .. }]), "{sent:?}");
}

/// The node publishes the results and the causes of several goals in a single message.
#[test]
fn long_results_and_causes_are_bounded() {
    let mut session = ready(false);
    start(&mut session, 7, at(0));
    let long = "x".repeat(60_000);
    let results = JsonObject::from_iter([("note".to_owned(), long.clone().into())]);
    let ended = |id, status, message, results| {
        SessionEvent::Message(DriverMessage::Result { id: GoalId(id), status, code: None, message, results })
    };
    session.handle(ended(7, ResultStatus::Succeeded, None, results), at(1));
    let message = abort_message(&mut session, ErrorCode::Failed);
    assert!(message.contains("bytes of JSON; at most 512 are allowed"), "{message}");
    start(&mut session, 8, at(2));
    session.handle(ended(8, ResultStatus::Aborted, Some(long), JsonObject::new()), at(3));
    assert!(abort_message(&mut session, ErrorCode::Failed).len() <= 512);
}

#[test]
fn a_second_goal_is_busy_and_does_not_reach_the_driver() {
    let mut session = ready(false);
    start(&mut session, 7, at(0));
    assert_eq!(start(&mut session, 8, at(1)), []);
    assert_eq!(abort_message(&mut session, ErrorCode::Busy), "ada has a goal in progress");
    assert_eq!(session.goals(), [GoalId(7), GoalId(8)]);
}

#[test]
fn an_action_that_is_not_offered_fails_with_the_offered_ones() {
    let mut session = ready(false);
    session.permit(GoalId(7), KEEP, at(0));
    assert_eq!(session.start(GoalId(7), Goal::from(Undock {}), at(0)), []);
    let expected = "the driver of ada does not offer undock; offered: wait";
    assert_eq!(abort_message(&mut session, ErrorCode::Unknown), expected);
}

#[test]
fn a_goal_waits_for_the_hello_and_fails_without_it() {
    let mut session = new();
    session.tick(&dock(), at(0));
    assert_eq!(start(&mut session, 7, at(0)), []);
    let begun = sent(session.handle(hello(false), at(300)));
    assert_eq!(begun, [goal_message(7, 600, false)], "with the rest of its permission");

    let mut session = new();
    session.handle(ended("no such file"), at(0));
    start(&mut session, 7, at(0));
    session.tick(&dock(), GOAL_WAIT);
    let expected = "the driver of ada is not ready after 5 s: no such file";
    assert_eq!(abort_message(&mut session, ErrorCode::TimedOut), expected);
}

#[test]
fn an_interrupted_goal_is_resumed_with_the_same_id() {
    let mut session = ready(true);
    start(&mut session, 7, at(0));
    session.handle(ended("signal 9"), at(100));
    assert!(matches!(session.status(GoalId(7)), Some(GoalStatus::Executing(_))));
    assert_eq!(session.tick(&dock(), at(299)), [], "the backoff has not passed");
    let spawned = session.tick(&dock(), at(300));
    assert_eq!((&spawned[0], spawned.len()), (&SessionAction::Spawn, 2));
    session.permit(GoalId(7), KEEP, at(350));
    let begun = sent(session.handle(hello(true), at(400)));
    assert_eq!(begun, [goal_message(7, 850, true)]);
    for ms in [500, 2_000] {
        session.handle(ended("signal 9"), at(ms));
        session.tick(&dock(), at(ms + 1_000));
        session.permit(GoalId(7), KEEP, at(ms + 1_000));
        session.handle(hello(true), at(ms + 1_000));
    }
    let expected = "the driver of ada ended 3 times during the goal: signal 9";
    assert_eq!(abort_message(&mut session, ErrorCode::Failed), expected);
}

#[test]
fn an_interrupted_goal_of_a_driver_that_does_not_resume_fails_with_the_cause() {
    let mut session = ready(false);
    start(&mut session, 7, at(0));
    session.handle(ended("exit status 1"), at(100));
    session.tick(&dock(), at(400));
    assert_eq!(sent(session.handle(hello(false), at(500))), []);
    let expected = "the driver of ada ended during the goal, and does not resume goals: exit status 1";
    assert_eq!(abort_message(&mut session, ErrorCode::Failed), expected);
}

#[test]
fn an_interrupted_goal_without_permission_does_not_start_again() {
    let mut session = ready(true);
    start(&mut session, 7, at(0));
    session.handle(ended("signal 9"), at(100));
    session.tick(&dock(), at(900));
    assert_eq!(sent(session.handle(hello(true), at(900))), []);
    assert_eq!(session.take_ended(), outcome(7, GoalStatus::Canceled));
}

#[test]
fn a_driver_that_ignores_a_cancel_is_killed() {
    let mut session = ready(false);
    start(&mut session, 7, at(0));
    assert_eq!(sent(session.cancel(GoalId(7), at(100))), [NodeMessage::Cancel { id: GoalId(7) }]);
    assert_eq!(session.cancel(GoalId(7), at(110)), [], "it was sent");
    assert_eq!(sent(session.permit(GoalId(7), KEEP, at(120))), [], "a canceled goal is not renewed");
    let killed = session.tick(&dock(), at(3_100));
    assert_eq!(killed, [SessionAction::Kill("goal 7 did not end within 3 s of its cancel".to_owned())]);
    session.handle(ended("signal 9"), at(3_110));
    assert_eq!(session.take_ended(), outcome(7, GoalStatus::Canceled));
}

/// Returns a session at time 0, with goal 7 of the declared action.
fn pressing() -> DriverSession {
    let mut session = new();
    session.tick(&dock(), at(0));
    let actions = BTreeMap::from([("press".parse().unwrap(), OfferedAction::default())]);
    let hello = DriverMessage::Hello { protocol: 1, driver: "test".to_owned(), actions, resumes: false };
    session.handle(SessionEvent::Message(hello), at(0));
    session.permit(GoalId(7), KEEP, at(0));
    let press = serde_json::from_value(json!({ "action": "press" })).unwrap();
    assert_eq!(session.start(GoalId(7), press, at(0)).len(), 1);
    session
}

#[test]
fn the_latest_feedback_of_a_goal_is_its_status() {
    let mut session = pressing();
    let report = |session: &mut DriverSession, line: &str| {
        let logs = session.handle(SessionEvent::Message(DriverMessage::parse(line).unwrap()), at(5));
        match session.status(GoalId(7)) {
            Some(GoalStatus::Executing(feedback)) => (feedback, logs),
            other => panic!("the goal has ended: {other:?}"),
        }
    };
    let line = r#"{"type":"feedback","id":"7","time_remaining_s":3,"values":{"force_n":2,"phase":"contact"}}"#;
    let remaining = Feedback::remaining(Metres::ZERO, Seconds::new(3.0).unwrap());
    let phase = ("phase".to_owned(), Scalar::Text("contact".to_owned()));
    let values = BTreeMap::from([("force_n".to_owned(), Scalar::Number(2.0)), phase.clone()]);
    let expected = Feedback { values, ..remaining.clone() };
    assert_eq!(report(&mut session, line), (expected.clone(), vec![]));
    let of_another = r#"{"type":"feedback","id":"8","values":{"force_n":5,"nonsense":1}}"#;
    assert_eq!(report(&mut session, of_another), (expected, vec![]), "it is of no goal in progress");
    let wrong =
        r#"{"type":"feedback","id":"7","time_remaining_s":3,"values":{"force_n":-1,"fase":"x","phase":"contact"}}"#;
    let logs = [
        "feedback: values.fase: the action press declares no such feedback; allowed: force_n, phase; did you mean \
         `phase`?",
        "feedback: values.force_n: `-1`; the action press declares a number, 0 or more",
    ];
    let logs = logs.map(|text| SessionAction::Log(text.to_owned())).to_vec();
    let expected = Feedback { values: BTreeMap::from([phase]), ..remaining };
    assert_eq!(report(&mut session, wrong), (expected, logs), "the goal continues");
    session.handle(result(7, ResultStatus::Succeeded), at(9));
    assert_eq!(session.take_ended(), outcome(7, GoalStatus::succeeded()));
}

#[test]
fn an_action_declares_how_long_its_cancel_takes() {
    let mut session = pressing();
    assert_eq!(sent(session.cancel(GoalId(7), at(100))), [NodeMessage::Cancel { id: GoalId(7) }]);
    let late = session.tick(&dock(), at(3_200));
    assert_eq!(late, [SessionAction::Send(NodeMessage::Heartbeat { sequence: 1 })], "it is not killed after 3 s");
    let killed = session.tick(&dock(), at(5_600));
    assert_eq!(killed, [SessionAction::Kill("goal 7 did not end within 5.5 s of its cancel".to_owned())]);
}

#[test]
fn a_goal_that_is_canceled_without_a_process_ends_at_once() {
    let mut session = new();
    start(&mut session, 7, at(0));
    assert_eq!(session.cancel(GoalId(7), at(1)), []);
    assert_eq!(session.take_ended(), outcome(7, GoalStatus::Canceled));
}

#[test]
fn a_silent_driver_is_killed_and_any_line_is_a_sign_of_life() {
    let mut session = ready(false);
    let beats = sent(session.tick(&dock(), at(1_000)));
    assert_eq!(beats, [NodeMessage::Heartbeat { sequence: 1 }]);
    session.handle(SessionEvent::WrongLine("{".to_owned()), at(1_500));
    assert_eq!(sent(session.tick(&dock(), at(2_000))).len(), 1);
    assert_eq!(sent(session.tick(&dock(), at(5_999))).len(), 1);
    let killed = session.tick(&dock(), at(6_000));
    assert_eq!(killed, [SessionAction::Kill("no reply to heartbeats for 4 s".to_owned())]);
    assert!(session.is_served(at(6_100), at(3_000)) && !session.is_served(at(9_100), at(3_000)));
}

#[test]
fn a_process_without_a_hello_is_killed_and_the_backoff_grows() {
    let mut session = new();
    session.tick(&dock(), at(0));
    let killed = session.tick(&dock(), HELLO_LIMIT);
    assert_eq!(killed, [SessionAction::Kill("no hello within 10 s".to_owned())]);
    let mut now = HELLO_LIMIT;
    let mut backoffs = vec![];
    for _ in 0..10 {
        session.handle(ended("signal 9"), now);
        let Phase::Down { restart_at } = session.phase else { panic!("{:?}", session.phase) };
        backoffs.push((restart_at - now).as_millis());
        now = restart_at;
        session.tick(&dock(), now);
    }
    assert_eq!(backoffs, [200, 400, 800, 1_600, 3_200, 6_400, 12_800, 25_600, 30_000, 30_000]);
    session.handle(hello(false), now);
    session.tick(&dock(), now + STABLE_AFTER);
    session.handle(ended("exit status 1"), now + STABLE_AFTER);
    assert_eq!(session.phase, Phase::Down { restart_at: now + STABLE_AFTER + BACKOFF_FIRST });
}

#[test]
fn an_undeclared_action_in_the_hello_stops_the_driver() {
    let mut session = new();
    session.tick(&dock(), at(0));
    let actions = BTreeMap::from([("vacum".parse().unwrap(), OfferedAction::default())]);
    let hello = DriverMessage::Hello { protocol: 1, driver: "test".to_owned(), actions, resumes: false };
    let actions = session.handle(SessionEvent::Message(hello), at(0));
    let [SessionAction::Log(logged), SessionAction::Kill(reason)] = &actions[..] else { panic!("{actions:?}") };
    assert!(logged == reason && reason.starts_with("hello: actions.vacum: no domain declares this action"), "{reason}");
}

#[test]
fn reports_replace_the_state_of_the_robot() {
    let mut session = ready(false);
    for line in [
        r#"{"type":"pose","x_m":1.5,"y_m":-2}"#,
        r#"{"type":"charge","share":0.25,"able":false}"#,
        r#"{"type":"readings","values":{"dust":0.5,"bag":"full"}}"#,
        r#"{"type":"readings","values":{"dust":1}}"#,
    ] {
        let report = SessionEvent::Message(DriverMessage::parse(line).unwrap());
        assert_eq!(session.handle(report, at(5)), []);
    }
    let charge = BatteryShare::new(0.25).unwrap();
    let readings = [("bag", Scalar::Text("full".to_owned())), ("dust", Scalar::Number(1.0))];
    let readings = readings.map(|(name, value)| (name.to_owned(), value)).into();
    let expected = ReportedRobot { pose: Pose::new(1.5, -2.0, 0.0), place: None, charge, able: false, readings };
    assert_eq!(session.reported(), &expected);
}

#[test]
fn undeclared_and_wrong_readings_are_ignored_and_logged() {
    let mut session = ready(false);
    let line = r#"{"type":"readings","values":{"bag":"full","dust":-1,"dusd":2,"lid":true}}"#;
    let mut logs = vec![];
    for _ in 0..3 {
        logs.extend(session.handle(SessionEvent::Message(DriverMessage::parse(line).unwrap()), at(5)));
    }
    let expected = [
        "readings: values.dusd: no domain declares this reading; allowed: bag, dust; did you mean `dust`?",
        "readings: values.dust: `-1`; the domain declares a number, 0 or more",
        "readings: values.lid: no domain declares this reading; allowed: bag, dust",
    ];
    let log = |text: &str| SessionAction::Log(text.to_owned());
    assert_eq!(logs[..3], expected.map(log));
    assert_eq!(logs.len(), 5, "further wrong lines are not logged");
    let readings = BTreeMap::from([("bag".to_owned(), Scalar::Text("full".to_owned()))]);
    assert_eq!(session.reported().readings, readings);
}

#[test]
fn wrong_lines_are_logged_a_few_times() {
    let mut session = ready(false);
    let logged: usize =
        (0..20).map(|_| session.handle(SessionEvent::WrongLine("no JSON".to_owned()), at(1)).len()).sum();
    assert_eq!(logged, 5);
    assert_eq!(session.handle(SessionEvent::Throttled, at(2)).len(), 1);
}
