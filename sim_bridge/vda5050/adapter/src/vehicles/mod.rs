//! Simulated robots as vehicles of VDA 5050: a foreign fleet control drives them.
//!
//! ```text
//!  fleet control ── order, instantActions ──▶ broker ──▶ OrderExecutor (core) ──▶ robot of the world
//!                ◀── state, visualization, connection, factsheet ──            ◀──
//! ```
//!
//! Each vehicle has a connection of its own, since a last will belongs to a connection.

mod file;

use crate::driver::timestamp;
use crate::mqtt::{BrokerEvent, Publisher, Side, connect};
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_protocol::units::{MetresPerSecond, WorldTime};
use consort_skills::actions::{BackendEvent, Goal, GoalId, GoalStatus, NavigateToPose, RobotBackend as _};
use consort_vda5050_core::{
    ActivityEnd, ConnectionState, ExecutorCommand, ExecutorEvent, Malformed, OrderExecutor, Position, ReceivedNode,
    RobotCondition, Topic, connection, read_instant_actions, read_order,
};
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::future::Future;
use std::time::{Duration, SystemTime};
use tokio::sync::mpsc::{Receiver, channel};
use tokio::time::{Instant, MissedTickBehavior, interval, timeout};
use tracing::{info, warn};

pub use file::{SimulatedForm, SimulatedVehicle, VehiclesFile, VehiclesSettings};

/// Interval at which time passes in the world.
const TICK: Duration = Duration::from_millis(50);

/// Interval of states without a change. The standard allows 30 s.
const STATE_INTERVAL: Duration = Duration::from_secs(5);

/// Interval of visualizations.
const VISUALIZATION_INTERVAL: Duration = Duration::from_millis(500);

/// Time for the broker to close the connections at the end. Shorter than the pause before another attempt
/// to connect.
const CLOSE_LIMIT: Duration = Duration::from_millis(400);

/// Distance from a place within which a node is at the place, in metres.
const AT_PLACE_M: f64 = 0.25;

/// Lets the vehicles of a file act until `stop` is ready.
pub async fn run(settings: VehiclesSettings, stop: impl Future<Output = ()>) {
    let (mut site, mut broker) = Site::connect(settings);
    let mut ticks = interval(TICK);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    tokio::pin!(stop);
    loop {
        tokio::select! {
            () = &mut stop => break,
            Some((index, event)) = broker.recv() => site.receive(index, event),
            _ = ticks.tick() => site.advance(),
        }
    }
    for served in &mut site.served {
        served.publish(Topic::Connection, connection(ConnectionState::Offline, served.settings.executor.version));
        served.publisher.close();
    }
    // The broker closes a connection after it has received the messages before.
    let is_open = |index: &usize| site.served[*index].is_up;
    let mut open: BTreeSet<usize> = (0..site.served.len()).filter(is_open).collect();
    let all_closed = async {
        while !open.is_empty() {
            match broker.recv().await {
                Some((index, BrokerEvent::Down(_))) => {
                    open.remove(&index);
                }
                Some(_) => {}
                None => return,
            }
        }
    };
    if timeout(CLOSE_LIMIT, all_closed).await.is_err() {
        warn!("the broker has not closed all connections");
    }
}

/// The world and its vehicles.
struct Site {
    settings: VehiclesSettings,
    places: Vec<(PlaceId, Pose)>,
    served: Vec<Served>,
    started: Instant,
    last_goal: u64,
}

/// A vehicle on the broker.
struct Served {
    settings: SimulatedVehicle,
    executor: OrderExecutor,
    publisher: Publisher,
    is_up: bool,
    /// Numbers of messages, by topic.
    sent: BTreeMap<Topic, u32>,
    goal: Option<GoalId>,
    stated_at: Option<Instant>,
    shown_at: Option<Instant>,
    condition: RobotCondition,
}

impl Served {
    fn publish(&mut self, topic: Topic, body: Map<String, Value>) {
        // Without a connection nothing is sent; the next connection begins with a state.
        if !self.is_up {
            return;
        }
        let header_id = self.sent.entry(topic).or_default();
        let message = self.settings.vehicle.message(*header_id, &timestamp(), body);
        *header_id = header_id.wrapping_add(1);
        if let Err(problem) = self.publisher.publish(topic, &message) {
            warn!(vehicle = %self.settings.vehicle, topic = topic.level(), %problem, "not published");
        }
    }

    fn publish_state(&mut self) {
        self.stated_at = Some(Instant::now());
        let state = self.executor.state();
        self.publish(Topic::State, state);
    }

    fn publish_factsheet(&mut self) {
        let factsheet = self.executor.factsheet();
        self.publish(Topic::Factsheet, factsheet);
    }
}

impl Site {
    /// Connects every vehicle. The events of all connections arrive at one receiver, with the index of the
    /// vehicle.
    fn connect(settings: VehiclesSettings) -> (Site, Receiver<(usize, BrokerEvent)>) {
        let session = SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default().as_millis();
        let (sender, receiver) = channel(256);
        let places = settings.world.map().places().iter().map(|place| (place.id.clone(), place.pose)).collect();
        let mut served = vec![];
        for (index, simulated) in settings.vehicles.iter().enumerate() {
            let vehicle = &simulated.vehicle;
            let broken = connection(ConnectionState::Broken, simulated.executor.version);
            let last_will = vehicle.message(0, &timestamp(), broken);
            let client_id = format!("consort-vehicle-{}-{session:x}", simulated.robot.id);
            let side = Side::Vehicle { last_will: &last_will };
            let (publisher, mut events) = connect(&settings.broker, vehicle, &client_id, side);
            let sender = sender.clone();
            tokio::spawn(async move {
                while let Some(event) = events.recv().await {
                    if sender.send((index, event)).await.is_err() {
                        return;
                    }
                }
            });
            let condition = condition(&settings, simulated, None);
            let place = Some(simulated.robot.place.as_str().to_owned());
            served.push(Served {
                settings: simulated.clone(),
                executor: OrderExecutor::new(simulated.executor.clone(), condition.clone(), place),
                publisher,
                is_up: false,
                sent: BTreeMap::new(),
                goal: None,
                stated_at: None,
                shown_at: None,
                condition,
            });
        }
        (Site { settings, places, served, started: Instant::now(), last_goal: 0 }, receiver)
    }

    fn receive(&mut self, index: usize, event: BrokerEvent) {
        let served = &mut self.served[index];
        let vehicle = &served.settings.vehicle;
        let (topic, bytes) = match event {
            BrokerEvent::Up => {
                info!(%vehicle, "connected to the broker");
                served.is_up = true;
                let online = connection(ConnectionState::Online, served.settings.executor.version);
                served.publish(Topic::Connection, online);
                served.publish_state();
                served.publish_factsheet();
                return;
            }
            BrokerEvent::Down(problem) => {
                if served.is_up {
                    warn!(%vehicle, problem, "no connection to the broker; trying again");
                }
                served.is_up = false;
                return;
            }
            BrokerEvent::Message(topic, bytes) => (topic, bytes),
        };
        let refused = |problem: Malformed| {
            warn!(%vehicle, topic = topic.level(), %problem, "refused a message of fleet control");
            ExecutorEvent::Refused(problem.to_string())
        };
        let event = match topic {
            Topic::Order => read_order(vehicle, &bytes).map_or_else(refused, ExecutorEvent::Order),
            Topic::InstantActions => {
                read_instant_actions(vehicle, &bytes).map_or_else(refused, ExecutorEvent::InstantActions)
            }
            Topic::State | Topic::Visualization | Topic::Connection | Topic::Factsheet => return,
        };
        self.step(index, event);
    }

    /// Lets time pass in the world, and reports what has happened.
    fn advance(&mut self) {
        let now = WorldTime::from_secs(self.started.elapsed().as_secs_f64());
        for event in self.settings.world.advance(now) {
            let BackendEvent::GoalEnded { robot, goal, status } = event else { continue };
            let is_meant = |served: &Served| served.settings.robot.id == robot && served.goal == Some(goal);
            let Some(index) = self.served.iter().position(is_meant) else { continue };
            let end = match status {
                GoalStatus::Succeeded(result) if result.0.is_empty() => ActivityEnd::Done(String::new()),
                GoalStatus::Succeeded(result) => ActivityEnd::Done(Value::Object(result.0).to_string()),
                GoalStatus::Canceled => ActivityEnd::Stopped,
                GoalStatus::Aborted(error) => ActivityEnd::Failed(error.message),
                GoalStatus::Sent | GoalStatus::Executing(_) => continue,
            };
            self.served[index].goal = None;
            // The position at the end belongs to the same state.
            self.update_condition(index);
            self.step(index, ExecutorEvent::Ended(end));
        }
        for index in 0..self.served.len() {
            let has_moved = self.update_condition(index);
            let served = &mut self.served[index];
            if served.stated_at.is_none_or(|at| at.elapsed() >= STATE_INTERVAL) {
                served.publish_state();
            }
            if has_moved && served.shown_at.is_none_or(|at| at.elapsed() >= VISUALIZATION_INTERVAL) {
                served.shown_at = Some(Instant::now());
                let state = served.sent.get(&Topic::State).map_or(0, |next| next.saturating_sub(1));
                let body = served.executor.visualization(state);
                served.publish(Topic::Visualization, body);
            }
        }
    }

    /// Passes position and charge to the vehicle. Returns true if the robot has moved.
    fn update_condition(&mut self, index: usize) -> bool {
        let served = &self.served[index];
        let latest = condition(&self.settings, &served.settings, Some(&served.condition));
        let has_moved = latest.position != served.condition.position;
        self.served[index].condition = latest.clone();
        self.step(index, ExecutorEvent::Condition(latest));
        has_moved
    }

    /// Passes an event to the state machine of a vehicle, and performs its commands.
    fn step(&mut self, index: usize, event: ExecutorEvent) {
        let mut events = VecDeque::from([event]);
        while let Some(event) = events.pop_front() {
            for command in self.served[index].executor.step(event) {
                match command {
                    ExecutorCommand::Drive(node, speed_max_mps) => match drive(&self.places, &node, speed_max_mps) {
                        Some(goal) => self.start(index, goal),
                        None => {
                            let problem = format!("the node {:?} has no position, and no place has its name", node.id);
                            events.push_back(ExecutorEvent::Ended(ActivityEnd::Failed(problem)));
                        }
                    },
                    ExecutorCommand::Act(action) => match self.settings.goal(&action) {
                        Some(goal) => self.start(index, goal),
                        None => {
                            let problem = format!("no action {:?}", action.kind);
                            events.push_back(ExecutorEvent::Ended(ActivityEnd::Failed(problem)));
                        }
                    },
                    ExecutorCommand::Stop => {
                        let served = &self.served[index];
                        if let Some(goal) = served.goal {
                            self.settings.world.cancel(&served.settings.robot.id, goal);
                        }
                    }
                    ExecutorCommand::PublishState => self.served[index].publish_state(),
                    ExecutorCommand::PublishFactsheet => self.served[index].publish_factsheet(),
                }
            }
        }
    }

    fn start(&mut self, index: usize, goal: Goal) {
        self.last_goal += 1;
        let id = GoalId(self.last_goal);
        let served = &mut self.served[index];
        served.goal = Some(id);
        // The world reports a rejection as the end of the goal.
        self.settings.world.start(&served.settings.robot.id, id, goal);
    }
}

/// Returns the drive to a node: to the place with its name, to the place at its position, or else to the
/// position itself. `None` without a place and a position.
fn drive(places: &[(PlaceId, Pose)], node: &ReceivedNode, speed_max_mps: Option<f64>) -> Option<Goal> {
    let named = places.iter().find(|(place, _)| place.as_str() == node.id);
    let at_node = || {
        let (x_m, y_m) = node.at_m?;
        places.iter().find(|(_, pose)| (pose.x - x_m).hypot(pose.y - y_m) <= AT_PLACE_M)
    };
    let place = named.or_else(at_node);
    let pose = match place {
        Some((_, pose)) => *pose,
        None => node.at_m.map(|(x_m, y_m)| Pose::new(x_m, y_m, 0.0))?,
    };
    let pose = Pose { yaw: node.yaw_rad.unwrap_or(pose.yaw), ..pose };
    let speed_max_mps = speed_max_mps.and_then(|speed_mps| MetresPerSecond::new(speed_mps).ok());
    let place = place.map(|(place, _)| place.clone());
    Some(Goal::from(NavigateToPose { speed_max_mps, ..NavigateToPose::to(pose, place) }))
}

/// Returns position and charge of a robot.
fn condition(
    settings: &VehiclesSettings,
    simulated: &SimulatedVehicle,
    before: Option<&RobotCondition>,
) -> RobotCondition {
    let map = simulated.executor.map.clone();
    let Some(telemetry) = settings.world.telemetry(&simulated.robot.id) else {
        // Every vehicle has a robot in the world.
        let position = Position { x_m: 0.0, y_m: 0.0, yaw_rad: 0.0, map };
        return RobotCondition { position, charge: 0.0, is_charging: false };
    };
    let charge = telemetry.battery.get();
    let Pose { x: x_m, y: y_m, yaw: yaw_rad } = telemetry.pose;
    let is_charging = before.is_some_and(|before| is_charging(before, charge));
    RobotCondition { position: Position { x_m, y_m, yaw_rad, map }, charge, is_charging }
}

/// Checks whether a robot charges: its charge has grown, or is the same at the same instant.
fn is_charging(before: &RobotCondition, charge: f64) -> bool {
    charge > before.charge || before.is_charging && charge >= before.charge
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drive_goes_to_a_place_or_to_a_position() {
        let (dock, pose): (PlaceId, Pose) = ("Dock".parse().unwrap(), Pose::new(1.0, 2.0, 0.5));
        let places = [(dock.clone(), pose)];
        let to = |id: &str, at_m| {
            let (id, map, actions) = (id.to_owned(), None, vec![]);
            let node =
                ReceivedNode { id, sequence: 0, released: true, at_m, map, yaw_rad: None, deviation_m: 0.0, actions };
            drive(&places, &node, None)
        };
        let at_dock = Some(Goal::from(NavigateToPose::to(pose, Some(dock))));
        assert_eq!([to("Dock", None), to("n7", Some((1.1, 2.0)))], [at_dock.clone(), at_dock]);
        let elsewhere = Pose::new(5.0, 5.0, 0.0);
        assert_eq!(to("n7", Some((5.0, 5.0))), Some(Goal::from(NavigateToPose::to(elsewhere, None))));
        assert_eq!(to("n7", None), None, "and not to the origin of the map");
    }

    #[test]
    fn a_robot_charges_until_its_charge_falls() {
        let before = |charge, is_charging| {
            let position = Position { x_m: 0.0, y_m: 0.0, yaw_rad: 0.0, map: String::new() };
            RobotCondition { position, charge, is_charging }
        };
        let cases = [((0.5, false), 0.5), ((0.5, false), 0.6), ((0.6, true), 0.6), ((0.6, true), 0.5)];
        let found = cases.map(|((charge, charging), now)| is_charging(&before(charge, charging), now));
        // The condition is read twice at the instant at which a goal ends.
        assert_eq!(found, [false, true, true, false]);
    }
}
