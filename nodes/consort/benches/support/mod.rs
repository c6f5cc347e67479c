//! Shared functions of the benchmarks with processes: a fleet, and an observer that measures times.

mod figures;

use consort_bus::{Sample, SharedBus, Stream};
use consort_nodes::demo::{DemoFleet, DemoScenario, ProcessFleet};
use consort_protocol::event::Event;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::{Key, Keys};
use serde_json::{Value, json};
use std::fmt::Display;
use std::path::Path;
use std::time::Duration;
use tokio::time::{Instant, sleep, timeout_at};

pub(crate) use figures::{BenchError, figures, main, ms};

/// Time limit for the start of a fleet, and for every other certain event.
const START_LIMIT: Duration = Duration::from_secs(30);

/// Time limit of a query.
pub(crate) const QUERY_TIMEOUT: Duration = Duration::from_secs(2);

/// A fleet of processes and an observer, linked with the node of the world, which is never killed.
pub(crate) struct Fleet {
    pub(crate) processes: ProcessFleet,
    pub(crate) keys: Keys,
    events: Stream<Sample>,
}

impl Fleet {
    /// Starts the fleet and waits until a coordinator has as many voters as possible.
    pub(crate) async fn start(scenario: &DemoScenario) -> Result<Fleet, BenchError> {
        let program = Path::new(env!("CARGO_BIN_EXE_consort"));
        let processes = ProcessFleet::start(scenario, program, &[], None).await.map_err(|error| error.to_string())?;
        let keys = Keys::new(&scenario.fleet.name);
        let events = processes.bus().subscribe(&keys.any_events()).await.map_err(|error| error.to_string())?;
        let mut fleet = Fleet { processes, keys, events };
        let expected_voters = scenario.voters().len().min(5);
        let deadline = Instant::now() + START_LIMIT;
        while fleet.voters().await < expected_voters {
            if let Some(exit_message) = fleet.processes.unexpected_exit() {
                return Err(exit_message);
            }
            if Instant::now() >= deadline {
                return Err(format!("no coordinator with {expected_voters} voters within {START_LIMIT:?}"));
            }
            sleep(Duration::from_millis(100)).await;
        }
        Ok(fleet)
    }

    /// Returns the view of the coordinator.
    pub(crate) async fn coordinator(&self) -> Option<Value> {
        query_json(&self.processes.bus(), &self.keys.write(&Key::ViewCoordinator), &Value::Null, QUERY_TIMEOUT).await
    }

    async fn voters(&self) -> usize {
        self.coordinator().await.and_then(|view| view["voters"].as_array().map(Vec::len)).unwrap_or(0)
    }

    /// Waits for an event; returns it with the time of its arrival.
    pub(crate) async fn wait_for_event<T>(
        &mut self,
        what: impl Display,
        limit: Duration,
        mut pick: impl FnMut(Event) -> Option<T>,
    ) -> Result<(T, Instant), BenchError> {
        let deadline = Instant::now() + limit;
        loop {
            let sample = timeout_at(deadline, self.events.recv()).await;
            let sample = sample.map_err(|_| format!("{what} was not received within {limit:?}"))?;
            let at = Instant::now();
            let sample = sample.ok_or("the bus was closed")?;
            let event = serde_json::from_slice(&sample.payload).map_err(|error| error.to_string())?;
            if let Some(found) = pick(event) {
                return Ok((found, at));
            }
        }
    }

    /// Stops the fleet.
    pub(crate) async fn end(self) {
        self.processes.shut_down().await;
    }
}

/// Returns a request for lab samples.
pub(crate) fn lab_samples(request: &str, room: &str) -> Value {
    json!({ "mission": "lab-samples", "parameters": { "room": room }, "request": request })
}

/// Returns the mission acknowledged by a reply.
pub(crate) fn acknowledged(answer: Option<&Value>) -> Option<MissionId> {
    answer?["mission"].as_str()?.parse().ok()
}

/// Sends a query, and returns the first reply that is JSON.
pub(crate) async fn query_json(bus: &SharedBus, key: &str, payload: &Value, limit: Duration) -> Option<Value> {
    let bytes = if payload.is_null() { vec![] } else { payload.to_string().into_bytes() };
    let mut replies = match key.contains("/view/") {
        true => bus.query_nearest(key, bytes.into(), limit).await.ok()?,
        false => bus.query(key, bytes.into(), limit).await.ok()?,
    };
    while let Some(reply) = replies.recv().await {
        if let Some(value) = reply.payload.ok().and_then(|bytes| serde_json::from_slice(&bytes).ok()) {
            return Some(value);
        }
    }
    None
}

/// Returns the first number among the arguments, or `default`: `cargo bench -p consort --bench
/// auction -- 20`.
pub(crate) fn count(default: usize) -> usize {
    std::env::args().find_map(|argument| argument.parse().ok()).unwrap_or(default)
}
