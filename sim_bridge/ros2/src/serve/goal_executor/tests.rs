use super::*;
use consort_fleet::robot_driver::StateStamp;
use consort_protocol::units::{BatteryShare, Seconds};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

static NUMBER: AtomicU64 = AtomicU64::new(1);

const ALICE: GoalUuid = [1; 16];
const BERT: GoalUuid = [2; 16];

/// First goal id of the executors below, written as 100.
const FIRST: u64 = GOALS_START | 1 << 20;

/// Returns an executor for a square of lanes, 10 m a side: A – B – C – D – A.
fn executor() -> GoalExecutor {
    let text = "{name: square, places: [{name: A, kind: other, x_m: 0, y_m: 0}, {name: B, kind: other, x_m: 10, y_m: 0}, \
        {name: C, kind: other, x_m: 10, y_m: 10}, {name: D, kind: other, x_m: 0, y_m: 10}], \
        lanes: [{between: [A, B]}, {between: [B, C]}, {between: [C, D]}, {between: [D, A]}]}";
    let planner = RoutePlanner::new(consort_world::map::read(text, "square.yaml").unwrap()).unwrap();
    let mut executor = GoalExecutor::new("ada".parse().unwrap(), Arc::new(planner), 1);
    assert_eq!(executor.handle_state(state(&[]), s(0)), []);
    executor
}

fn s(seconds: u64) -> Duration {
    Duration::from_secs(seconds)
}

fn place(name: &str) -> PlaceId {
    name.parse().unwrap()
}

/// Returns a state of the robot at A, at 5 s of world time.
fn state(goals: &[(u64, GoalStatus)]) -> DriverState {
    let telemetry = Telemetry {
        time: WorldTime::from_secs(5.0),
        pose: Pose::default(),
        place: place("A"),
        battery: BatteryShare::FULL,
        able: true,
        closed: vec![],
        readings: BTreeMap::new(),
    };
    let goals = goals.iter().map(|(id, status)| (GoalId(FIRST + id - 100), status.clone())).collect();
    let stamp = StateStamp { boot: 3, sequence: NUMBER.fetch_add(1, Ordering::Relaxed) };
    DriverState { robot: "ada".parse().unwrap(), stamp, telemetry, goals, completed: vec![] }
}

fn state_with_closure(closed: (&str, &str), goals: &[(u64, GoalStatus)]) -> DriverState {
    let mut state = state(goals);
    state.telemetry.closed.push((place(closed.0), place(closed.1)));
    state
}

fn executing(metres: f64, seconds: f64) -> GoalStatus {
    GoalStatus::Executing(Feedback::remaining(Metres::new(metres).unwrap(), Seconds::new(seconds).unwrap()))
}

fn aborted(code: ErrorCode) -> GoalStatus {
    GoalStatus::Aborted(ActionError::new(code, "why".to_owned()))
}

fn at_b() -> Result<Pose, PoseError> {
    Ok(Pose::new(10.0, 0.0, 0.0))
}

/// Summarises actions: commands by kind and id, ends by client and code.
fn summary(actions: &[Action]) -> Vec<String> {
    let summary = |action: &Action| match action {
        Action::Command(None) => "heartbeat".to_owned(),
        Action::Command(Some(GoalRequest::Start { id, .. })) => format!("start {}", 100 + id.0 - FIRST),
        Action::Command(Some(GoalRequest::Cancel { id })) => format!("cancel {}", 100 + id.0 - FIRST),
        Action::Feedback(client, report) => format!("feedback {} {:.1} m", client[0], report.distance.get()),
        Action::End(client, how, outcome) => format!("end {} {how:?} {}", client[0], outcome.error_code),
    };
    actions.iter().map(summary).collect()
}

#[test]
fn a_goal_is_started_reported_and_ended() {
    let mut executor = executor();
    assert_eq!(summary(&executor.handle_goal(ALICE, Ok(Pose::new(10.0, 10.0, 0.0)), s(1))), ["start 100"]);
    assert_eq!(
        summary(&executor.handle_state(state(&[]), s(1))),
        [] as [&str; 0],
        "the server has not received it yet"
    );
    assert_eq!(summary(&executor.tick(s(1))), ["start 100"], "the command is repeated");
    let actions = executor.handle_state(state(&[(100, executing(4.0, 8.0))]), s(2));
    let expected = Report {
        pose: Pose::default(),
        navigation_s: 0.0,
        remaining_s: 40.0,
        recoveries: 0,
        distance: Metres::new(20.0).unwrap(),
    };
    assert_eq!(actions, [Action::Feedback(ALICE, expected)]);
    assert_eq!(summary(&executor.tick(s(2))), ["heartbeat"]);
    let ended = executor.handle_state(state(&[(100, GoalStatus::succeeded())]), s(9));
    assert_eq!(ended, [Action::End(ALICE, EndState::Succeeded, NavigateResult::default())]);
    assert!(!executor.is_busy());
    assert_eq!(executor.tick(s(99)), [], "an idle robot receives no commands");
}

#[test]
fn a_canceled_goal_ends_when_the_robot_has_stopped() {
    let mut executor = executor();
    executor.handle_goal(ALICE, at_b(), s(1));
    assert_eq!(summary(&executor.cancel(BERT)), [] as [&str; 0], "the goal of another client");
    assert_eq!(summary(&executor.cancel(ALICE)), ["cancel 100"]);
    assert_eq!(summary(&executor.tick(s(1))), ["cancel 100"], "repeated until it ends");
    assert_eq!(summary(&executor.handle_state(state(&[(100, executing(4.0, 8.0))]), s(2))), ["feedback 1 10.0 m"]);
    assert_eq!(summary(&executor.handle_state(state(&[(100, GoalStatus::Canceled)]), s(2))), ["end 1 Canceled 0"]);
}

#[test]
fn a_goal_canceled_by_another_client_is_aborted() {
    let mut executor = executor();
    executor.handle_goal(ALICE, at_b(), s(1));
    let ended = executor.handle_state(state(&[(100, GoalStatus::Canceled)]), s(2));
    let error_msg = "unknown: ada: another client canceled it".to_owned();
    assert_eq!(ended, [Action::End(ALICE, EndState::Aborted, NavigateResult { error_code: 9000, error_msg })]);
}

#[test]
fn a_later_goal_starts_when_the_earlier_has_ended() {
    let mut executor = executor();
    executor.handle_goal(ALICE, at_b(), s(1));
    assert_eq!(summary(&executor.handle_goal(BERT, at_b(), s(2))), ["end 1 Aborted 9000", "cancel 100"]);
    assert_eq!(summary(&executor.handle_goal(ALICE, at_b(), s(2))), ["end 2 Aborted 9000", "cancel 100"]);
    assert_eq!(summary(&executor.handle_state(state(&[(100, GoalStatus::Canceled)]), s(3))), ["start 101"]);
    assert_eq!(summary(&executor.handle_state(state(&[(101, GoalStatus::succeeded())]), s(4))), ["end 1 Succeeded 0"]);
}

#[test]
fn a_waiting_goal_can_be_canceled() {
    let mut executor = executor();
    executor.handle_goal(ALICE, at_b(), s(1));
    executor.handle_goal(BERT, at_b(), s(2));
    assert_eq!(summary(&executor.cancel(BERT)), ["end 2 Canceled 0"]);
    assert_eq!(summary(&executor.handle_state(state(&[(100, GoalStatus::Canceled)]), s(3))), [] as [&str; 0]);
    assert!(!executor.is_busy());
}

#[test]
fn a_blocked_robot_drives_around_a_new_closure() {
    let mut executor = executor();
    executor.handle_goal(ALICE, at_b(), s(1));
    assert_eq!(summary(&executor.handle_state(state(&[(100, aborted(ErrorCode::Blocked))]), s(2))), [] as [&str; 0]);
    let with_closure = state_with_closure(("A", "B"), &[(100, aborted(ErrorCode::Blocked))]);
    assert_eq!(summary(&executor.handle_state(with_closure, s(2))), ["start 101"]);
    let actions = executor.handle_state(state_with_closure(("A", "B"), &[(101, executing(10.0, 20.0))]), s(3));
    assert!(matches!(actions.as_slice(), [Action::Feedback(_, Report { recoveries: 1, .. })]), "{actions:?}");
    let ended = executor.handle_state(state_with_closure(("A", "B"), &[(101, aborted(ErrorCode::Blocked))]), s(4));
    assert_eq!(summary(&ended), [] as [&str; 0], "no new closure yet: the next state may contain it");
    let ended = executor.handle_state(state_with_closure(("A", "B"), &[(101, aborted(ErrorCode::Blocked))]), s(5));
    assert_eq!(summary(&ended), ["end 1 Aborted 105"]);
}

#[test]
fn failures_have_the_codes_of_nav2() {
    let mut executor = executor();
    let nowhere = executor.handle_goal(ALICE, Ok(Pose::new(99.0, 0.0, 0.0)), s(1));
    assert_eq!(summary(&nowhere), ["end 1 Aborted 208"]);
    let invalid = executor.handle_goal(ALICE, Err(PoseError::Frame("odom".to_owned())), s(1));
    assert_eq!(summary(&invalid), ["end 1 Aborted 9002"]);
    executor.handle_goal(ALICE, at_b(), s(1));
    assert_eq!(
        summary(&executor.handle_state(state(&[(100, aborted(ErrorCode::BatteryLow))]), s(2))),
        ["end 1 Aborted 9000"]
    );
}

#[test]
fn a_silent_or_restarted_server_ends_the_goal() {
    let mut executor = executor();
    executor.handle_goal(ALICE, at_b(), s(10));
    assert_eq!(summary(&executor.tick(s(13))), ["start 100"], "it was sent at 10 s");
    let ended = executor.tick(s(14));
    let error_msg = "timed out: ada: no state from its driver server for 3 s".to_owned();
    assert_eq!(ended, [Action::End(ALICE, EndState::Aborted, NavigateResult { error_code: 9003, error_msg })]);

    executor.handle_goal(ALICE, at_b(), s(20));
    executor.handle_state(state(&[(101, executing(9.0, 9.0))]), s(20));
    assert_eq!(summary(&executor.handle_state(state(&[]), s(21))), ["end 1 Aborted 9000"], "a restarted server");
}

#[test]
fn an_outdated_state_is_ignored() {
    let mut executor = executor();
    let early = state(&[]);
    executor.handle_goal(ALICE, at_b(), s(1));
    executor.handle_state(state(&[(100, executing(9.0, 9.0))]), s(1));
    assert_eq!(executor.handle_state(early, s(2)), [], "it is older than the goal");
    assert!(executor.is_busy());
}

#[test]
fn a_goal_without_any_state_is_aborted() {
    let planner = Arc::clone(&executor().planner);
    let mut executor = GoalExecutor::new("bob".parse().unwrap(), planner, 1);
    assert_eq!(summary(&executor.handle_goal(ALICE, at_b(), s(1))), ["end 1 Aborted 9003"]);
}

#[test]
fn goals_of_a_previous_run_are_canceled_before_a_goal_starts() {
    let mut executor = executor();
    assert_eq!(summary(&executor.handle_state(state(&[(99, executing(4.0, 8.0))]), s(1))), ["cancel 99"]);
    assert_eq!(summary(&executor.handle_goal(ALICE, at_b(), s(1))), [] as [&str; 0]);
    assert_eq!(executor.command(None, s(1)).permit.goals, [], "nothing lets the abandoned goal continue");
    assert_eq!(summary(&executor.handle_state(state(&[(99, executing(3.0, 6.0))]), s(2))), ["cancel 99"]);
    assert_eq!(summary(&executor.handle_state(state(&[(99, GoalStatus::Canceled)]), s(2))), ["start 100"]);
}

#[test]
fn goals_of_a_robot_node_are_not_canceled() {
    let mut executor = executor();
    let mut state = state(&[]);
    state.goals.push((GoalId(1_700_000_000_000 << 20), executing(4.0, 8.0)));
    assert_eq!(executor.handle_state(state, s(1)), []);
}

#[test]
fn a_stopped_executor_is_busy_until_the_robot_has_stopped() {
    let mut executor = executor();
    executor.handle_goal(ALICE, at_b(), s(1));
    executor.handle_state(state(&[(100, executing(4.0, 8.0))]), s(1));
    assert_eq!(executor.command(None, s(2)).permit.keep_for_ms, 4_000, "3 s from now, counted from the state at 1 s");
    assert_eq!(summary(&executor.stop()), ["cancel 100"]);
    assert_eq!(executor.command(None, s(2)).permit.goals, []);
    assert!(executor.is_busy());
    let ended = executor.handle_state(state(&[(100, GoalStatus::Canceled)]), s(2));
    assert_eq!((ended, executor.is_busy()), (vec![], false), "the action server aborts the goal of the client");
}
