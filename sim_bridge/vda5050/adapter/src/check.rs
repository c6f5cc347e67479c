//! The check of a file, without and with the vehicle.

use crate::catalog::ScopeForm;
use crate::driver::timestamp;
use crate::file::VehicleSettings;
use crate::mqtt::{BrokerEvent, Side, connect};
use consort_vda5050_core::{
    Command, Event, Factsheet, Malformed, OrderMachine, Topic, VehicleState, instant_actions, read_factsheet,
    read_state,
};
use std::time::{Duration, SystemTime};
use tokio::time::{Instant, timeout_at};

/// Returns what a file describes, line by line.
pub fn describe(settings: &VehicleSettings) -> Vec<String> {
    let VehicleSettings { vehicle, broker, catalog, .. } = settings;
    let security = if broker.tls.is_some() { "TLS" } else { "no TLS" };
    let user = broker.login.as_ref().map_or("no user".to_owned(), |(user, _)| format!("user {user}"));
    let mut lines = vec![
        format!("vehicle {vehicle}, VDA 5050 {}", vehicle.version()),
        format!("broker  {}:{}, {security}, {user}", broker.host, broker.port),
        format!("topics  {}", vehicle.topic(Topic::State).replace("/state", "/…")),
    ];
    lines.extend(catalog.places().map(|(name, place)| format!("place   {name}: node {}", place.node)));
    lines.extend(catalog.actions().map(|(name, form)| {
        let scope = if form.scope == ScopeForm::Instant { "instant action" } else { "action on the node" };
        format!("action  {name}: {} {}, blocking {}", scope, form.kind, form.blocking.as_str())
    }));
    lines.extend(settings.own_codes().map(|code| format!("code    {code}: a domain file has to declare it")));
    lines
}

/// What a vehicle reported.
#[derive(Debug, Default)]
pub struct VehicleReport {
    /// State.
    pub state: Option<VehicleState>,
    /// Factsheet.
    pub factsheet: Option<Factsheet>,
    /// Problems: of the connection, and refused messages.
    pub problems: Vec<String>,
}

/// Requests state and factsheet of the vehicle, and waits for both. The vehicle does not move.
pub async fn ask(settings: &VehicleSettings, limit: Duration) -> VehicleReport {
    let vehicle = &settings.vehicle;
    let session = SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default().as_millis();
    let (publisher, mut events) =
        connect(&settings.broker, vehicle, &format!("consort-check-{session:x}"), Side::FleetControl);
    let mut machine = OrderMachine::new(settings.machine(u64::try_from(session).unwrap_or_default()));
    let (mut report, until) = (VehicleReport::default(), Instant::now() + limit);
    let refused = |topic: Topic, problem: Malformed| format!("refused a message of {}: {problem}", topic.level());
    while report.state.is_none() || report.factsheet.is_none() {
        let Ok(Some(event)) = timeout_at(until, events.recv()).await else { break };
        match event {
            BrokerEvent::Up => {
                for (header_id, command) in (0..).zip(machine.step(Event::Broker { is_up: true }, Duration::ZERO)) {
                    if let Command::SendInstant(action) = command {
                        let body = instant_actions(&[action], vehicle.version());
                        let message = vehicle.message(header_id, &timestamp(), body);
                        report.problems.extend(
                            publisher.publish(Topic::InstantActions, &message).err().map(|problem| problem.to_string()),
                        );
                    }
                }
            }
            BrokerEvent::Down(problem) => {
                if !report.problems.contains(&problem) {
                    report.problems.push(problem);
                }
            }
            BrokerEvent::Message(Topic::State, bytes) => match read_state(vehicle, &bytes) {
                Ok(state) => report.state = Some(state),
                Err(problem) => report.problems.push(refused(Topic::State, problem)),
            },
            BrokerEvent::Message(Topic::Factsheet, bytes) => match read_factsheet(vehicle, &bytes) {
                Ok(factsheet) => report.factsheet = Some(factsheet),
                Err(problem) => report.problems.push(refused(Topic::Factsheet, problem)),
            },
            BrokerEvent::Message(..) => {}
        }
    }
    publisher.close();
    report
}

impl VehicleReport {
    /// Returns the report, line by line.
    pub fn lines(&self, settings: &VehicleSettings) -> Vec<String> {
        let mut lines: Vec<String> = self.problems.iter().map(|problem| format!("problem {problem}")).collect();
        match &self.state {
            Some(state) => lines.push(format!(
                "state   mode {}, charge {:.0} %, node {:?}, order {:?}, {} errors",
                state.mode,
                state.charge * 100.0,
                state.last_node,
                state.order,
                state.errors.len()
            )),
            None => lines.push(
                "state   none: is the vehicle connected, and are version, manufacturer and serial right?".to_owned(),
            ),
        }
        let Some(sheet) = &self.factsheet else {
            lines.push("factsheet none: the vehicle does not send one".to_owned());
            return lines;
        };
        let speed = sheet.speed_max_mps.map_or("unknown".to_owned(), |speed| format!("{speed} m/s"));
        let size = sheet.size_m.map_or("unknown".to_owned(), |(length, width)| format!("{length} m by {width} m"));
        let series = sheet.series.as_deref().unwrap_or("unknown");
        lines.push(format!(
            "factsheet series {series}, speed {speed}, size {size}, actions {}",
            sheet.actions.join(", ")
        ));
        let is_missing = |kind: &String| !sheet.actions.is_empty() && !sheet.actions.contains(kind);
        let missing = settings.catalog.actions().filter(|(_, form)| is_missing(&form.kind));
        lines.extend(
            missing.map(|(name, form)| format!("problem action {name}: the factsheet does not list {}", form.kind)),
        );
        lines
    }
}
