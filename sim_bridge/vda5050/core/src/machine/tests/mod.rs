//! Tests of the state machine with a vehicle that executes orders as the standard prescribes.

mod cancel;
mod earlier_actions;
mod errors;
mod orders;
mod restarts;

use super::*;
use crate::cause::CauseTable;
use crate::incoming::{ActionReport, ActionStatus, Position, RemainingNode};
use crate::layout::{Layout, LayoutNode};
use crate::order_id::fingerprint;
use crate::outgoing::{Order, OrderNode};

/// A vehicle that executes orders as the standard prescribes.
#[derive(Debug, Default)]
struct FakeVehicle {
    header_id: u64,
    seconds: u64,
    order: String,
    update: u64,
    at: Option<(String, u64)>,
    ahead: Vec<OrderNode>,
    actions: Vec<ActionReport>,
    errors: Vec<VehicleError>,
    /// Number of instant actions that a vehicle of version 3.0 remembers.
    instants: usize,
    /// Ids of actions in the order of their executions.
    executed: Vec<String>,
}

impl FakeVehicle {
    fn at(node: &str) -> FakeVehicle {
        FakeVehicle { at: Some((node.to_owned(), 0)), ..FakeVehicle::default() }
    }

    fn receive(&mut self, command: &Command) {
        match command {
            Command::SendOrder(order) if order.id == self.order && order.update <= self.update => {}
            Command::SendOrder(order) => {
                if order.id != self.order {
                    (self.ahead, self.actions) = (vec![], vec![]);
                }
                (self.order, self.update) = (order.id.clone(), order.update);
                let done = if order.update == 0 { None } else { self.at.as_ref().map(|(_, sequence)| *sequence) };
                self.ahead.retain(|node| node.released);
                for node in &order.nodes {
                    let is_known = self.ahead.iter().any(|known| known.sequence == node.sequence);
                    if !is_known && done.is_none_or(|done| node.sequence > done) {
                        self.ahead.push(node.clone());
                    }
                }
                for action in order.nodes.iter().flat_map(|node| &node.actions) {
                    self.report(&action.id, ActionStatus::Waiting);
                }
                if order.update == 0 {
                    self.step();
                }
            }
            Command::SendInstant(action) => {
                if action.kind == "cancelOrder" {
                    self.ahead.clear();
                    self.actions
                        .iter_mut()
                        .filter(|own| !own.status.is_final())
                        .for_each(|own| own.status = ActionStatus::Failed);
                }
                self.executed.push(action.kind.clone());
                let goes_on = action.kind == "pick";
                self.report(&action.id, if goes_on { ActionStatus::Running } else { ActionStatus::Finished });
            }
            Command::Result { .. } | Command::Feedback { .. } => {}
        }
    }

    fn report(&mut self, id: &str, status: ActionStatus) {
        self.actions.retain(|action| action.id != id);
        self.actions.push(ActionReport { id: id.to_owned(), status, result: String::new() });
    }

    /// Drives to the next node of the base, and starts its actions.
    fn step(&mut self) {
        if self.ahead.first().is_some_and(|node| node.released) {
            let node = self.ahead.remove(0);
            self.at = Some((node.id, node.sequence));
            for action in node.actions {
                self.executed.push(action.id.clone());
                self.report(&action.id, ActionStatus::Running);
            }
        }
    }

    fn finish_actions(&mut self) {
        self.actions.iter_mut().for_each(|action| action.status = ActionStatus::Finished);
    }

    fn restart(&mut self) {
        let at = self.at.take().map(|(node, _)| (node, 0));
        *self = FakeVehicle { at, seconds: self.seconds, executed: self.executed.clone(), ..FakeVehicle::default() };
    }

    fn state(&mut self) -> VehicleState {
        self.header_id += 1;
        self.seconds += 1;
        let (last_node, last_sequence) = self.at.clone().unwrap_or_default();
        let layout = layout();
        let position = layout.node(&last_node).map(|node| Position {
            x_m: node.x_m,
            y_m: node.y_m,
            yaw_rad: 0.0,
            map: "m".to_owned(),
        });
        VehicleState {
            header_id: self.header_id,
            timestamp: format!("2026-01-01T00:00:{:02}.000Z", self.seconds),
            order: self.order.clone(),
            update: self.update,
            last_node,
            last_sequence,
            nodes: self
                .ahead
                .iter()
                .map(|node| RemainingNode { id: node.id.clone(), sequence: node.sequence, released: node.released })
                .collect(),
            edges_left: self.ahead.len(),
            is_driving: !self.ahead.is_empty(),
            position,
            charge: 0.5,
            actions: self.actions.clone(),
            instant_actions: vec![ended_action(); self.instants],
            errors: self.errors.clone(),
            mode: "AUTOMATIC".to_owned(),
            is_stopped: false,
        }
    }
}

fn ended_action() -> ActionReport {
    ActionReport { id: "ended".to_owned(), status: ActionStatus::Finished, result: String::new() }
}

fn layout() -> Layout {
    let nodes = ["a", "b", "c", "d"].into_iter().enumerate();
    let nodes =
        nodes.map(|(index, id)| (id.to_owned(), LayoutNode { x_m: index as f64 * 5.0, y_m: 0.0, yaw_rad: None }));
    let edges = [["a", "b"], ["b", "c"], ["c", "d"]].map(|edge| edge.map(str::to_owned));
    Layout::new(nodes.collect(), &edges).unwrap()
}

fn machine(release_ahead: usize) -> OrderMachine {
    let mut machine = OrderMachine::new(MachineSettings {
        layout: layout(),
        map: "m".to_owned(),
        release_ahead,
        causes: CauseTable::default(),
        retry_after: Duration::from_secs(2),
        ready_within: Duration::from_secs(10),
        silence_max: Duration::from_secs(30),
        adopt_within: Duration::from_secs(3),
        session: 1,
    });
    machine.step(Event::Broker { is_up: true }, Duration::ZERO);
    machine
}

fn seconds(time: u64) -> Duration {
    Duration::from_secs(time)
}

fn drive(to: &str) -> Work {
    Work::Drive { to: to.to_owned(), speed_max_mps: None }
}

fn act(kind: &str, is_instant: bool) -> Work {
    Work::Act { kind: kind.to_owned(), blocking: BlockingType::Hard, parameters: BTreeMap::new(), is_instant }
}

fn pick(is_instant: bool) -> Work {
    act("pick", is_instant)
}

fn goal(id: u64, work: Work) -> Event {
    let fingerprint = fingerprint(&format!("{work:?}"));
    Event::Goal { id, fingerprint, work, keep_for: seconds(1_000), since: None }
}

/// Returns a goal that an earlier process has not ended.
fn resumed(id: u64, work: Work) -> Event {
    begun_since(id, id, work)
}

/// Returns a goal that an earlier process may have begun since a goal.
fn begun_since(first: u64, id: u64, work: Work) -> Event {
    match goal(id, work) {
        Event::Goal { id, fingerprint, work, keep_for, .. } => {
            Event::Goal { id, fingerprint, work, keep_for, since: Some(first) }
        }
        other => other,
    }
}

/// Returns the vehicle after goals of an earlier process, which have ended.
fn after_goals(goals: &[(u64, Work)]) -> FakeVehicle {
    let (mut killed, mut vehicle) = (machine(3), FakeVehicle::at("a"));
    exchange(&mut killed, &mut vehicle, 1);
    for (time, (id, work)) in (2..).step_by(4).zip(goals) {
        let sent = killed.step(goal(*id, work.clone()), seconds(time));
        sent.iter().for_each(|command| vehicle.receive(command));
        (0..3).for_each(|_| vehicle.step());
        vehicle.finish_actions();
        let ended = [1, 2].map(|later| exchange(&mut killed, &mut vehicle, time + later)).concat();
        assert!(matches!(result(&ended), Some(GoalStatus::Succeeded(_))), "goal {id}: {ended:?}");
    }
    vehicle
}

/// Number of actions that the vehicle has begun for goals.
fn acted(vehicle: &FakeVehicle) -> usize {
    vehicle.executed.iter().filter(|action| action.starts_with("consort-") || *action == "pick").count()
}

/// Steps a machine with an event, and passes its commands to the vehicle.
fn send(machine: &mut OrderMachine, vehicle: &mut FakeVehicle, event: Event, time: u64) -> Vec<Command> {
    let commands = machine.step(event, seconds(time));
    commands.iter().for_each(|command| vehicle.receive(command));
    commands
}

/// Id of the first goal of the node's next process.
const NEXT: u64 = 1 << 20;

fn orders(commands: &[Command]) -> Vec<Order> {
    let order = |command: &Command| match command {
        Command::SendOrder(order) => Some(order.clone()),
        _ => None,
    };
    commands.iter().filter_map(order).collect()
}

fn cancels(commands: &[Command]) -> usize {
    commands
        .iter()
        .filter(|command| matches!(command, Command::SendInstant(action) if action.kind == "cancelOrder"))
        .count()
}

fn result(commands: &[Command]) -> Option<GoalStatus> {
    commands.iter().find_map(|command| match command {
        Command::Result { status, .. } => Some(status.clone()),
        _ => None,
    })
}

/// Passes a state to the machine, and its commands to the vehicle.
fn exchange(machine: &mut OrderMachine, vehicle: &mut FakeVehicle, time: u64) -> Vec<Command> {
    let commands = machine.step(Event::State(Box::new(vehicle.state())), seconds(time));
    commands.iter().for_each(|command| vehicle.receive(command));
    commands
}
