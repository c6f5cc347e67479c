//! An order or an instant action that was sent, compared with the states of the vehicle.

use crate::cause::{Cause, CauseTable, VehicleError};
use crate::identity::Topic;
use crate::incoming::{ActionStatus, VehicleState};
use crate::layout::{Layout, LayoutNode};
use crate::order_id::OrderId;
use crate::outgoing::{Order, OrderEdge, OrderNode, VehicleAction};
use std::time::Duration;

/// Distance from a node within which a vehicle is on the node, in metres.
const ON_NODE_M: f64 = 0.5;

/// Conclusion from a state about an order or an action.
#[derive(Debug, PartialEq)]
pub(super) enum Verdict {
    /// It is under way.
    Continues,
    /// It is done.
    Succeeded(String),
    /// It ended without success; the vehicle stands still.
    Ended(Cause),
    /// It has failed; the vehicle has to be stopped.
    Fails(Cause),
    /// The vehicle does not have it.
    Absent,
}

/// A node of a route.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RouteStop {
    id: String,
    sequence: u64,
    at_m: Option<(f64, f64)>,
    yaw_rad: Option<f64>,
}

impl RouteStop {
    fn new(id: &str, index: usize, node: Option<&LayoutNode>) -> RouteStop {
        RouteStop {
            id: id.to_owned(),
            sequence: 2 * index as u64,
            at_m: node.map(|node| (node.x_m, node.y_m)),
            yaw_rad: node.and_then(|node| node.yaw_rad),
        }
    }
}

/// Where a vehicle is when it receives an order.
pub(super) struct DriveStart<'a> {
    pub(super) state: &'a VehicleState,
    pub(super) layout: &'a Layout,
    pub(super) map: &'a str,
}

impl DriveStart<'_> {
    /// Plans a route to a node, or to the node where the vehicle is.
    pub(super) fn plan(&self, target: Option<&str>) -> Result<Vec<RouteStop>, Cause> {
        let VehicleState { last_node, position, .. } = self.state;
        if let Some(position) = position.as_ref().filter(|position| position.map != self.map) {
            let message = format!("the vehicle is on the map {:?}; its places are on {:?}", position.map, self.map);
            return Err(Cause::new("no_route", message));
        }
        let at_m = position.as_ref().map(|position| (position.x_m, position.y_m));
        let nearest = at_m.and_then(|at_m| self.layout.nearest(at_m));
        let known = self.layout.node(last_node).map(|node| (last_node.as_str(), node));
        let is_on =
            |node: &LayoutNode| at_m.is_none_or(|(x_m, y_m)| (node.x_m - x_m).hypot(node.y_m - y_m) <= ON_NODE_M);
        // (first node of the route, true if the vehicle stands beside the nodes)
        let (from, is_beside) = match (known, nearest) {
            (Some((id, node)), _) if is_on(node) => (id, false),
            (_, Some((id, distance_m))) if distance_m <= ON_NODE_M => (id, false),
            // The vehicle stopped on an edge: it returns over the last node.
            (Some((id, _)), _) | (None, Some((id, _))) => (id, true),
            (None, None) => {
                let message = format!("the node {last_node:?} of the vehicle is unknown; add it to `nodes`");
                return Err(Cause::new("no_route", message));
            }
        };
        let route = match target {
            Some(to) => self.layout.route(from, to).ok_or_else(|| {
                Cause::new("no_route", format!("no edges lead from the node {from:?} to the node {to:?}"))
            })?,
            None => vec![from.to_owned()],
        };
        let mut stops: Vec<RouteStop> = vec![];
        if let Some(at_m) = at_m.filter(|_| is_beside) {
            stops.push(RouteStop { id: "here".to_owned(), sequence: 0, at_m: Some(at_m), yaw_rad: None });
        }
        if !is_beside || target.is_some() {
            let before = stops.len();
            let of_route = route.iter().enumerate();
            stops.extend(of_route.map(|(index, id)| RouteStop::new(id, before + index, self.layout.node(id))));
        }
        if let Some(first) = stops.first_mut() {
            // The vehicle need not turn where it starts.
            first.yaw_rad = None;
        }
        Ok(stops)
    }
}

/// An order that was sent.
#[derive(Debug)]
pub(super) struct OrderRun {
    id: OrderId,
    update: u64,
    stops: Vec<RouteStop>,
    /// Index of the first node of the latest message: 0, or the stitching node of an update.
    first: usize,
    /// Number of nodes of the base.
    released: usize,
    /// The action on the single node; without its content if the order was adopted.
    action: Option<(String, Option<VehicleAction>)>,
    speed_max_mps: Option<f64>,
    sent_at: Duration,
    /// First time of the latest message, which may have been repeated since.
    first_sent_at: Duration,
    /// True once the vehicle has accepted the order.
    is_known: bool,
    /// True once the vehicle has accepted the latest message.
    is_seen: bool,
    /// Errors before the order.
    known_errors: Vec<VehicleError>,
}

impl OrderRun {
    pub(super) fn new(
        id: OrderId,
        stops: Vec<RouteStop>,
        action: Option<VehicleAction>,
        speed_max_mps: Option<f64>,
        release_ahead: usize,
        state: &VehicleState,
        now: Duration,
    ) -> OrderRun {
        OrderRun {
            id,
            update: 0,
            first: 0,
            released: stops.len().min(release_ahead.max(1).saturating_add(1)),
            stops,
            action: action.map(|action| (action.id.clone(), Some(action))),
            speed_max_mps,
            sent_at: now,
            first_sent_at: now,
            is_known: false,
            is_seen: false,
            known_errors: state.errors.clone(),
        }
    }

    /// Reads back an order from the state of the vehicle.
    pub(super) fn adopt(
        id: OrderId,
        state: &VehicleState,
        has_action: bool,
        speed_max_mps: Option<f64>,
        layout: &Layout,
    ) -> OrderRun {
        let action = id.action(0);
        let stop = |id: &str, sequence: u64| RouteStop { sequence, ..RouteStop::new(id, 0, layout.node(id)) };
        let reached = state.reached();
        let is_on_order = !state.last_node.is_empty() && reached == Some(state.last_sequence);
        let last = is_on_order.then(|| stop(&state.last_node, state.last_sequence));
        let ahead = state.nodes.iter().filter(|node| last.is_none() || node.sequence > state.last_sequence);
        let released = ahead.clone().filter(|node| node.released).count() + usize::from(last.is_some());
        OrderRun {
            id,
            update: state.update,
            stops: last.clone().into_iter().chain(ahead.map(|node| stop(&node.id, node.sequence))).collect(),
            first: 0,
            released,
            known_errors: errors_without(state, &[&id.to_string(), &action]),
            action: has_action.then_some((action, None)),
            speed_max_mps,
            sent_at: Duration::ZERO,
            first_sent_at: Duration::ZERO,
            is_known: true,
            is_seen: true,
        }
    }

    pub(super) fn id(&self) -> OrderId {
        self.id
    }

    pub(super) fn sent_at(&self) -> Duration {
        self.sent_at
    }

    /// Returns the time since which the vehicle has not accepted the latest message.
    pub(super) fn unaccepted_since(&self) -> Option<Duration> {
        (!self.is_seen).then_some(self.first_sent_at)
    }

    pub(super) fn mark_sent(&mut self, now: Duration) {
        self.sent_at = now;
    }

    pub(super) fn is_seen(&self) -> bool {
        self.is_seen
    }

    pub(super) fn is_known(&self) -> bool {
        self.is_known
    }

    pub(super) fn has_action(&self) -> bool {
        self.action.is_some()
    }

    /// Returns the latest message of the order.
    pub(super) fn message(&self, map: &str) -> Order {
        let is_released = |index: usize| index < self.released;
        let indexed = self.stops.iter().enumerate().skip(self.first);
        let node = |(index, stop): (usize, &RouteStop)| OrderNode {
            id: stop.id.clone(),
            sequence: stop.sequence,
            released: is_released(index),
            at_m: stop.at_m,
            yaw_rad: stop.yaw_rad.filter(|_| index + 1 == self.stops.len()),
            actions: self.action.iter().filter_map(|(_, action)| action.clone()).collect(),
        };
        let edge = |(index, stop): (usize, &RouteStop)| OrderEdge {
            sequence: stop.sequence.saturating_sub(1),
            released: is_released(index),
            from: self.stops[index - 1].id.clone(),
            to: stop.id.clone(),
            speed_max_mps: self.speed_max_mps,
        };
        Order {
            id: self.id.to_string(),
            update: self.update,
            map: map.to_owned(),
            nodes: indexed.clone().map(node).collect(),
            edges: indexed.skip(1).map(edge).collect(),
        }
    }

    /// Releases more nodes when the vehicle has reached a node. The update begins with the last node
    /// of the base, the stitching node. Returns true if there is an update to send.
    pub(super) fn release(&mut self, reached: u64, ahead: usize, now: Duration) -> bool {
        let passed = self.stops.iter().filter(|stop| stop.sequence <= reached).count();
        let wanted = self.stops.len().min(passed.saturating_add(ahead.max(1)));
        if wanted <= self.released || self.released == 0 {
            return false;
        }
        self.first = self.released - 1;
        self.released = wanted;
        self.update += 1;
        (self.sent_at, self.first_sent_at) = (now, now);
        self.is_seen = false;
        true
    }

    /// Returns the remaining distance from the position of a state over the remaining nodes.
    pub(super) fn distance_remaining_m(&self, state: &VehicleState) -> Option<f64> {
        let mut at_m = state.position.as_ref().map(|position| (position.x_m, position.y_m))?;
        let is_of_order = state.order == self.id.to_string();
        let reached = state.reached().filter(|_| is_of_order);
        let ahead = self.stops.iter().filter(|stop| reached.is_none_or(|reached| stop.sequence > reached));
        Some(ahead.filter_map(|stop| stop.at_m).fold(0.0, |sum, next_m| {
            let leg_m = (next_m.0 - at_m.0).hypot(next_m.1 - at_m.1);
            at_m = next_m;
            sum + leg_m
        }))
    }

    /// Compares the order with a state that is younger than the latest message.
    pub(super) fn judge(&mut self, state: &VehicleState, causes: &CauseTable) -> Verdict {
        let id = self.id.to_string();
        let is_new = |error: &&VehicleError| !self.known_errors.contains(error);
        if state.order != id {
            let rejects =
                |error: &&VehicleError| error.refers_to(&id) || is_of_orders(error) && !names_other_order(error, &id);
            return match state.errors.iter().filter(is_new).find(rejects) {
                Some(error) if !self.is_known => Verdict::Ended(causes.cause(error)),
                _ => Verdict::Absent,
            };
        }
        let is_rejected = state.update < self.update;
        self.is_known = true;
        self.is_seen |= !is_rejected;
        let action = self.action.as_ref().map(|(action, _)| state.action(action));
        let has_acted = action.is_none_or(|report| report.is_some_and(|report| report.status.is_final()));
        // The result of a goal promises that the vehicle stands still.
        let is_over = state.nodes.is_empty() && state.edges_left == 0 && has_acted && !state.is_driving;
        let is_at_end = self.stops.last().is_none_or(|last| state.last_sequence >= last.sequence);
        let of_order = |error: &&VehicleError| {
            error.refers_to(&id) || self.action.as_ref().is_some_and(|(action, _)| error.refers_to(action))
        };
        let cause = || {
            let errors = || state.errors.iter().filter(is_new);
            let error = errors().find(of_order).or_else(|| errors().find(|error| error.level.ends_orders()));
            error.or_else(|| errors().next()).map(|error| causes.cause(error))
        };
        match action.flatten() {
            Some(report) if is_over && is_at_end && report.status == ActionStatus::Finished => {
                return Verdict::Succeeded(report.result.clone());
            }
            Some(report) if matches!(report.status, ActionStatus::Failed | ActionStatus::Retriable) => {
                let text = format!("the action failed: {}", report.result);
                let cause = cause().unwrap_or_else(|| Cause::new("failed", text));
                return if is_over { Verdict::Ended(cause) } else { Verdict::Fails(cause) };
            }
            None if is_over && is_at_end && self.action.is_none() => return Verdict::Succeeded(String::new()),
            _ => {}
        }
        if is_over && self.is_seen {
            let text = format!("the vehicle ended the order at the node {:?}", state.last_node);
            return Verdict::Ended(cause().unwrap_or_else(|| Cause::new("failed", text)));
        }
        let fails = |error: &&VehicleError| error.level.ends_orders() || is_rejected && of_order(error);
        match state.errors.iter().filter(is_new).find(fails) {
            Some(error) => Verdict::Fails(causes.cause(error)),
            None => Verdict::Continues,
        }
    }
}

/// Words in the types of errors by which a vehicle rejects an order, in small letters: those of 2.x, then
/// those of 3.0.
const REJECTIONS: [&str; 9] = [
    "order",
    "route",
    "validation",
    "unsupportedparameter",
    "startnode",
    "unreachable",
    "unknownmap",
    "insufficientmemory",
    "robotnotavailable",
];

/// Checks whether an error is about orders, by its type and the topic that it names. A vehicle may reject a request for its
/// state as invalid.
fn is_of_orders(error: &VehicleError) -> bool {
    let kind = error.kind_letters();
    let of_other_topic = error.references.iter().any(|(key, value)| key == "topic" && value != Topic::Order.level());
    kind != "noordertocancel" && !of_other_topic && REJECTIONS.iter().any(|word| kind.contains(word))
}

/// Checks whether an error names other orders only: a vehicle rejects a late order of another goal, too.
fn names_other_order(error: &VehicleError, id: &str) -> bool {
    let mut named = error.references.iter().filter(|(key, _)| key == "orderId").peekable();
    named.peek().is_some() && named.all(|(_, value)| value != id)
}

/// Returns the errors of a state that refer to none of some ids: those that an adopted order or action
/// has not caused.
fn errors_without(state: &VehicleState, ids: &[&str]) -> Vec<VehicleError> {
    let is_other = |error: &&VehicleError| !ids.iter().any(|id| error.refers_to(id));
    state.errors.iter().filter(is_other).cloned().collect()
}

/// An instant action that was sent.
#[derive(Debug)]
pub(super) struct ActionRun {
    id: String,
    action: Option<VehicleAction>,
    sent_at: Duration,
    first_sent_at: Duration,
    is_seen: bool,
    known_errors: Vec<VehicleError>,
}

impl ActionRun {
    pub(super) fn sent(action: VehicleAction, state: &VehicleState, now: Duration) -> ActionRun {
        let known_errors = state.errors.clone();
        let id = action.id.clone();
        ActionRun { id, action: Some(action), sent_at: now, first_sent_at: now, is_seen: false, known_errors }
    }

    /// Returns the run of an action that the vehicle already knows.
    pub(super) fn adopt(id: String, state: &VehicleState) -> Option<ActionRun> {
        state.action(&id)?;
        let known_errors = errors_without(state, &[&id]);
        let never = Duration::ZERO;
        Some(ActionRun { id, action: None, sent_at: never, first_sent_at: never, is_seen: true, known_errors })
    }

    pub(super) fn sent_at(&self) -> Duration {
        self.sent_at
    }

    pub(super) fn is_seen(&self) -> bool {
        self.is_seen
    }

    /// Returns the time since which the vehicle has not accepted the action.
    pub(super) fn unaccepted_since(&self) -> Option<Duration> {
        (!self.is_seen).then_some(self.first_sent_at)
    }

    pub(super) fn send_again(&mut self, now: Duration) -> Option<VehicleAction> {
        self.sent_at = now;
        self.action.clone()
    }

    /// Compares the action with a state that is younger than the message.
    pub(super) fn judge(&mut self, state: &VehicleState, causes: &CauseTable) -> Verdict {
        let error = state.errors.iter().find(|error| error.refers_to(&self.id) && !self.known_errors.contains(error));
        let Some(report) = state.action(&self.id) else {
            return error.map_or(Verdict::Absent, |error| Verdict::Ended(causes.cause(error)));
        };
        self.is_seen = true;
        match report.status {
            ActionStatus::Finished => Verdict::Succeeded(report.result.clone()),
            ActionStatus::Failed | ActionStatus::Retriable => {
                let text = format!("the action failed: {}", report.result);
                Verdict::Ended(error.map_or_else(|| Cause::new("failed", text), |error| causes.cause(error)))
            }
            ActionStatus::Waiting | ActionStatus::Running => Verdict::Continues,
        }
    }
}
