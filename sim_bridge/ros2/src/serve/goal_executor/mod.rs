//! Executes the ROS 2 goals of a robot, as a state machine: it takes requests, states and time, and
//! returns commands for the driver server and messages for the client. It never blocks.
//!
//! ```text
//!  request ─▶ plan ─▶ Command(Start) ─▶ states of the robot ─▶ Feedback … End
//!               ▲                          │ blocked, and a new closure is known
//!               └──────────────────────────┘
//! ```

use crate::goals::{EndState, GoalUuid};
use crate::mapping::{PoseError, UNKNOWN_ERROR, to_nav2_result};
use crate::messages::NavigateResult;
use crate::route_planner::{PlannedRoute, RoutePlanner};
use consort_fleet::robot_driver::{CLIENT_TIMEOUT, DriverCommand, DriverState, GoalRequest, Permit, StateOrder};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::lease::keep_for;
use consort_protocol::pose::Pose;
use consort_protocol::units::{Metres, NodeTime, WorldTime};
use consort_skills::actions::{ActionError, ErrorCode, Feedback, GoalId, GoalStatus, Telemetry};
use std::sync::Arc;
use std::time::Duration;

/// First goal id of this program. The ids of robot nodes are smaller, so that the goals of a
/// previous run of this program can be told from those of a robot node.
const GOALS_START: u64 = 1 << 63;

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
    /// Id of the first goal of this run for the driver.
    first: u64,
    /// Id of the next goal for the driver.
    next: u64,
    latest: Option<Telemetry>,
    order: StateOrder,
    last_state_at: Duration,
    active_goal: Option<ActiveGoal>,
    /// Next goal, started when the current goal has ended.
    waiting: Option<(GoalUuid, Pose)>,
    /// Goals in progress of a previous run of this program.
    abandoned: Vec<GoalId>,
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
    /// Creates an executor for a robot on a map. `run` is greater than in any previous run of this
    /// program, for example the milliseconds since 1970: no goal id is used twice.
    pub fn new(robot: RobotId, planner: Arc<RoutePlanner>, run: u64) -> GoalExecutor {
        let (latest, last_state_at, first) = (None, Duration::ZERO, GOALS_START | run << 20);
        GoalExecutor {
            robot,
            planner,
            first,
            next: first,
            latest,
            order: StateOrder::default(),
            last_state_at,
            active_goal: None,
            waiting: None,
            abandoned: vec![],
        }
    }

    /// Returns the command for a request. It lets the active goal continue for the client timeout,
    /// counted from the latest state.
    pub fn command(&self, request: Option<GoalRequest>, now: Duration) -> DriverCommand {
        let in_progress = self.active_goal.iter().filter(|active| !active.canceling).map(|active| active.goal);
        let (now, last_state_at) = (NodeTime::at(now), NodeTime::at(self.last_state_at));
        let keep_for = keep_for(now + CLIENT_TIMEOUT, CLIENT_TIMEOUT, last_state_at, now).unwrap_or_default();
        let keep_for_ms = u64::try_from(keep_for.as_millis()).unwrap_or(u64::MAX);
        DriverCommand {
            request,
            permit: Permit { goals: in_progress.collect(), state: self.order.newest(), keep_for_ms },
        }
    }

    /// Cancels all goals, without a result for their clients: the action server aborts them when it
    /// closes. [`is_busy`](Self::is_busy) is false when the robot has stopped.
    pub fn stop(&mut self) -> Vec<Action> {
        self.waiting = None;
        let cancel = |active: &mut ActiveGoal| {
            (active.client, active.canceling) = (None, true);
            Action::Command(Some(GoalRequest::Cancel { id: active.goal }))
        };
        self.active_goal.as_mut().map(cancel).into_iter().collect()
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
            None if self.abandoned.is_empty() => actions.extend(self.start_waiting(now)),
            // It starts when the abandoned goals have ended.
            None => {}
        }
        actions
    }

    /// Handles a cancel request of a client.
    pub fn cancel(&mut self, client: GoalUuid) -> Vec<Action> {
        if self.waiting.as_ref().is_some_and(|(waiting, _)| *waiting == client) {
            self.waiting = None;
            return vec![canceled(client)];
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
        if !self.order.accept(state.stamp) {
            return vec![];
        }
        self.last_state_at = now;
        let telemetry = state.telemetry;
        self.latest = Some(telemetry.clone());
        let is_abandoned =
            |(id, status): &&(GoalId, GoalStatus)| (GOALS_START..self.first).contains(&id.0) && !status.is_final();
        self.abandoned = state.goals.iter().filter(is_abandoned).map(|(id, _)| *id).collect();
        if !self.abandoned.is_empty() {
            let cancel = |id: &GoalId| Action::Command(Some(GoalRequest::Cancel { id: *id }));
            return self.abandoned.iter().map(cancel).collect();
        }
        let Some(active) = &mut self.active_goal else { return self.start_waiting(now) };
        let status = state.goals.into_iter().find(|(id, _)| *id == active.goal).map(|(_, status)| status);
        active.confirmed |= status.is_some();
        match status {
            Some(GoalStatus::Sent) => vec![],
            Some(GoalStatus::Executing(feedback)) => {
                let Some(client) = active.client else { return vec![] };
                vec![Action::Feedback(client, report(&self.planner, active, &telemetry, feedback))]
            }
            Some(GoalStatus::Succeeded(_)) => self.end(EndState::Succeeded, NavigateResult::default(), now),
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
        ActionError::new(code, format!("{}: {why}", self.robot))
    }

    /// Ends the current goal and starts the waiting goal.
    fn end(&mut self, how: EndState, outcome: NavigateResult, now: Duration) -> Vec<Action> {
        let client = self.active_goal.take().and_then(|active| active.client);
        let mut actions: Vec<Action> = client.map(|client| Action::End(client, how, outcome)).into_iter().collect();
        actions.extend(self.start_waiting(now));
        actions
    }
}

fn canceled(client: GoalUuid) -> Action {
    Action::End(client, EndState::Canceled, NavigateResult::default())
}

fn superseded(client: GoalUuid) -> Action {
    let error_msg = "another goal has replaced it".to_owned();
    Action::End(client, EndState::Aborted, NavigateResult { error_code: UNKNOWN_ERROR, error_msg })
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
mod tests;
