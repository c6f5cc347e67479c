//! The session of a node with the driver of its robot, as a state machine: events and the time go
//! in, actions come out. It does no I/O.
//!
//! ```text
//!          spawn              hello               exit, kill
//!  Down ──────────▶ Starting ───────▶ Ready ────────────────▶ Down, with a backoff
//!                      └── no hello, wrong hello ──▶ Stopping ──┘
//! ```
//!
//! A goal that is in progress when the process ends is *interrupted*: the next process gets it
//! again with the same id (`resumed`), or it fails with the cause of the end.

mod goals;

use goals::{GoalOutcome, Goals, Progress};

use crate::contract::Contract;
use crate::messages::{DriverMessage, NodeMessage, PROTOCOL_VERSION, ResultStatus};
use consort_protocol::ids::{ActionName, PlaceId, RobotId};
use consort_protocol::pose::Pose;
use consort_protocol::scalar::Scalar;
use consort_protocol::units::{BatteryShare, Metres, Seconds};
use consort_skills::actions::{ActionError, ErrorCode, Feedback, Goal, GoalId, GoalStatus};
use consort_text::shorten;
use std::collections::BTreeMap;
use std::time::Duration;

/// Time for a process to say hello. Raised: a driver may initialise hardware for longer, and a
/// process that hangs is found later.
const HELLO_LIMIT: Duration = Duration::from_secs(10);

/// Time for which a goal waits for a process, then it fails.
const GOAL_WAIT: Duration = Duration::from_secs(5);

/// Interval of heartbeats.
const HEARTBEAT_INTERVAL: Duration = Duration::from_secs(1);

/// Time without any line after a heartbeat until a process counts as hung.
const SILENCE_LIMIT: Duration = Duration::from_secs(4);

/// Time for a driver to stop its robot after a cancel message, until its process is killed, for an action that
/// declares no other.
const STOP_LIMIT: Duration = Duration::from_secs(3);

/// Backoff after the first failure of a process; it doubles with each further one.
const BACKOFF_FIRST: Duration = Duration::from_millis(200);

/// Greatest backoff.
const BACKOFF_MAX: Duration = Duration::from_secs(30);

/// Time after which a running process makes the failures before it count no longer.
const STABLE_AFTER: Duration = Duration::from_secs(60);

/// Number of processes that may end during a goal, then it fails: the goal may be the cause.
const INTERRUPTIONS_MAX: u32 = 3;

/// Number of wrong lines of a process that are logged.
const WRONG_LINES_LOGGED: u32 = 5;

/// Maximum size of the cause of an aborted goal, in bytes.
const CAUSE_BYTES_MAX: usize = 512;

/// An event of the process.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum SessionEvent {
    /// A message of the driver.
    Message(DriverMessage),
    /// A line that is no message, with the problem.
    WrongLine(String),
    /// The driver sends more lines than allowed; they are read more slowly.
    Throttled,
    /// The process has ended or could not be started, with the cause.
    Ended(String),
}

/// An action for the caller, to be performed in the order given.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum SessionAction {
    /// Start the process. [`SessionEvent::Ended`] follows in any case.
    Spawn,
    /// Send a message to the process.
    Send(NodeMessage),
    /// Kill the process and its descendants, for this reason.
    Kill(String),
    /// Log what happened.
    Log(String),
}

/// State of the process.
#[derive(Debug, Clone, PartialEq)]
enum Phase {
    /// No process is running. The next process starts at this time.
    Down { restart_at: Duration },
    /// Started, without a hello.
    Starting { since: Duration },
    /// A hello was accepted.
    Ready { since: Duration, offer: Offer },
    /// The process was asked to end.
    Stopping,
}

/// Content of a hello.
#[derive(Debug, Clone, PartialEq)]
struct Offer {
    actions: Vec<ActionName>,
    resumes: bool,
}

/// Heartbeats of the current process.
#[derive(Debug, Clone, Default)]
struct Heartbeats {
    sequence: u64,
    sent_at: Duration,
    /// Time of the first heartbeat after the latest line.
    unanswered_since: Option<Duration>,
}

/// Robot of a session, as its driver has reported it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ReportedRobot {
    /// Pose.
    pub(crate) pose: Pose,
    /// Place that the driver named with the latest pose.
    pub(crate) place: Option<PlaceId>,
    /// Charge.
    pub(crate) charge: BatteryShare,
    /// False if the robot cannot move: the charge is too low, or the driver has no connection to it.
    pub(crate) able: bool,
    /// Latest value of each declared reading, by name.
    pub(crate) readings: BTreeMap<String, Scalar>,
}

/// The session. Times are those since its creation.
#[derive(Debug, Clone)]
pub(crate) struct DriverSession {
    robot: RobotId,
    contract: Contract,
    phase: Phase,
    /// Failures of processes in a row.
    failures: u32,
    /// Time at which the driver was last ready.
    ready_until: Option<Duration>,
    /// Cause of the latest end.
    last_end: Option<String>,
    heartbeats: Heartbeats,
    wrong_lines: u32,
    goals: Goals,
    reported: ReportedRobot,
}

impl DriverSession {
    /// Creates a session without a process; the first [`tick`](DriverSession::tick) starts it.
    pub(crate) fn new(robot: RobotId, contract: Contract, pose: Pose, charge: BatteryShare) -> DriverSession {
        DriverSession {
            robot,
            contract,
            phase: Phase::Down { restart_at: Duration::ZERO },
            failures: 0,
            ready_until: None,
            last_end: None,
            heartbeats: Heartbeats::default(),
            wrong_lines: 0,
            goals: Goals::default(),
            reported: ReportedRobot { pose, place: None, charge, able: true, readings: BTreeMap::new() },
        }
    }

    /// Returns what the driver has reported of the robot.
    pub(crate) fn reported(&self) -> &ReportedRobot {
        &self.reported
    }

    /// Checks whether the driver is ready, or was within `grace`.
    pub(crate) fn is_served(&self, now: Duration, grace: Duration) -> bool {
        matches!(self.phase, Phase::Ready { .. }) || self.ready_until.is_some_and(|until| now < until + grace)
    }

    /// Returns the status of a goal that is in progress or ended lately.
    pub(crate) fn status(&self, id: GoalId) -> Option<GoalStatus> {
        self.goals.status(id)
    }

    /// Returns the goals in progress and those that ended lately, in the order of their ids.
    pub(crate) fn goals(&self) -> Vec<GoalId> {
        self.goals.ids()
    }

    /// Returns the content of a goal that is in progress or ended lately.
    pub(crate) fn goal(&self, id: GoalId) -> Option<Goal> {
        self.goals.content(id)
    }

    /// Returns the goals that have ended since the last call.
    pub(crate) fn take_ended(&mut self) -> Vec<GoalOutcome> {
        self.goals.take_ended()
    }

    /// Checks whether ended goals wait for [`take_ended`](DriverSession::take_ended).
    pub(crate) fn has_ended_goals(&self) -> bool {
        self.goals.has_ended_goals()
    }

    /// Returns the place that the process starts at, for its start message.
    fn start_message(&self, place: &PlaceId) -> NodeMessage {
        NodeMessage::Start {
            protocol: PROTOCOL_VERSION,
            robot: self.robot.clone(),
            place: place.clone(),
            pose: self.reported.pose,
        }
    }

    /// Advances the time. `place` is the current place of the robot.
    pub(crate) fn tick(&mut self, place: &PlaceId, now: Duration) -> Vec<SessionAction> {
        self.fail_waiting_goal(now);
        match &self.phase {
            Phase::Down { restart_at } if *restart_at <= now => {
                self.phase = Phase::Starting { since: now };
                self.wrong_lines = 0;
                self.heartbeats = Heartbeats { sent_at: now, ..Heartbeats::default() };
                vec![SessionAction::Spawn, SessionAction::Send(self.start_message(place))]
            }
            Phase::Starting { since } if now.saturating_sub(*since) >= HELLO_LIMIT => {
                self.kill(format!("no hello within {} s", HELLO_LIMIT.as_secs()))
            }
            Phase::Ready { since, .. } => {
                if now.saturating_sub(*since) >= STABLE_AFTER {
                    self.failures = 0;
                }
                self.tick_ready(now)
            }
            Phase::Down { .. } | Phase::Starting { .. } | Phase::Stopping => vec![],
        }
    }

    fn tick_ready(&mut self, now: Duration) -> Vec<SessionAction> {
        self.ready_until = Some(now);
        let is_silent = |since: Duration| now.saturating_sub(since) >= SILENCE_LIMIT;
        if self.heartbeats.unanswered_since.is_some_and(is_silent) {
            return self.kill(format!("no reply to heartbeats for {} s", SILENCE_LIMIT.as_secs()));
        }
        if let Some((id, goal, since)) = self.goals.stopping() {
            let limit = self.contract.cancel_limit(&goal.action).unwrap_or(STOP_LIMIT);
            if now.saturating_sub(since) >= limit {
                return self.kill(format!("goal {} did not end within {} s of its cancel", id.0, limit.as_secs_f64()));
            }
        }
        if now.saturating_sub(self.heartbeats.sent_at) < HEARTBEAT_INTERVAL {
            return vec![];
        }
        self.heartbeats.sequence += 1;
        self.heartbeats.sent_at = now;
        self.heartbeats.unanswered_since.get_or_insert(now);
        vec![SessionAction::Send(NodeMessage::Heartbeat { sequence: self.heartbeats.sequence })]
    }

    fn kill(&mut self, reason: String) -> Vec<SessionAction> {
        self.phase = Phase::Stopping;
        vec![SessionAction::Kill(reason)]
    }

    /// Fails a goal that has waited too long for a process.
    fn fail_waiting_goal(&mut self, now: Duration) {
        let Some((id, Progress::Waiting { since })) = self.goals.current() else { return };
        if now.saturating_sub(since) >= GOAL_WAIT {
            let cause = self.last_end.as_deref().unwrap_or("it has not said hello");
            let message = format!("the driver of {} is not ready after {} s: {cause}", self.robot, GOAL_WAIT.as_secs());
            self.goals.end(id, aborted(ErrorCode::TimedOut, message));
        }
    }

    /// Handles an event of the process.
    pub(crate) fn handle(&mut self, event: SessionEvent, now: Duration) -> Vec<SessionAction> {
        match event {
            SessionEvent::Ended(how) => self.handle_end(how, now),
            SessionEvent::Throttled => {
                let what = "the driver sends too many lines; they are read more slowly".to_owned();
                vec![SessionAction::Log(what)]
            }
            SessionEvent::WrongLine(problem) => {
                self.heartbeats.unanswered_since = None;
                self.log_wrong_line(problem)
            }
            SessionEvent::Message(message) => {
                self.heartbeats.unanswered_since = None;
                self.handle_message(message, now)
            }
        }
    }

    fn log_wrong_line(&mut self, problem: String) -> Vec<SessionAction> {
        self.wrong_lines += 1;
        match self.wrong_lines {
            ..WRONG_LINES_LOGGED => vec![SessionAction::Log(problem)],
            WRONG_LINES_LOGGED => vec![SessionAction::Log(format!("{problem}; further wrong lines are not logged"))],
            _ => vec![],
        }
    }

    fn handle_end(&mut self, how: String, now: Duration) -> Vec<SessionAction> {
        let backoff = BACKOFF_FIRST.saturating_mul(1 << self.failures.min(16)).min(BACKOFF_MAX);
        self.failures += 1;
        self.phase = Phase::Down { restart_at: now + backoff };
        let log = SessionAction::Log(format!("the driver has ended: {how}; next start in {backoff:?}"));
        if let Some((id, progress)) = self.goals.current() {
            match progress {
                Progress::Stopping { .. } => self.goals.end(id, GoalStatus::Canceled),
                Progress::Active => {
                    if self.goals.interrupt(id, now) >= INTERRUPTIONS_MAX {
                        let message = format!(
                            "the driver of {} ended {INTERRUPTIONS_MAX} times during the goal: {how}",
                            self.robot
                        );
                        self.goals.end(id, aborted(ErrorCode::Failed, message));
                    }
                }
                Progress::Waiting { .. } => {}
            }
        }
        self.last_end = Some(how);
        vec![log]
    }

    fn handle_message(&mut self, message: DriverMessage, now: Duration) -> Vec<SessionAction> {
        match (&self.phase, message) {
            (Phase::Starting { .. }, DriverMessage::Hello { protocol, driver, actions, resumes }) => {
                if let Err(problem) = self.contract.check(protocol, &actions) {
                    let actions = self.kill(problem.to_string());
                    return [vec![SessionAction::Log(problem.to_string())], actions].concat();
                }
                let actions: Vec<ActionName> = actions.into_keys().collect();
                let names = actions.iter().map(ActionName::as_str).collect::<Vec<_>>().join(", ");
                let log = SessionAction::Log(format!("the driver {driver} is ready, with the actions {names}"));
                self.phase = Phase::Ready { since: now, offer: Offer { actions, resumes } };
                self.ready_until = Some(now);
                let begun = self.begin_waiting_goal(now);
                [vec![log], begun].concat()
            }
            (Phase::Starting { .. }, DriverMessage::Error { message }) => self.log_wrong_line(message),
            (Phase::Starting { .. }, _) => self.log_wrong_line("a message before the hello is ignored".to_owned()),
            (Phase::Ready { .. }, message) => self.handle_report(message),
            (Phase::Down { .. } | Phase::Stopping, message) => {
                // A result that arrives before the process ends still counts.
                match message {
                    result @ DriverMessage::Result { .. } => self.handle_report(result),
                    _ => vec![],
                }
            }
        }
    }

    fn handle_report(&mut self, message: DriverMessage) -> Vec<SessionAction> {
        match message {
            DriverMessage::Hello { .. } => return self.log_wrong_line("a second hello is ignored".to_owned()),
            DriverMessage::Feedback { id, distance_remaining_m, time_remaining_s, values } => {
                let Some(goal) = self.goals.content(id).filter(|_| self.goals.is_current(id)) else { return vec![] };
                let distance = distance_remaining_m.unwrap_or(Metres::ZERO);
                let remaining = Feedback::remaining(distance, time_remaining_s.unwrap_or(Seconds::ZERO));
                let (values, problems) = self.contract.accept_feedback(&goal.action, &values);
                self.goals.report(id, Feedback { values, ..remaining });
                return problems.iter().flat_map(|problem| self.log_wrong_line(problem.to_string())).collect();
            }
            DriverMessage::Result { id, status, code, message, results } => {
                if !self.goals.is_current(id) {
                    // Repeated results are allowed: a driver answers a repeated goal that way.
                    return vec![];
                }
                let status = match status {
                    ResultStatus::Succeeded => GoalStatus::with_result(results),
                    ResultStatus::Canceled => GoalStatus::Canceled,
                    ResultStatus::Aborted => {
                        let message =
                            shorten(message.as_deref().unwrap_or("the driver gives no cause"), CAUSE_BYTES_MAX);
                        let goal = self.goals.content(id);
                        let action = goal.as_ref().map_or("", |goal| goal.action.as_str());
                        let (error, unknown) = self.contract.failure(action, code.as_deref(), &message);
                        self.goals.end(id, GoalStatus::Aborted(error));
                        return unknown.map(|problem| self.log_wrong_line(problem)).unwrap_or_default();
                    }
                };
                self.goals.end(id, status);
            }
            DriverMessage::Pose { x_m, y_m, yaw_rad, place } => {
                self.reported.pose = Pose::new(x_m, y_m, yaw_rad);
                self.reported.place = place;
            }
            DriverMessage::Charge { share, able } => (self.reported.charge, self.reported.able) = (share, able),
            DriverMessage::Readings { values } => return self.update_readings(&values),
            DriverMessage::Heartbeat { .. } => {}
            DriverMessage::Error { message } => return self.log_wrong_line(format!("error of the driver: {message}")),
        }
        vec![]
    }

    /// Keeps the declared readings. Each other reading is logged as a wrong line.
    fn update_readings(&mut self, values: &BTreeMap<String, Scalar>) -> Vec<SessionAction> {
        let mut logs = vec![];
        for (name, value) in values {
            match self.contract.accept_reading(name, value) {
                Ok(value) => drop(self.reported.readings.insert(name.clone(), value)),
                Err(problem) => logs.extend(self.log_wrong_line(problem.to_string())),
            }
        }
        logs
    }

    /// Starts a goal. A repeated id changes nothing.
    pub(crate) fn start(&mut self, id: GoalId, goal: Goal, now: Duration) -> Vec<SessionAction> {
        if self.goals.contains(id) {
            return vec![];
        }
        let busy = self.goals.current().is_some();
        self.goals.add(id, goal, now);
        if busy {
            self.goals.end(id, rejected(ErrorCode::Busy, format!("{} has a goal in progress", self.robot)));
            return vec![];
        }
        self.begin_waiting_goal(now)
    }

    /// Sends the goal that waits, if the driver is ready.
    fn begin_waiting_goal(&mut self, now: Duration) -> Vec<SessionAction> {
        let Phase::Ready { offer, .. } = &self.phase else { return vec![] };
        let Some((id, Progress::Waiting { .. })) = self.goals.current() else { return vec![] };
        let Some(goal) = self.goals.content(id) else { return vec![] };
        let resumed = self.goals.interruptions(id) > 0;
        if resumed && !offer.resumes {
            let how = self.last_end.as_deref().unwrap_or("its process ended");
            let message =
                format!("the driver of {} ended during the goal, and does not resume goals: {how}", self.robot);
            self.goals.end(id, aborted(ErrorCode::Failed, message));
            return vec![];
        }
        if !offer.actions.contains(&goal.action) {
            let offered = offer.actions.iter().map(ActionName::as_str).collect::<Vec<_>>().join(", ");
            let message = format!("the driver of {} does not offer {}; offered: {offered}", self.robot, goal.action);
            self.goals.end(id, aborted(ErrorCode::Unknown, message));
            return vec![];
        }
        let keep_for = self.goals.permission(id, now);
        if keep_for.is_zero() {
            self.goals.end(id, GoalStatus::Canceled);
            return vec![];
        }
        let Goal { action, parameters, since, .. } = goal;
        let keep_for_ms = millis(keep_for);
        self.goals.begin(id);
        vec![SessionAction::Send(NodeMessage::Goal { id, action, parameters, keep_for_ms, resumed, since })]
    }

    /// Renews the permission of a goal, or sets it before the start.
    pub(crate) fn permit(&mut self, id: GoalId, keep_for: Duration, now: Duration) -> Vec<SessionAction> {
        self.goals.permit(id, now + keep_for);
        match (&self.phase, self.goals.current()) {
            (Phase::Ready { .. }, Some((current, Progress::Active))) if current == id => {
                vec![SessionAction::Send(NodeMessage::Keep { id, keep_for_ms: millis(keep_for) })]
            }
            _ => vec![],
        }
    }

    /// Cancels a goal. Without effect if it is not in progress.
    pub(crate) fn cancel(&mut self, id: GoalId, now: Duration) -> Vec<SessionAction> {
        match self.goals.current() {
            Some((current, Progress::Active)) if current == id => {
                self.goals.stop(id, now);
                vec![SessionAction::Send(NodeMessage::Cancel { id })]
            }
            // Without a process the robot stands still.
            Some((current, Progress::Waiting { .. })) if current == id => {
                self.goals.end(id, GoalStatus::Canceled);
                vec![]
            }
            _ => vec![],
        }
    }
}

fn aborted(code: ErrorCode, message: String) -> GoalStatus {
    GoalStatus::Aborted(ActionError::new(code, message))
}

fn rejected(code: ErrorCode, message: String) -> GoalStatus {
    GoalStatus::Aborted(ActionError::rejected(code, message))
}

fn millis(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests;
