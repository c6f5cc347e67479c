//! The driver: performs the commands of the state machine, and passes events on to it.

use crate::catalog::{ActionForm, GoalError};
use crate::file::VehicleSettings;
use crate::lines::{Input, NodeLine, Output, permission, read_input};
use crate::mqtt::{BrokerEvent, Publisher, Side, connect};
use consort_vda5050_core::{
    Command, Event, GoalStatus, Malformed, OrderMachine, Position, Topic, VehicleError, VehicleState, instant_actions,
    read_connection, read_factsheet, read_state, read_visualization,
};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::time::{Duration, Instant, SystemTime};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;
use tokio::time::{MissedTickBehavior, interval};
use tracing::{info, warn};

/// Interval of the clock of the state machine.
const TICK: Duration = Duration::from_millis(100);

/// Interval of reports to the node.
const REPORT_INTERVAL: Duration = Duration::from_millis(500);

/// Time for the vehicle to confirm that it stops when the driver ends. The node kills the process after 3 s.
const STOP_LIMIT: Duration = Duration::from_millis(2_500);

/// Maximum size of the results of a goal as JSON, in bytes, as in the node.
const RESULTS_BYTES_MAX: usize = 512;

/// Number of refused messages of each topic that are logged.
const REFUSALS_LOGGED: u64 = 5;

/// Runs the driver on the standard streams until its input ends.
pub async fn run(settings: VehicleSettings) {
    let mut driver = Driver::new(&settings);
    let mut input = read_input();
    let (publisher, mut broker) = connect(&settings.broker, &settings.vehicle, &driver.client_id(), Side::FleetControl);
    driver.output.send(
        "hello",
        json!({
            "protocol": 1, "driver": format!("consort-vda5050 {}, VDA 5050 {}, {}", env!("CARGO_PKG_VERSION"), settings.vehicle.version(), settings.vehicle),
            "actions": settings.catalog.offered(), "resumes": true,
        }),
    );
    let mut ticks = interval(TICK);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut stop_by = None;
    loop {
        let commands = tokio::select! {
            Some(message) = input.recv() => match driver.read(message) {
                Received::Event(event) => driver.step(*event),
                Received::Nothing => continue,
                Received::End => {
                    stop_by.get_or_insert(Instant::now() + STOP_LIMIT);
                    driver.step(Event::Shutdown)
                }
            },
            Some(event) = broker.recv() => match driver.receive(event) {
                Some(event) => driver.step(event),
                None => continue,
            },
            _ = ticks.tick() => driver.step(Event::Tick),
        };
        driver.perform(commands, &publisher);
        driver.report();
        if let Some(limit) = stop_by
            && (driver.machine.is_at_rest() || Instant::now() >= limit)
        {
            break;
        }
    }
    publisher.close();
    // Gives the writer and the connection the time to end.
    tokio::time::sleep(Duration::from_millis(100)).await;
    info!(refused = ?driver.refused, "the driver has ended");
}

enum Received {
    Event(Box<Event>),
    Nothing,
    End,
}

struct Driver<'a> {
    settings: &'a VehicleSettings,
    machine: OrderMachine,
    output: Output,
    started: Instant,
    session: u64,
    is_broker_up: bool,
    /// Why there is no connection to the broker, as logged.
    broker_problem: String,
    /// Numbers of messages, by topic.
    sent: BTreeMap<Topic, u32>,
    /// Numbers of refused messages, by topic.
    refused: BTreeMap<&'static str, u64>,
    /// The actions of the goals without a result, by goal.
    actions: BTreeMap<u64, String>,
    position: Option<Position>,
    /// Why the robot is out of service, as logged.
    problem: Option<String>,
    reported_at: Option<Instant>,
    has_news: bool,
}

impl<'a> Driver<'a> {
    fn new(settings: &'a VehicleSettings) -> Driver<'a> {
        let since_1970 = SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default();
        let session = u64::try_from(since_1970.as_millis()).unwrap_or_default();
        Driver {
            settings,
            machine: OrderMachine::new(settings.machine(session)),
            output: Output::start(),
            started: Instant::now(),
            session,
            is_broker_up: false,
            broker_problem: String::new(),
            sent: BTreeMap::new(),
            refused: BTreeMap::new(),
            actions: BTreeMap::new(),
            position: None,
            problem: None,
            reported_at: None,
            has_news: false,
        }
    }

    fn client_id(&self) -> String {
        format!("consort-{}-{:x}", self.settings.vehicle.to_string().replace('/', "-"), self.session)
    }

    fn step(&mut self, event: Event) -> Vec<Command> {
        self.machine.step(event, self.started.elapsed())
    }

    /// Reads a line of the node.
    fn read(&mut self, input: Input) -> Received {
        let line = match input {
            Input::End | Input::Line(NodeLine::Shutdown {}) => return Received::End,
            Input::Line(line) => line,
            Input::Wrong(problem) => {
                self.output.send("error", json!({ "message": problem }));
                return Received::Nothing;
            }
        };
        let number = |id: &str| id.parse::<u64>();
        match line {
            NodeLine::Heartbeat { sequence } => self.output.send("heartbeat", json!({ "sequence": sequence })),
            NodeLine::Goal { id, action, parameters, keep_for_ms, resumed, since } => {
                let since = since.or_else(|| resumed.then(|| id.clone())).and_then(|since| number(&since).ok());
                return self.read_goal(&id, action, &parameters, (permission(keep_for_ms), since));
            }
            NodeLine::Keep { id, keep_for_ms } => {
                if let Ok(id) = number(&id) {
                    return Received::Event(Box::new(Event::Keep { id, keep_for: permission(keep_for_ms) }));
                }
            }
            NodeLine::Cancel { id } => {
                if let Ok(id) = number(&id) {
                    return Received::Event(Box::new(Event::Cancel { id }));
                }
            }
            NodeLine::Start {} | NodeLine::Unknown | NodeLine::Shutdown {} => {}
        }
        Received::Nothing
    }

    fn read_goal(
        &mut self,
        id: &str,
        action: String,
        parameters: &Map<String, Value>,
        (keep_for, since): (Duration, Option<u64>),
    ) -> Received {
        let reject = |GoalError { code, message }: GoalError| {
            let result = json!({ "id": id, "status": "aborted", "code": code, "message": message });
            self.output.send("result", result);
            Received::Nothing
        };
        let Ok(number) = id.parse::<u64>() else {
            let message = format!("{id:?} is no id of a goal; allowed is a decimal number as text");
            return reject(GoalError { code: "unknown", message });
        };
        match self.settings.catalog.work(&action, parameters) {
            Ok((fingerprint, work)) => {
                self.actions.insert(number, action);
                Received::Event(Box::new(Event::Goal { id: number, fingerprint, work, keep_for, since }))
            }
            Err(problem) => reject(problem),
        }
    }

    /// Reads an event of the broker. A malformed message is refused and counted.
    fn receive(&mut self, event: BrokerEvent) -> Option<Event> {
        let vehicle = &self.settings.vehicle;
        let (topic, bytes) = match event {
            BrokerEvent::Up => {
                info!(%vehicle, "connected to the broker");
                self.is_broker_up = true;
                self.broker_problem.clear();
                return Some(Event::Broker { is_up: true });
            }
            BrokerEvent::Down(problem) => {
                if self.broker_problem != problem {
                    warn!(%vehicle, problem, "no connection to the broker; trying again");
                    self.broker_problem = problem;
                }
                self.is_broker_up = false;
                return Some(Event::Broker { is_up: false });
            }
            BrokerEvent::Message(topic, bytes) => (topic, bytes),
        };
        match self.read_message(topic, &bytes) {
            Ok(event) => event,
            Err(problem) => {
                let counter = self.refused.entry(topic.level()).or_default();
                *counter += 1;
                let count = *counter;
                if count <= REFUSALS_LOGGED {
                    warn!(%vehicle, topic = topic.level(), count, %problem, "refused a message of the vehicle");
                }
                None
            }
        }
    }

    fn read_message(&mut self, topic: Topic, bytes: &[u8]) -> Result<Option<Event>, Malformed> {
        let vehicle = &self.settings.vehicle;
        match topic {
            Topic::State => {
                let state = read_state(vehicle, bytes)?;
                self.has_news = true;
                self.position = state.position.clone();
                Ok(Some(Event::State(Box::new(state))))
            }
            Topic::Visualization => {
                if let Some(position) = read_visualization(vehicle, bytes)?.position {
                    self.position = Some(position);
                    self.has_news = true;
                }
                Ok(None)
            }
            Topic::Connection => {
                let connection = read_connection(vehicle, bytes)?;
                info!(%vehicle, ?connection, "connection of the vehicle");
                Ok(Some(Event::Connection(connection)))
            }
            Topic::Factsheet => {
                let factsheet = read_factsheet(vehicle, bytes)?;
                let is_missing = |(_, form): &(&str, &ActionForm)| {
                    !factsheet.actions.is_empty() && !factsheet.actions.contains(&form.kind)
                };
                for (action, form) in self.settings.catalog.actions().filter(is_missing) {
                    warn!(%vehicle, action, kind = form.kind, "the factsheet of the vehicle does not list this action");
                }
                Ok(None)
            }
            Topic::Order | Topic::InstantActions => Ok(None),
        }
    }

    fn perform(&mut self, commands: Vec<Command>, publisher: &Publisher) {
        let version = self.settings.vehicle.version();
        for command in commands {
            match command {
                Command::SendOrder(order) => {
                    info!(vehicle = %self.settings.vehicle, order = order.id, update = order.update, "order");
                    self.publish(Topic::Order, order.to_json(version), publisher);
                }
                Command::SendInstant(action) => {
                    self.publish(Topic::InstantActions, instant_actions(&[action], version), publisher);
                }
                Command::Feedback { goal, distance_remaining_m } => {
                    let mut feedback = json!({ "id": goal.to_string() });
                    if let Some(distance_m) = distance_remaining_m {
                        feedback["distance_remaining_m"] = json!(distance_m);
                    }
                    self.output.send("feedback", feedback);
                }
                Command::Result { goal, status } => self.finish(goal, status),
            }
        }
    }

    fn publish(&mut self, topic: Topic, body: Map<String, Value>, publisher: &Publisher) {
        // Without a connection the state machine sends the message again later.
        if !self.is_broker_up {
            return;
        }
        let header_id = self.sent.entry(topic).or_default();
        let message = self.settings.vehicle.message(*header_id, &timestamp(), body);
        *header_id = header_id.wrapping_add(1);
        if let Err(problem) = publisher.publish(topic, &message) {
            warn!(vehicle = %self.settings.vehicle, topic = topic.level(), %problem, "not published");
        }
    }

    fn finish(&mut self, goal: u64, status: GoalStatus) {
        self.has_news = true;
        self.reported_at = None;
        // The pose at the end is known to the node before the result.
        self.report();
        let id = goal.to_string();
        let action = self.actions.remove(&goal);
        let result = match status {
            GoalStatus::Succeeded(text) => {
                let name = action.and_then(|action| self.settings.catalog.result_of(&action));
                match name {
                    Some(name) => json!({ "id": id, "status": "succeeded", "results": results(name, &text) }),
                    None => json!({ "id": id, "status": "succeeded" }),
                }
            }
            GoalStatus::Canceled => json!({ "id": id, "status": "canceled" }),
            GoalStatus::Aborted(cause) => {
                info!(vehicle = %self.settings.vehicle, code = cause.code, class = ?cause.class, cause.message, "goal failed");
                json!({ "id": id, "status": "aborted", "code": cause.code, "message": cause.message })
            }
        };
        self.output.send("result", result);
    }

    /// Reports pose and charge to the node, at most twice a second, and at least once a second. A change of the
    /// service is reported at once.
    fn report(&mut self) {
        let problem = self.machine.unavailable(self.started.elapsed());
        if self.problem != problem {
            let vehicle = &self.settings.vehicle;
            match &problem {
                Some(reason) => info!(%vehicle, reason, "the vehicle is out of service"),
                None => info!(%vehicle, "the vehicle is in service"),
            }
            self.problem = problem;
            self.reported_at = None;
        }
        let since = self.reported_at.map(|at| at.elapsed());
        let is_due =
            since.is_none_or(|since| since >= REPORT_INTERVAL && (self.has_news || since >= 2 * REPORT_INTERVAL));
        if !is_due {
            return;
        }
        let state = self.machine.state();
        if let (Some(position), Some(state)) = (&self.position, state) {
            let mut pose = json!({ "x_m": position.x_m, "y_m": position.y_m, "yaw_rad": position.yaw_rad });
            let place = self.settings.catalog.place_of(&state.last_node).filter(|_| !state.is_driving);
            if let Some(place) = place {
                pose["place"] = json!(place);
            }
            self.output.send("pose", pose);
        }
        self.output.send("charge", charge(state, self.problem.is_none()));
        (self.reported_at, self.has_news) = (Some(Instant::now()), false);
    }
}

/// Returns the report of the charge. A robot whose vehicle is unavailable does not bid for roles.
fn charge(state: Option<&VehicleState>, is_available: bool) -> Value {
    // The charge of a vehicle that has not reported its state is unknown, and the robot is not able.
    let Some(state) = state else { return json!({ "share": 1.0, "able": false }) };
    let is_low =
        |error: &VehicleError| error.level.ends_orders() && error.kind.to_ascii_lowercase().contains("battery");
    json!({ "share": state.charge, "able": is_available && !state.errors.iter().any(is_low) })
}

/// Returns the results of a goal. The text is shortened: a node aborts a goal with longer results.
fn results(name: &str, text: &str) -> Value {
    let mut text: String = text.chars().take(RESULTS_BYTES_MAX).collect();
    loop {
        let results = json!({ name: text });
        if text.is_empty() || results.to_string().len() <= RESULTS_BYTES_MAX {
            return results;
        }
        text.pop();
    }
}

/// Returns the time as messages contain it: UTC, with milliseconds.
pub(crate) fn timestamp() -> String {
    let now = OffsetDateTime::now_utc();
    let millis = now.replace_nanosecond(now.nanosecond() / 1_000_000 * 1_000_000).unwrap_or(now);
    let text = millis.format(&Rfc3339).unwrap_or_default();
    // RFC 3339 leaves out trailing zeros.
    let (seconds, fraction) = text.trim_end_matches('Z').split_once('.').unwrap_or((text.trim_end_matches('Z'), ""));
    format!("{seconds}.{fraction:0<3}Z")
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_vda5050_core::{Vehicle, Version};

    #[test]
    fn a_long_result_is_shortened() {
        assert_eq!(results("load", "L-7"), json!({ "load": "L-7" }));
        let long = results("load", &"\u{1}ä".repeat(300));
        assert!((RESULTS_BYTES_MAX - 6..=RESULTS_BYTES_MAX).contains(&long.to_string().len()), "{long}");
        assert!(long["load"].as_str().unwrap().starts_with("\u{1}ä"));
    }

    #[test]
    fn a_robot_without_its_vehicle_is_not_able() {
        let vehicle = Vehicle::new("uagv", Version::V2_0, "ACME", "7").unwrap();
        let read = |errors: Value| {
            let message = json!({
                "headerId": 4, "timestamp": "t", "version": "2.0.0", "manufacturer": "ACME", "serialNumber": "7",
                "orderId": "", "orderUpdateId": 0, "lastNodeId": "a", "lastNodeSequenceId": 0, "nodeStates": [],
                "edgeStates": [], "driving": false, "operatingMode": "AUTOMATIC", "actionStates": [], "errors": errors,
                "batteryState": { "batteryCharge": 80.0, "charging": false },
                "safetyState": { "eStop": "NONE", "fieldViolation": false },
            });
            read_state(&vehicle, message.to_string().as_bytes()).unwrap()
        };
        let able = |state: Option<&VehicleState>, is_available| charge(state, is_available)["able"] == true;
        let (good, low) = (read(json!([])), read(json!([{ "errorType": "batteryLow", "errorLevel": "FATAL" }])));
        let ables = [able(None, false), able(Some(&good), false), able(Some(&good), true), able(Some(&low), true)];
        assert_eq!(ables, [false, false, true, false]);
    }

    #[test]
    fn a_timestamp_has_three_digits_of_milliseconds() {
        let text = timestamp();
        assert_eq!(text.len(), "2026-11-27T22:00:00.000Z".len(), "{text}");
        assert!(text.ends_with('Z') && text.as_bytes()[19] == b'.', "{text}");
    }
}
