//! The state machine for the orders of one vehicle: it takes events and returns commands, and never
//! blocks. Time is the time since the start of the program.
//!
//! ```text
//!            state of the vehicle: idle             last node, all actions finished
//!  Waiting ───────────────────────────▶ Executing ───────────────────────────────▶ result
//!     ▲    an order of this goal is there    │
//!     └───── the vehicle lost a drive ───────┘
//! ```
//!
//! - An order or an instant action is sent again, with the same ids, if a state that is younger than
//!   the message does not contain it. A vehicle discards the second of two equal orders.
//! - An unfinished order of an earlier process is continued if it is for the same goal, or for an
//!   earlier goal with the same work: the node restarted. Any other unfinished order of Consort is
//!   cancelled. Orders of other masters are not touched.
//! - An action that an earlier process may have begun, and that the vehicle reports, is not ordered
//!   again, unless that process has cancelled it: its end is the result of the goal, also if an order of this
//!   process has displaced the report. If the end is unknown, the goal fails, unless the latest order of the
//!   vehicle shows that the action was not begun.
//! - A vehicle that restarts loses its order. A drive is ordered again from where the vehicle is; an
//!   action is not, since it may have happened.

mod earlier;
mod execution;
mod goal;
#[cfg(test)]
mod tests;
mod values;
mod vehicle_view;

use crate::cause::{Cause, ErrorLevel, VehicleError};
use crate::incoming::VehicleState;
use crate::order_id::{Acts, OrderId};
use crate::outgoing::{BlockingType, VehicleAction};
use earlier::{EarlierProcesses, latest_acts};
use execution::{ActionRun, DriveStart, OrderRun, Verdict};
use goal::{ActiveGoal, Phase, Stop};
use serde_json::Value;
use std::collections::BTreeMap;
use std::mem;
use std::time::Duration;
use vehicle_view::VehicleView;

pub use values::{Command, Event, GoalStatus, MachineSettings, Work};

/// Interval of feedback during a goal.
const FEEDBACK_INTERVAL: Duration = Duration::from_millis(500);

/// Number of ended instant actions in a state at which the vehicle is asked to remove them, as version 3.0
/// demands.
const INSTANTS_MAX: usize = 100;

/// Interval of these requests.
const CLEAR_INTERVAL: Duration = Duration::from_secs(60);

/// State machine for the orders of a vehicle.
#[derive(Debug)]
pub struct OrderMachine {
    settings: MachineSettings,
    view: VehicleView,
    goal: Option<ActiveGoal>,
    /// The latest ended goal: a repeated goal repeats its result.
    ended: Option<(u64, GoalStatus)>,
    stray: Option<Stray>,
    earlier: EarlierProcesses,
    /// Latest actions that this or an earlier process may have sent; none before this process has sent anything.
    acted: Acts,
    instants_sent: u64,
    cleared_at: Option<Duration>,
    is_shut_down: bool,
}

/// An unfinished order of an earlier process that no goal continues.
#[derive(Debug)]
struct Stray {
    order: OrderId,
    since: Duration,
    sent_at: Option<Duration>,
}

/// Returns why the operating mode prevents orders.
fn mode_problem(state: &VehicleState) -> Option<String> {
    let problem = || format!("is in the mode {}; allowed: AUTOMATIC, SEMIAUTOMATIC", state.mode);
    (!state.takes_orders()).then(problem)
}

fn aborted(code: &str, message: String) -> Option<GoalStatus> {
    Some(GoalStatus::Aborted(Cause::new(code, message)))
}

impl OrderMachine {
    /// Creates a machine that knows nothing about the vehicle.
    pub fn new(settings: MachineSettings) -> OrderMachine {
        OrderMachine {
            settings,
            view: VehicleView::default(),
            goal: None,
            ended: None,
            stray: None,
            earlier: EarlierProcesses::default(),
            acted: Acts::default(),
            instants_sent: 0,
            cleared_at: None,
            is_shut_down: false,
        }
    }

    /// Returns the latest state of the vehicle.
    pub fn state(&self) -> Option<&VehicleState> {
        self.view.state()
    }

    /// Checks whether no goal is in progress and no order of Consort is under way, as far as known.
    pub fn is_at_rest(&self) -> bool {
        self.goal.is_none() && self.stray.is_none()
    }

    /// Returns why the vehicle cannot execute goals; `None` if it can. Whether it is busy does not matter.
    pub fn unavailable(&self, now: Duration) -> Option<String> {
        let Some(state) = self.view.ready_state() else { return Some(self.view.problem().to_owned()) };
        if self.is_silent(Duration::ZERO, now) {
            return Some(format!("it has not reported its state for {} s", self.settings.silence_max.as_secs()));
        }
        mode_problem(state).map(|problem| format!("it {problem}"))
    }

    /// Handles an event.
    pub fn step(&mut self, event: Event, now: Duration) -> Vec<Command> {
        let mut commands = vec![];
        match event {
            Event::Goal { id, fingerprint, work, keep_for, since } => {
                let earlier = self.earlier.goals(id, fingerprint, since);
                commands.extend(self.accept(ActiveGoal {
                    id,
                    fingerprint,
                    work,
                    earlier,
                    until: now + keep_for,
                    waiting_since: now,
                    attempt: 0,
                    phase: Phase::Waiting,
                    // A goal that arrives after the shutdown is not begun.
                    stop: self.is_shut_down.then(Stop::default),
                    feedback_at: Duration::ZERO,
                }));
            }
            Event::Keep { id, keep_for } => {
                if let Some(goal) = self.goal.as_mut().filter(|goal| goal.id == id) {
                    goal.until = now + keep_for;
                }
            }
            Event::Cancel { id } => {
                if let Some(goal) = self.goal.as_mut().filter(|goal| goal.id == id) {
                    goal.stop(None);
                }
            }
            Event::Shutdown => {
                self.is_shut_down = true;
                if let Some(goal) = &mut self.goal {
                    goal.stop(None);
                }
            }
            Event::State(state) => self.view.take_state(*state, now),
            Event::Connection(connection) => self.view.take_connection(connection),
            Event::Broker { is_up } => {
                self.view.take_broker(is_up);
                if is_up {
                    commands.push(self.instant("stateRequest"));
                    commands.push(self.instant("factsheetRequest"));
                }
            }
            Event::Tick => {}
        }
        self.proceed(now, &mut commands);
        commands
    }

    fn accept(&mut self, goal: ActiveGoal) -> Option<Command> {
        if let Some((ended, status)) = self.ended.as_ref().filter(|(ended, _)| *ended == goal.id) {
            return Some(Command::Result { goal: *ended, status: status.clone() });
        }
        match &mut self.goal {
            Some(active) if active.id == goal.id => active.until = goal.until,
            Some(active) => {
                let cause = Cause::new("busy", format!("goal {} is in progress", active.id));
                return Some(Command::Result { goal: goal.id, status: GoalStatus::Aborted(cause) });
            }
            None => self.goal = Some(goal),
        }
        None
    }

    /// Creates an instant action of the protocol.
    fn instant(&mut self, kind: &str) -> Command {
        self.instants_sent += 1;
        let id = format!("consort-i{}-{}", self.settings.session, self.instants_sent);
        // The standard prescribes HARD for a cancel, and NONE for requests.
        let blocking = if kind == "cancelOrder" { BlockingType::Hard } else { BlockingType::None };
        Command::SendInstant(VehicleAction { id, kind: kind.to_owned(), blocking, parameters: BTreeMap::new() })
    }

    fn proceed(&mut self, now: Duration, commands: &mut Vec<Command>) {
        if let Some(mut goal) = self.goal.take() {
            if goal.until <= now {
                goal.stop(None);
            }
            let status = match mem::replace(&mut goal.phase, Phase::Waiting) {
                Phase::Waiting => self.begin(&mut goal, now, commands),
                Phase::Order(run) => self.follow_order(&mut goal, run, now, commands),
                Phase::Action(run) => self.follow_action(&mut goal, run, now, commands),
            };
            match status {
                Some(status) => {
                    self.ended = Some((goal.id, status.clone()));
                    commands.push(Command::Result { goal: goal.id, status });
                }
                None => {
                    if now.saturating_sub(goal.feedback_at) >= FEEDBACK_INTERVAL {
                        goal.feedback_at = now;
                        commands.push(self.feedback(&goal));
                    }
                    self.goal = Some(goal);
                }
            }
        }
        self.cancel_strays(now, commands);
        self.clear_instants(now, commands);
    }

    /// Lets the vehicle forget ended instant actions. A goal of an earlier process may still need them
    /// until this process has ended a goal.
    fn clear_instants(&mut self, now: Duration, commands: &mut Vec<Command>) {
        let is_needed = self.goal.is_some() || self.ended.is_none();
        let is_full = self.view.ready_state().is_some_and(|state| state.instant_actions.len() >= INSTANTS_MAX);
        let is_due = self.cleared_at.is_none_or(|at| now.saturating_sub(at) >= CLEAR_INTERVAL);
        if is_full && is_due && !is_needed {
            self.cleared_at = Some(now);
            if let Some(state) = self.view.ready_state() {
                self.earlier.keep_state(state);
            }
            commands.push(self.instant("clearInstantActions"));
        }
    }

    fn feedback(&self, goal: &ActiveGoal) -> Command {
        let distance = match &goal.phase {
            Phase::Order(run) if !run.has_action() => {
                self.view.state().and_then(|state| run.distance_remaining_m(state))
            }
            _ => None,
        };
        Command::Feedback { goal: goal.id, distance_remaining_m: distance }
    }

    fn request_state(&mut self, now: Duration, commands: &mut Vec<Command>) {
        if self.view.is_request_due(now, self.settings.retry_after) {
            commands.push(self.instant("stateRequest"));
        }
    }

    /// Cancels an order of the vehicle, and again until it has ended.
    fn cancel_order(
        &mut self,
        order: OrderId,
        sent_at: Option<Duration>,
        now: Duration,
        commands: &mut Vec<Command>,
    ) -> Option<Duration> {
        let is_due = sent_at.is_none_or(|sent_at| now.saturating_sub(sent_at) >= self.settings.retry_after);
        if !is_due || !self.view.is_broker_up() {
            return sent_at;
        }
        let mut cancel = self.instant("cancelOrder");
        if let Command::SendInstant(action) = &mut cancel {
            // A later order of another master is not cancelled.
            action.parameters.insert("orderId".to_owned(), Value::from(order.to_string()));
            action.id = order.cancel(self.settings.session, self.instants_sent);
        }
        commands.push(cancel);
        Some(now)
    }

    /// Begins the work, or continues an order for it, once the vehicle is ready.
    fn begin(&mut self, goal: &mut ActiveGoal, now: Duration, commands: &mut Vec<Command>) -> Option<GoalStatus> {
        let waits_too_long = now.saturating_sub(goal.waiting_since) >= self.settings.ready_within;
        let Some(state) = self.view.ready_state().cloned() else {
            if goal.stop.is_some() {
                return goal.stopped();
            }
            self.request_state(now, commands);
            let problem = self.view.problem();
            return waits_too_long.then(|| aborted("timed_out", format!("the vehicle is not ready: {problem}")))?;
        };
        let executed = state.order.parse::<OrderId>().ok().filter(|_| !state.is_idle());
        if goal.stop.is_some() && (executed.is_none() || waits_too_long) {
            return goal.stopped();
        }
        if goal.stop.is_none() && self.adopt(goal, &state) {
            if goal.earlier.is_some() {
                self.earlier.take_over(goal.fingerprint);
            }
            return None;
        }
        if goal.stop.is_some() || !state.is_idle() || state.is_stopped {
            let (code, reason) = match (executed, state.is_stopped) {
                (_, true) => ("blocked", "its emergency stop is active".to_owned()),
                (Some(order), _) if order.goal > goal.id => {
                    return aborted("busy", format!("the vehicle executes {order} for a later goal"));
                }
                _ => ("busy", format!("it executes {:?}", state.order)),
            };
            return waits_too_long.then(|| aborted(code, format!("the vehicle is not ready: {reason}")))?;
        }
        if let Some(problem) = mode_problem(&state) {
            return aborted("failed", format!("the vehicle {problem}"));
        }
        // An error of an earlier order may stay until the next order. A critical error allows another order.
        let of_orders = |text: &str| text.starts_with("consort-");
        let prevents = |error: &&VehicleError| {
            error.level >= ErrorLevel::Fatal && !error.references.iter().any(|(_, value)| of_orders(value))
        };
        if let Some(error) = state.errors.iter().find(prevents) {
            return Some(GoalStatus::Aborted(self.settings.causes.cause(error)));
        }
        if goal.earlier.is_some() && goal.attempt == 0 && matches!(goal.work, Work::Act { .. }) {
            // The earlier process may have sent the action just before its end, or the vehicle has
            // restarted since: only a state that is younger than the goal shows it.
            let is_early = now.saturating_sub(goal.waiting_since) < self.settings.retry_after;
            if is_early || !self.has_answered(goal.waiting_since) {
                self.request_state(now, commands);
                let text = "the vehicle does not report its state, which shows whether the action was begun";
                return waits_too_long.then(|| aborted("timed_out", text.to_owned()))?;
            }
            let ended = match self.earlier.verdict(goal, &state, &self.settings.causes) {
                Some(Verdict::Absent) => None,
                Some(Verdict::Succeeded(result)) => Some(GoalStatus::Succeeded(result)),
                Some(Verdict::Ended(cause)) => Some(GoalStatus::Aborted(cause)),
                Some(Verdict::Continues | Verdict::Fails(_)) | None => {
                    let text =
                        "an earlier process may have begun the action, and its end is unknown; it is not repeated";
                    return aborted("failed", text.to_owned());
                }
            };
            self.earlier.take_over(goal.fingerprint);
            if ended.is_some() {
                return ended;
            }
        }
        self.start(goal, &state, now, commands)
    }

    /// Continues what an earlier process began for this goal. Returns false if there is nothing.
    fn adopt(&mut self, goal: &mut ActiveGoal, state: &VehicleState) -> bool {
        if let Work::Act { is_instant: true, .. } = goal.work {
            let of_goal = |id: &str| OrderId::of_action(id).ok().filter(|order| goal.includes(*order));
            // The earlier process knew the ends of all but the latest.
            let latest = state.action_ids().filter_map(of_goal).max();
            let run = latest.and_then(|order| ActionRun::adopt(order.action(0), state));
            let is_known = run.is_some();
            goal.phase = run.map_or(Phase::Waiting, Phase::Action);
            return is_known;
        }
        let Ok(order) = state.order.parse::<OrderId>() else { return false };
        let is_same = goal.includes(order);
        let is_cancelled = self.stray.as_ref().is_some_and(|stray| stray.sent_at.is_some());
        // The limit of the speed of an earlier goal is unknown.
        let is_limited = matches!(goal.work, Work::Drive { speed_max_mps: Some(_), .. });
        let is_earlier_life =
            order.goal < goal.id && order.work == goal.fingerprint && !is_limited && !is_cancelled && !state.is_idle();
        // A later attempt of this process replaces an earlier order.
        if !(is_same && order.attempt >= goal.attempt || is_earlier_life) {
            return false;
        }
        let (has_action, speed_max_mps) = match goal.work {
            Work::Drive { speed_max_mps, .. } => (false, speed_max_mps),
            Work::Act { .. } => (true, None),
        };
        let run = OrderRun::adopt(order, state, has_action, speed_max_mps, &self.settings.layout);
        let at_end = match &goal.work {
            Work::Drive { to, .. } => state.last_node == *to,
            Work::Act { .. } => state.action(&order.action(0)).is_some() && !state.has_cancelled_action(order),
        };
        if state.is_idle() && !at_end {
            // A drive that ended early and a cancelled action are ordered again. An action without a report may have
            // happened.
            if !has_action || goal.earlier.is_none() || state.has_cancelled_action(order) {
                goal.attempt = order.attempt + 1;
            }
            return false;
        }
        self.stray = None;
        goal.phase = Phase::Order(run);
        true
    }

    fn start(
        &mut self,
        goal: &mut ActiveGoal,
        state: &VehicleState,
        now: Duration,
        commands: &mut Vec<Command>,
    ) -> Option<GoalStatus> {
        let acted = self.acted.max(latest_acts(state));
        let id = goal.order_id(acted);
        let (target, speed_max_mps, action) = match &goal.work {
            Work::Drive { to, speed_max_mps } => (Some(to.as_str()), *speed_max_mps, None),
            Work::Act { kind, blocking, parameters, is_instant } => {
                let action = VehicleAction {
                    id: id.action(0),
                    kind: kind.clone(),
                    blocking: *blocking,
                    parameters: parameters.clone(),
                };
                if *is_instant {
                    self.acted = id.acts_after(acted);
                    commands.push(Command::SendInstant(action.clone()));
                    goal.phase = Phase::Action(ActionRun::sent(action, state, now));
                    return None;
                }
                (None, None, Some(action))
            }
        };
        let start = DriveStart { state, layout: &self.settings.layout, map: &self.settings.map };
        let stops = match start.plan(target) {
            Ok(stops) => stops,
            Err(cause) => return Some(GoalStatus::Aborted(cause)),
        };
        if target.is_some() && stops.len() == 1 && !state.is_driving {
            return Some(GoalStatus::Succeeded(String::new()));
        }
        self.earlier.keep_state(state);
        self.acted = id.acts_after(acted);
        let run = OrderRun::new(id, stops, action, speed_max_mps, self.settings.release_ahead, state, now);
        commands.push(Command::SendOrder(run.message(&self.settings.map)));
        goal.phase = Phase::Order(run);
        None
    }

    /// Checks whether neither a message was sent nor a state arrived for too long.
    fn is_silent(&self, sent_at: Duration, now: Duration) -> bool {
        now.saturating_sub(self.view.state_at().max(sent_at)) >= self.settings.silence_max
    }

    fn silence(&self) -> Option<GoalStatus> {
        aborted("timed_out", format!("no state of the vehicle for {} s", self.settings.silence_max.as_secs()))
    }

    /// Returns the failure of a goal whose latest message the vehicle ignores, although it reports states.
    fn ignored(&self, unaccepted_since: Option<Duration>, now: Duration) -> Option<Cause> {
        let limit = self.settings.silence_max;
        let is_ignored = now.saturating_sub(unaccepted_since?) >= limit;
        let text = format!("the vehicle has not accepted the order or action for {} s", limit.as_secs());
        is_ignored.then(|| Cause::new("timed_out", text))
    }

    /// Checks whether a state arrived so long after a message that the vehicle had received it.
    fn has_answered(&self, sent_at: Duration) -> bool {
        self.view.state_after(sent_at + self.settings.retry_after / 2).is_some()
    }

    fn follow_order(
        &mut self,
        goal: &mut ActiveGoal,
        mut run: OrderRun,
        now: Duration,
        commands: &mut Vec<Command>,
    ) -> Option<GoalStatus> {
        if self.is_silent(run.sent_at(), now) {
            return self.silence();
        }
        let verdict = match self.view.state_after(run.sent_at()) {
            Some(state) => run.judge(state, &self.settings.causes),
            None => Verdict::Continues,
        };
        let is_cancelled = |state: &VehicleState| goal.stop.is_none() && state.has_cancelled(run.id());
        match verdict {
            Verdict::Succeeded(result) => return Some(GoalStatus::Succeeded(result)),
            // An earlier process has sent the cancel: its node was stopped.
            Verdict::Ended(_) | Verdict::Fails(_) if self.view.state().is_some_and(is_cancelled) => {
                if self.view.state().is_some_and(VehicleState::is_idle) {
                    goal.attempt = run.id().attempt + 1;
                    goal.waiting_since = now;
                    return None;
                }
            }
            Verdict::Ended(cause) => return goal.stopped().or(Some(GoalStatus::Aborted(cause))),
            Verdict::Fails(cause) => goal.stop(Some(cause)),
            Verdict::Absent if goal.stop.is_some() => {
                let sent_at = goal.stop.as_ref().and_then(|stop| stop.sent_at);
                if run.is_known() || sent_at.is_some_and(|sent_at| self.view.state_after(sent_at).is_some()) {
                    return goal.stopped();
                }
                self.request_state(now, commands);
            }
            Verdict::Absent if run.is_known() => {
                if run.has_action() {
                    let text = "the vehicle restarted during the action, which is not repeated";
                    return aborted("failed", text.to_owned());
                }
                goal.attempt = run.id().attempt + 1;
                goal.waiting_since = now;
                return None;
            }
            Verdict::Absent | Verdict::Continues => {}
        }
        if let Some(cause) = self.ignored(run.unaccepted_since(), now) {
            goal.stop(Some(cause));
        }
        if let Some(stop) = &mut goal.stop {
            stop.sent_at = self.cancel_order(run.id(), stop.sent_at, now, commands);
        } else {
            let reached = self.view.state_after(run.sent_at()).and_then(VehicleState::reached);
            if run.is_seen() && reached.is_some_and(|reached| run.release(reached, self.settings.release_ahead, now)) {
                commands.push(Command::SendOrder(run.message(&self.settings.map)));
            } else if !run.is_seen() && now.saturating_sub(run.sent_at()) >= self.settings.retry_after {
                if self.has_answered(run.sent_at()) {
                    run.mark_sent(now);
                    commands.push(Command::SendOrder(run.message(&self.settings.map)));
                } else {
                    self.request_state(now, commands);
                }
            }
        }
        goal.phase = Phase::Order(run);
        None
    }

    fn follow_action(
        &mut self,
        goal: &mut ActiveGoal,
        mut run: ActionRun,
        now: Duration,
        commands: &mut Vec<Command>,
    ) -> Option<GoalStatus> {
        if self.is_silent(run.sent_at(), now) {
            return self.silence();
        }
        let verdict = match self.view.state_after(run.sent_at()) {
            Some(state) => run.judge(state, &self.settings.causes),
            None => Verdict::Continues,
        };
        match verdict {
            Verdict::Succeeded(result) => return Some(GoalStatus::Succeeded(result)),
            Verdict::Ended(cause) | Verdict::Fails(cause) => {
                return goal.stopped().or(Some(GoalStatus::Aborted(cause)));
            }
            Verdict::Absent if run.is_seen() => {
                let text = "the vehicle restarted during the action, which is not repeated";
                return aborted("failed", text.to_owned());
            }
            Verdict::Absent if goal.stop.is_some() => {
                // The vehicle does not know the action, and it is not sent again.
                if self.has_answered(run.sent_at()) {
                    return goal.stopped();
                }
                self.request_state(now, commands);
            }
            Verdict::Absent | Verdict::Continues => {}
        }
        if let Some(cause) = self.ignored(run.unaccepted_since(), now) {
            goal.stop(Some(cause));
        }
        if !run.is_seen() && goal.stop.is_none() && now.saturating_sub(run.sent_at()) >= self.settings.retry_after {
            if self.has_answered(run.sent_at()) {
                commands.extend(run.send_again(now).map(Command::SendInstant));
            } else {
                self.request_state(now, commands);
            }
        }
        goal.phase = Phase::Action(run);
        None
    }

    fn cancel_strays(&mut self, now: Duration, commands: &mut Vec<Command>) {
        let own = match self.goal.as_ref().map(|goal| &goal.phase) {
            Some(Phase::Order(run)) => Some(run.id()),
            _ => None,
        };
        let unfinished = self.view.state().filter(|state| !state.is_idle());
        let order =
            unfinished.and_then(|state| state.order.parse::<OrderId>().ok()).filter(|order| Some(*order) != own);
        let Some(order) = order else {
            self.stray = None;
            return;
        };
        let known = self.stray.take().filter(|stray| stray.order == order);
        let stray = known.unwrap_or(Stray { order, since: now, sent_at: None });
        let is_over = now.saturating_sub(stray.since) >= self.settings.adopt_within;
        // An order for a later goal belongs to another adapter, which has taken over.
        let is_later = self.goal.as_ref().is_some_and(|goal| order.goal > goal.id);
        let sent_at = if !is_later && (self.goal.is_some() || self.is_shut_down || is_over) {
            self.cancel_order(order, stray.sent_at, now, commands)
        } else {
            stray.sent_at
        };
        self.stray = Some(Stray { sent_at, ..stray });
    }
}
