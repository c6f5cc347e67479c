//! The vehicle side: a state machine that executes the orders and instant actions of a fleet control with a
//! robot. It takes events and returns commands, and never blocks.
//!
//! ```text
//!  fleet control ── order, instant actions ──▶ OrderExecutor ── drive, act, stop ──▶ robot
//!                ◀── state, factsheet ────────               ◀── end, position ────
//! ```
//!
//! The robot does a single thing at a time, so it stands during every action. The standard allows more
//! for the blocking types `NONE` and `SOFT`, and demands nothing. Actions on edges are rejected.
//!
//! An action or a drive that fails stops the order, which waits for a `cancelOrder`.

mod report;
#[cfg(test)]
mod tests;
mod values;

use crate::cause::{ErrorLevel, VehicleError};
use crate::identity::Version;
use crate::incoming::{ActionStatus, Position};
use crate::outgoing::VehicleAction;
use crate::received::{ReceivedEdge, ReceivedNode, ReceivedOrder};
use serde_json::Value;
use std::collections::VecDeque;
use std::mem;
use values::Rejection;

pub use report::connection;
pub use values::{ActivityEnd, ExecutorCommand, ExecutorEvent, ExecutorSettings, RobotCondition};

/// Distance from a node without an allowed deviation within which the robot is on the node, in metres.
const ON_NODE_M: f64 = 0.5;

/// Number of errors in the state; the oldest are dropped. Each rejected message adds one.
const ERRORS_MAX: usize = 20;

/// Number of instant actions in the state; the oldest are dropped.
const INSTANTS_MAX: usize = 200;

/// Executes the orders of a vehicle.
#[derive(Debug)]
pub struct OrderExecutor {
    settings: ExecutorSettings,
    condition: RobotCondition,
    progress: OrderProgress,
    instants: Vec<ExecutedAction>,
    errors: Vec<VehicleError>,
    activity: Option<Activity>,
    /// True after a `cancelOrder` until the robot has stopped.
    is_cancelling: bool,
    /// Id of a `startPause` that waits for the robot to stop.
    pause: Option<String>,
    is_paused: bool,
    /// True after a failure, until the order is cancelled.
    is_stuck: bool,
    has_changed: bool,
}

/// The latest order, and what is left of it.
#[derive(Debug, Default)]
struct OrderProgress {
    id: String,
    update: u64,
    /// The latest accepted message.
    received: Option<ReceivedOrder>,
    is_cancelled: bool,
    last_node: String,
    last_sequence: u64,
    nodes: VecDeque<ReceivedNode>,
    edges: VecDeque<ReceivedEdge>,
    /// Actions of reached nodes that have not begun.
    queue: VecDeque<VehicleAction>,
    actions: Vec<ExecutedAction>,
}

/// An action, as the state contains it.
#[derive(Debug, Clone, PartialEq, Eq)]
struct ExecutedAction {
    id: String,
    kind: String,
    status: ActionStatus,
    result: String,
}

impl ExecutedAction {
    fn new(action: &VehicleAction, status: ActionStatus) -> ExecutedAction {
        ExecutedAction { id: action.id.clone(), kind: action.kind.clone(), status, result: String::new() }
    }
}

/// What the robot does.
#[derive(Debug)]
enum Activity {
    Drive,
    Action { id: String, is_instant: bool },
}

/// What becomes of a received order.
#[derive(Debug, PartialEq, Eq)]
enum Acceptance {
    New,
    Update,
    Repeated,
}

impl OrderProgress {
    fn is_idle(&self) -> bool {
        self.nodes.is_empty() && self.edges.is_empty() && self.actions.iter().all(|action| action.status.is_final())
    }

    /// Returns the last node of the base: an update begins with it.
    fn decision_point(&self) -> (&str, u64) {
        let last_ahead = self.nodes.iter().rev().find(|node| node.released);
        last_ahead.map_or((self.last_node.as_str(), self.last_sequence), |node| (node.id.as_str(), node.sequence))
    }

    fn begin(&mut self, order: ReceivedOrder) {
        *self = OrderProgress {
            received: Some(order.clone()),
            id: order.id,
            update: order.update,
            last_node: mem::take(&mut self.last_node),
            last_sequence: self.last_sequence,
            edges: order.edges.into(),
            ..OrderProgress::default()
        };
        self.add(order.nodes);
        // The robot stands on the first node.
        self.pass_node();
    }

    /// Replaces the horizon. The update repeats the last node of the base.
    fn extend(&mut self, order: ReceivedOrder) {
        let dropped = self.nodes.iter().filter(|node| !node.released).flat_map(|node| &node.actions);
        let dropped: Vec<&String> = dropped.map(|action| &action.id).collect();
        self.actions.retain(|action| !dropped.contains(&&action.id));
        self.nodes.retain(|node| node.released);
        self.edges.retain(|edge| edge.released);
        self.update = order.update;
        self.received = Some(order.clone());
        self.edges.extend(order.edges);
        self.add(order.nodes.into_iter().skip(1));
    }

    fn add(&mut self, nodes: impl IntoIterator<Item = ReceivedNode>) {
        for node in nodes {
            let waiting = |action: &VehicleAction| ExecutedAction::new(action, ActionStatus::Waiting);
            self.actions.extend(node.actions.iter().map(waiting));
            self.nodes.push_back(node);
        }
    }

    /// Passes the next node, and queues its actions.
    fn pass_node(&mut self) {
        let Some(node) = self.nodes.pop_front() else { return };
        // The edge that leads to the node; the first node has none.
        if self.edges.front().is_some_and(|edge| edge.sequence < node.sequence) {
            self.edges.pop_front();
        }
        (self.last_node, self.last_sequence) = (node.id, node.sequence);
        self.queue.extend(node.actions);
    }

    /// Ends the order: nothing is left of it, and actions that have not begun have failed.
    fn clear(&mut self) {
        self.nodes.clear();
        self.edges.clear();
        self.give_up_actions();
        self.is_cancelled = true;
    }

    fn give_up_actions(&mut self) {
        self.queue.clear();
        for action in self.actions.iter_mut().filter(|action| action.status == ActionStatus::Waiting) {
            action.status = ActionStatus::Failed;
        }
    }
}

impl OrderExecutor {
    /// Creates an executor for a robot without an order, at a node or beside all of them.
    pub fn new(settings: ExecutorSettings, condition: RobotCondition, node: Option<String>) -> OrderExecutor {
        OrderExecutor {
            settings,
            condition,
            progress: OrderProgress { last_node: node.unwrap_or_default(), ..OrderProgress::default() },
            instants: vec![],
            errors: vec![],
            activity: None,
            is_cancelling: false,
            pause: None,
            is_paused: false,
            is_stuck: false,
            has_changed: false,
        }
    }

    /// Handles an event.
    pub fn step(&mut self, event: ExecutorEvent) -> Vec<ExecutorCommand> {
        let mut commands = vec![];
        match event {
            ExecutorEvent::Order(order) => self.receive_order(order),
            ExecutorEvent::InstantActions(actions) => {
                for action in &actions {
                    self.receive_instant(action, &mut commands);
                }
            }
            ExecutorEvent::Refused(problem) => self.reject(Rejection::Malformed, problem, &[]),
            ExecutorEvent::Condition(condition) => {
                self.has_changed |= condition.is_charging != self.condition.is_charging;
                self.condition = condition;
            }
            ExecutorEvent::Ended(end) => self.end_activity(end),
        }
        self.proceed(&mut commands);
        if mem::take(&mut self.has_changed) {
            commands.push(ExecutorCommand::PublishState);
        }
        commands
    }

    fn receive_order(&mut self, order: ReceivedOrder) {
        let references = [("orderId", order.id.clone()), ("orderUpdateId", order.update.to_string())];
        match self.check(&order) {
            Ok(Acceptance::Repeated) => return,
            Ok(Acceptance::New) => {
                self.progress.begin(order);
                self.is_stuck = false;
                // Before version 3.0 the ended instant actions are kept until a new order.
                if self.settings.version < Version::V3_0 {
                    self.instants.retain(|action| !action.status.is_final());
                }
            }
            Ok(Acceptance::Update) => self.progress.extend(order),
            Err((rejection, problem)) => return self.reject(rejection, problem, &references),
        }
        self.errors.retain(|error| self.is_stuck && error.level.ends_orders());
        self.has_changed = true;
    }

    fn check(&self, order: &ReceivedOrder) -> Result<Acceptance, (Rejection, String)> {
        let progress = &self.progress;
        let (Some(first), None) = (order.nodes.first(), order.problem()) else {
            return Err((Rejection::Malformed, order.problem().unwrap_or_default()));
        };
        let acceptance = if order.id == progress.id && !order.id.is_empty() {
            if order.update < progress.update {
                return Err((Rejection::OutdatedUpdate, format!("the latest update is {}", progress.update)));
            }
            if order.update == progress.update {
                let is_equal = progress.received.as_ref() == Some(order);
                if self.settings.version < Version::V3_0 || is_equal {
                    return Ok(Acceptance::Repeated);
                }
                let problem = "its content differs from that of the message with the same number".to_owned();
                return Err((Rejection::UnequalRepetition, problem));
            }
            if progress.is_cancelled || self.is_cancelling {
                return Err((Rejection::UpdateAfterCancel, "the order was cancelled".to_owned()));
            }
            let (node, sequence) = progress.decision_point();
            if (first.id.as_str(), first.sequence) != (node, sequence) {
                let problem = format!("the base ends at the node {node:?} with the sequenceId {sequence}");
                return Err((Rejection::NoContinuation, problem));
            }
            Acceptance::Update
        } else {
            if !progress.is_idle() {
                return Err((Rejection::Busy, format!("the order {:?} has not ended", progress.id)));
            }
            if order.update != 0 && self.settings.version == Version::V3_0 {
                return Err((Rejection::Malformed, "a new order begins with the orderUpdateId 0".to_owned()));
            }
            if !self.is_on(first) {
                return Err((Rejection::StartOutOfRange, format!("the vehicle is not on the node {:?}", first.id)));
            }
            Acceptance::New
        };
        let is_elsewhere = |node: &&ReceivedNode| node.map.as_ref().is_some_and(|map| *map != self.settings.map);
        if let Some(node) = order.nodes.iter().find(is_elsewhere) {
            let problem = format!("the node {:?} is not on the map {:?}", node.id, self.settings.map);
            return Err((Rejection::UnknownMap, problem));
        }
        let mut actions = order.nodes.iter().flat_map(|node| &node.actions);
        if let Some(action) = actions.find(|action| !self.settings.actions.contains(&action.kind)) {
            return Err((Rejection::UnsupportedAction, format!("no action {:?} on nodes", action.kind)));
        }
        if let Some(edge) = order.edges.iter().find(|edge| edge.has_actions) {
            return Err((Rejection::UnsupportedAction, format!("no actions on edges: {:?}", edge.id)));
        }
        Ok(acceptance)
    }

    fn is_on(&self, node: &ReceivedNode) -> bool {
        let Position { x_m, y_m, .. } = self.condition.position;
        let limit_m = node.deviation_m.max(ON_NODE_M);
        match node.at_m {
            Some(at_m) => (at_m.0 - x_m).hypot(at_m.1 - y_m) <= limit_m,
            None => node.id == self.progress.last_node,
        }
    }

    fn reject(&mut self, rejection: Rejection, description: String, references: &[(&str, String)]) {
        self.report(rejection.kind(self.settings.version), ErrorLevel::Warning, description, references);
    }

    fn report(&mut self, kind: &str, level: ErrorLevel, description: String, references: &[(&str, String)]) {
        let references = references.iter().map(|(key, value)| ((*key).to_owned(), value.clone())).collect();
        let error = VehicleError { kind: kind.to_owned(), level, description, references };
        if !self.errors.contains(&error) {
            self.errors.push(error);
            if self.errors.len() > ERRORS_MAX {
                self.errors.remove(0);
            }
            self.has_changed = true;
        }
    }

    fn receive_instant(&mut self, action: &VehicleAction, commands: &mut Vec<ExecutorCommand>) {
        if self.instants.iter().chain(&self.progress.actions).any(|known| known.id == action.id) {
            return;
        }
        self.has_changed = true;
        let status = match action.kind.as_str() {
            "cancelOrder" => self.cancel_order(action, commands),
            "startPause" => {
                self.is_paused = true;
                match self.activity {
                    Some(Activity::Drive) => {
                        if let Some(earlier) = self.pause.replace(action.id.clone()) {
                            self.set_action(&earlier, ActionStatus::Finished, String::new());
                        }
                        commands.push(ExecutorCommand::Stop);
                        ActionStatus::Running
                    }
                    _ => ActionStatus::Finished,
                }
            }
            "stopPause" => {
                self.is_paused = false;
                ActionStatus::Finished
            }
            "stateRequest" => ActionStatus::Finished,
            "factsheetRequest" => {
                commands.push(ExecutorCommand::PublishFactsheet);
                ActionStatus::Finished
            }
            "clearInstantActions" => {
                self.instants.retain(|action| !action.status.is_final());
                ActionStatus::Finished
            }
            kind if self.settings.actions.contains(kind) && self.activity.is_none() => {
                self.activity = Some(Activity::Action { id: action.id.clone(), is_instant: true });
                commands.push(ExecutorCommand::Act(action.clone()));
                ActionStatus::Running
            }
            kind => {
                let problem = match self.settings.actions.contains(kind) {
                    true => format!("the action {kind:?} has to wait: the vehicle drives or acts"),
                    false => format!("no instant action {kind:?}"),
                };
                self.reject(Rejection::InstantAction, problem, &[("actionId", action.id.clone())]);
                ActionStatus::Failed
            }
        };
        self.instants.push(ExecutedAction::new(action, status));
        if self.instants.len() > INSTANTS_MAX {
            self.instants.remove(0);
        }
    }

    fn cancel_order(&mut self, action: &VehicleAction, commands: &mut Vec<ExecutorCommand>) -> ActionStatus {
        let named = action.parameters.get("orderId").and_then(Value::as_str);
        let is_other = named.is_some_and(|order| order != self.progress.id);
        if is_other || self.progress.is_idle() {
            let problem = "no order is under way, or another one".to_owned();
            self.reject(Rejection::NothingToCancel, problem, &[("actionId", action.id.clone())]);
            return ActionStatus::Failed;
        }
        let acts = matches!(self.activity, Some(Activity::Drive | Activity::Action { is_instant: false, .. }));
        if acts && !self.is_cancelling {
            commands.push(ExecutorCommand::Stop);
        }
        self.is_cancelling = true;
        self.progress.give_up_actions();
        ActionStatus::Running
    }

    fn end_activity(&mut self, end: ActivityEnd) {
        self.has_changed = true;
        match self.activity.take() {
            Some(Activity::Drive) => self.end_drive(end),
            Some(Activity::Action { id, is_instant }) => self.end_action(&id, is_instant, end),
            None => {}
        }
    }

    fn end_drive(&mut self, end: ActivityEnd) {
        match end {
            ActivityEnd::Done(_) => {
                self.progress.pass_node();
                if self.is_cancelling {
                    self.progress.give_up_actions();
                }
            }
            // The robot drives on after the pause.
            ActivityEnd::Stopped => {}
            ActivityEnd::Failed(_) if self.is_cancelling => {}
            ActivityEnd::Failed(cause) => {
                let kind = if self.settings.version == Version::V3_0 { "NODE_UNREACHABLE" } else { "driveError" };
                let node = self.progress.nodes.front().map(|node| node.id.clone()).unwrap_or_default();
                let references = [("orderId", self.progress.id.clone()), ("nodeId", node)];
                self.report(kind, ErrorLevel::Critical, cause, &references);
                self.is_stuck = true;
            }
        }
    }

    fn end_action(&mut self, id: &str, is_instant: bool, end: ActivityEnd) {
        let (status, result, failure) = match end {
            ActivityEnd::Done(result) => (ActionStatus::Finished, result, None),
            ActivityEnd::Stopped => (ActionStatus::Failed, "the vehicle was stopped".to_owned(), None),
            ActivityEnd::Failed(cause) => (ActionStatus::Failed, cause.clone(), Some(cause)),
        };
        self.set_action(id, status, result);
        let Some(cause) = failure else { return };
        if is_instant || self.is_cancelling {
            self.report("actionError", ErrorLevel::Warning, cause, &[("actionId", id.to_owned())]);
            return;
        }
        let references = [("orderId", self.progress.id.clone()), ("actionId", id.to_owned())];
        self.report("actionError", ErrorLevel::Critical, cause, &references);
        self.is_stuck = !self.progress.is_idle();
    }

    fn set_action(&mut self, id: &str, status: ActionStatus, result: String) {
        let mut known = self.instants.iter_mut().chain(&mut self.progress.actions);
        if let Some(action) = known.find(|action| action.id == id) {
            (action.status, action.result) = (status, result);
            self.has_changed = true;
        }
    }

    /// Ends a cancel and a pause for which the robot had to stop, and begins the next activity.
    fn proceed(&mut self, commands: &mut Vec<ExecutorCommand>) {
        let has_stopped = matches!(self.activity, None | Some(Activity::Action { is_instant: true, .. }));
        if has_stopped && self.is_cancelling {
            self.progress.clear();
            self.is_stuck = false;
            self.errors.retain(|error| !error.level.ends_orders());
            // Fleet control may have repeated the action.
            let is_cancel =
                |action: &&mut ExecutedAction| action.kind == "cancelOrder" && action.status == ActionStatus::Running;
            for cancel in self.instants.iter_mut().filter(is_cancel) {
                cancel.status = ActionStatus::Finished;
            }
            (self.is_cancelling, self.has_changed) = (false, true);
        }
        if !matches!(self.activity, Some(Activity::Drive))
            && let Some(pause) = self.pause.take()
        {
            self.set_action(&pause, ActionStatus::Finished, String::new());
        }
        if self.activity.is_some() || self.is_paused || self.is_stuck {
            return;
        }
        if let Some(action) = self.progress.queue.pop_front() {
            self.set_action(&action.id, ActionStatus::Running, String::new());
            self.activity = Some(Activity::Action { id: action.id.clone(), is_instant: false });
            commands.push(ExecutorCommand::Act(action));
        } else if let Some(node) = self.progress.nodes.front().filter(|node| node.released) {
            let speed_max_mps = self.progress.edges.front().and_then(|edge| edge.speed_max_mps);
            commands.push(ExecutorCommand::Drive(node.clone(), speed_max_mps));
            self.activity = Some(Activity::Drive);
            self.has_changed = true;
        }
    }
}
