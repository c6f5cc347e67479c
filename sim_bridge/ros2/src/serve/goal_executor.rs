//! Executes the ROS 2 goals of a robot, as a state machine: it takes requests, states and time, and
//! returns commands for the driver server and messages for the client. It never blocks.
//!
//! ```text
//!  request ─▶ plan ─▶ Command(Start) ─▶ states of the robot ─▶ Feedback … End
//!               ▲                          │ blocked, and a new closure is known
//!               └──────────────────────────┘
//! ```

use crate::goals::{EndState, GoalUuid};
use crate::mapping::{PoseError, to_nav2_result};
use crate::messages::NavigateResult;
use crate::route_planner::{PlannedRoute, RoutePlanner};
use consort_fleet::robot_driver::{CLIENT_TIMEOUT, DriverState, GoalRequest};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::pose::Pose;
use consort_protocol::units::{Metres, WorldTime};
use consort_skills::actions::{ActionError, ErrorCode, Feedback, GoalId, GoalStatus, Telemetry};
use std::sync::Arc;
use std::time::Duration;

/// An effect for the caller to perform, in the order given.
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// Send this command to the driver server; without a request it is a heartbeat.
    Command(Option<GoalRequest>),
    /// Send feedback to the client.
    Feedback(GoalUuid, Report),
    /// Send the end of the goal to the client.
    End(GoalUuid, EndState, NavigateResult),
}

/// Feedback of a goal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// Pose of the robot.
    pub pose: Pose,
    /// Seconds of world time since the goal was started.
    pub navigation_s: f64,
    /// Remaining seconds of world time, as estimated by the robot.
    pub remaining_s: f64,
    /// Number of detours.
    pub recoveries: i16,
    /// Remaining distance.
    pub distance: Metres,
}

/// Executor of the goals of a robot.
#[derive(Debug)]
pub struct GoalExecutor {
    robot: RobotId,
    planner: Arc<RoutePlanner>,
    /// Id of the next goal for the driver.
    next: u64,
    latest: Option<Telemetry>,
    /// Sequence number of the latest state.
    sequence: u64,
    last_state_at: Duration,
    active_goal: Option<ActiveGoal>,
    /// Next goal, started when the current goal has ended.
    waiting: Option<(GoalUuid, Pose)>,
}

#[derive(Debug)]
struct ActiveGoal {
    /// Client of the goal; `None` once another goal has replaced it.
    client: Option<GoalUuid>,
    to: Pose,
    goal: GoalId,
    route: PlannedRoute,
    /// Closed connections known at the start.
    known_closures: Vec<(PlaceId, PlaceId)>,
    /// True if the driver server has received the goal.
    confirmed: bool,
    canceling: bool,
    /// The robot was blocked; the report of the closure may still be missing.
    blocked: Option<ActionError>,
    since: WorldTime,
    started_at: Duration,
    recoveries: i16,
}

impl GoalExecutor {
    /// Creates an executor for a robot on a map. Goal ids start at `first_goal`; none of them may
    /// have been used before.
    pub fn new(robot: RobotId, planner: Arc<RoutePlanner>, first_goal: u64) -> GoalExecutor {
        let (latest, last_state_at) = (None, Duration::ZERO);
        GoalExecutor {
            robot,
            planner,
            next: first_goal,
            latest,
            sequence: 0,
            last_state_at,
            active_goal: None,
            waiting: None,
        }
    }

    /// Checks whether a goal is in progress; [`tick`](Self::tick) must then be called regularly.
    pub fn is_busy(&self) -> bool {
        self.active_goal.is_some()
    }

    /// Handles a new goal of a client. It replaces the goal of another client.
    pub fn handle_goal(&mut self, client: GoalUuid, to: Result<Pose, PoseError>, now: Duration) -> Vec<Action> {
        let mut actions = Vec::new();
        let to = match to {
            Ok(to) => to,
            Err(problem) => {
                let outcome = NavigateResult { error_code: problem.code(), error_msg: problem.to_string() };
                return vec![Action::End(client, EndState::Aborted, outcome)];
            }
        };
        if let Some((former, _)) = self.waiting.replace((client, to)) {
            actions.push(superseded(former));
        }
        match &mut self.active_goal {
            Some(active) => {
                actions.extend(active.client.take().map(superseded));
                active.canceling = true;
                actions.push(Action::Command(Some(GoalRequest::Cancel { id: active.goal })));
            }
            None => actions.extend(self.start_waiting(now)),
        }
        actions
    }

    /// Handles a cancel request of a client.
    pub fn cancel(&mut self, client: GoalUuid) -> Vec<Action> {
        if self.waiting.as_ref().is_some_and(|(waiting, _)| *waiting == client) {
            self.waiting = None;
            return vec![Action::End(client, EndState::Canceled, NavigateResult::default())];
        }
        match self.active_goal.as_mut().filter(|active| active.client == Some(client)) {
            Some(active) => {
                active.canceling = true;
                vec![Action::Command(Some(GoalRequest::Cancel { id: active.goal }))]
            }
            None => vec![],
        }
    }

    /// Handles a state of the driver server.
    pub fn handle_state(&mut self, state: DriverState, now: Duration) -> Vec<Action> {
        if state.sequence <= self.sequence && self.sequence - state.sequence < 1 << 32 {
            return vec![]; // older than the latest state; a much smaller number belongs to a restarted server
        }
        (self.sequence, self.last_state_at) = (state.sequence, now);
        let telemetry = state.telemetry;
        self.latest = Some(telemetry.clone());
        let Some(active) = &mut self.active_goal else { return vec![] };
        let status = state.goals.into_iter().find(|(id, _)| *id == active.goal).map(|(_, status)| status);
        active.confirmed |= status.is_some();
        match status {
            Some(GoalStatus::Sent) => vec![],
            Some(GoalStatus::Executing(feedback)) => {
                let Some(client) = active.client else { return vec![] };
                vec![Action::Feedback(client, report(&self.planner, active, &telemetry, feedback))]
            }
            Some(GoalStatus::Succeeded) => self.end(EndState::Succeeded, NavigateResult::default(), now),
            Some(GoalStatus::Canceled) if active.canceling => {
                self.end(EndState::Canceled, NavigateResult::default(), now)
            }
            Some(GoalStatus::Canceled) => self.fail(ErrorCode::Unknown, "another client canceled it", now),
            Some(GoalStatus::Aborted(error)) if error.code == ErrorCode::Blocked && !active.canceling => {
                if telemetry.closed.iter().any(|closure| !active.known_closures.contains(closure)) {
                    return self.replan(now);
                }
                match &active.blocked {
                    Some(_) => self.end(EndState::Aborted, to_nav2_result(&error), now),
                    None => {
                        active.blocked = Some(error);
                        vec![]
                    }
                }
            }
            Some(GoalStatus::Aborted(error)) => self.end(EndState::Aborted, to_nav2_result(&error), now),
            None if active.confirmed => self.fail(ErrorCode::Unknown, "its driver server no longer has the goal", now),
            // A state from before the server received the goal.
            None => vec![],
        }
    }

    /// Handles the passage of time: sends a heartbeat, repeats an unconfirmed command, and gives up
    /// without states from the driver server.
    pub fn tick(&mut self, now: Duration) -> Vec<Action> {
        let Some(active) = &self.active_goal else { return vec![] };
        if now.saturating_sub(self.last_state_at.max(active.started_at)) > CLIENT_TIMEOUT {
            let why = format!("no state from its driver server for {} s", CLIENT_TIMEOUT.as_secs());
            return self.fail(ErrorCode::TimedOut, &why, now);
        }
        let request = match (active.confirmed, active.canceling) {
            (_, true) => Some(GoalRequest::Cancel { id: active.goal }),
            (false, false) => Some(GoalRequest::Start { id: active.goal, goal: active.route.goal.clone() }),
            (true, false) => None,
        };
        vec![Action::Command(request)]
    }

    /// Starts the waiting goal.
    fn start_waiting(&mut self, now: Duration) -> Vec<Action> {
        let Some((client, to)) = self.waiting.take() else { return vec![] };
        let Some(telemetry) = &self.latest else {
            let error = self.error(ErrorCode::TimedOut, "no state of the robot has been received yet");
            return vec![Action::End(client, EndState::Aborted, to_nav2_result(&error))];
        };
        match self.planner.plan(telemetry, to) {
            Ok(route) => {
                let (since, known_closures) = (telemetry.time, telemetry.closed.clone());
                self.start(ActiveGoal {
                    client: Some(client),
                    to,
                    goal: GoalId(self.next),
                    route,
                    known_closures,
                    confirmed: false,
                    canceling: false,
                    blocked: None,
                    since,
                    started_at: now,
                    recoveries: 0,
                })
            }
            Err(error) => vec![Action::End(client, EndState::Aborted, to_nav2_result(&error))],
        }
    }

    fn start(&mut self, active: ActiveGoal) -> Vec<Action> {
        self.next += 1;
        let start = GoalRequest::Start { id: active.goal, goal: active.route.goal.clone() };
        self.active_goal = Some(active);
        vec![Action::Command(Some(start))]
    }

    /// Replans after a newly reported closure, if there is another route.
    fn replan(&mut self, now: Duration) -> Vec<Action> {
        let (Some(active), Some(telemetry)) = (self.active_goal.take(), self.latest.clone()) else { return vec![] };
        match self.planner.plan(&telemetry, active.to) {
            Ok(route) => {
                let recoveries = active.recoveries.saturating_add(1);
                let (goal, known_closures) = (GoalId(self.next), telemetry.closed);
                self.start(ActiveGoal {
                    goal,
                    route,
                    known_closures,
                    confirmed: false,
                    blocked: None,
                    started_at: now,
                    recoveries,
                    ..active
                })
            }
            Err(error) => {
                self.active_goal = Some(active);
                self.end(EndState::Aborted, to_nav2_result(&error), now)
            }
        }
    }

    fn fail(&mut self, code: ErrorCode, why: &str, now: Duration) -> Vec<Action> {
        let error = self.error(code, why);
        self.end(EndState::Aborted, to_nav2_result(&error), now)
    }

    fn error(&self, code: ErrorCode, why: &str) -> ActionError {
        ActionError { code, message: format!("{}: {why}", self.robot) }
    }

    /// Ends the current goal and starts the waiting goal.
    fn end(&mut self, how: EndState, outcome: NavigateResult, now: Duration) -> Vec<Action> {
        let client = self.active_goal.take().and_then(|active| active.client);
        let mut actions: Vec<Action> = client.map(|client| Action::End(client, how, outcome)).into_iter().collect();
        actions.extend(self.start_waiting(now));
        actions
    }
}

fn superseded(client: GoalUuid) -> Action {
    let error_msg = "another goal has replaced it".to_owned();
    Action::End(client, EndState::Aborted, NavigateResult { error_code: 9000, error_msg })
}

/// Returns the feedback for the whole route; the feedback of the driver is for its current leg.
fn report(planner: &RoutePlanner, active: &ActiveGoal, telemetry: &Telemetry, leg: Feedback) -> Report {
    let distance = planner.distance_remaining(&active.route, telemetry);
    let (leg_m, leg_s) = (leg.distance_remaining.get(), leg.time_remaining.get());
    let remaining_s = if leg_m > 0.0 { leg_s * (distance.get() / leg_m).max(1.0) } else { leg_s };
    let navigation_s = telemetry.time.as_secs() - active.since.as_secs();
    Report { pose: telemetry.pose, navigation_s, remaining_s, recoveries: active.recoveries, distance }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::units::{BatteryShare, Seconds};
    use std::sync::atomic::{AtomicU64, Ordering};

    static NUMBER: AtomicU64 = AtomicU64::new(1);

    const ALICE: GoalUuid = [1; 16];
    const BERT: GoalUuid = [2; 16];

    /// Returns an executor for a square of lanes, 10 m a side: A – B – C – D – A.
    fn executor() -> GoalExecutor {
        let text = "{name: square, places: [{name: A, kind: other, x_m: 0, y_m: 0}, {name: B, kind: other, x_m: 10, y_m: 0}, \
            {name: C, kind: other, x_m: 10, y_m: 10}, {name: D, kind: other, x_m: 0, y_m: 10}], \
            lanes: [{between: [A, B]}, {between: [B, C]}, {between: [C, D]}, {between: [D, A]}]}";
        let planner = RoutePlanner::new(consort_world::map::read(text, "square.yaml").unwrap()).unwrap();
        let mut executor = GoalExecutor::new("ada".parse().unwrap(), Arc::new(planner), 100);
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
        };
        let goals = goals.iter().map(|(id, status)| (GoalId(*id), status.clone())).collect();
        let sequence = NUMBER.fetch_add(1, Ordering::Relaxed);
        DriverState { robot: "ada".parse().unwrap(), sequence, telemetry, goals, completed: vec![] }
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
        GoalStatus::Aborted(ActionError { code, message: "why".to_owned() })
    }

    fn at_b() -> Result<Pose, PoseError> {
        Ok(Pose::new(10.0, 0.0, 0.0))
    }

    /// Summarises actions: commands by kind and id, ends by client and code.
    fn summary(actions: &[Action]) -> Vec<String> {
        let summary = |action: &Action| match action {
            Action::Command(None) => "heartbeat".to_owned(),
            Action::Command(Some(GoalRequest::Start { id, .. })) => format!("start {}", id.0),
            Action::Command(Some(GoalRequest::Cancel { id })) => format!("cancel {}", id.0),
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
        let ended = executor.handle_state(state(&[(100, GoalStatus::Succeeded)]), s(9));
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
        assert_eq!(
            summary(&executor.handle_state(state(&[(101, GoalStatus::Succeeded)]), s(4))),
            ["end 1 Succeeded 0"]
        );
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
        assert_eq!(
            summary(&executor.handle_state(state(&[(100, aborted(ErrorCode::Blocked))]), s(2))),
            [] as [&str; 0]
        );
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
}
