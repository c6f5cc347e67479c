//! What the benchmarks with processes share: a fleet, and an onlooker with a clock.

mod figures;

use consort_actors::bus::{Sample, SharedBus, Stream};
use consort_nodes::config::{FleetConfig, FleetRef};
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

/// How long a fleet may take to start, and whatever else is certain to happen.
const PATIENCE: Duration = Duration::from_secs(30);

/// How long one look or one request may take.
pub(crate) const QUERY_TIMEOUT: Duration = Duration::from_secs(2);

/// A fleet of processes and somebody who looks on, linked with the world's node, which nobody kills.
pub(crate) struct Fleet {
    pub(crate) stage: ProcessFleet,
    pub(crate) keys: Keys,
    events: Stream<Sample>,
}

impl Fleet {
    /// Starts it and waits until somebody coordinates with as many voters as there can be.
    pub(crate) async fn start(cast: &DemoScenario) -> Result<Fleet, BenchError> {
        let program = Path::new(env!("CARGO_BIN_EXE_consort"));
        let stage = ProcessFleet::start(cast, program, None).await.map_err(|problem| problem.to_string())?;
        let keys = Keys::new(&cast.fleet.name);
        let events = stage.bus().subscribe(&keys.any_events()).await.map_err(|problem| problem.to_string())?;
        let mut fleet = Fleet { stage, keys, events };
        let wanted = cast.voters().len().min(5);
        let deadline = Instant::now() + PATIENCE;
        while fleet.voters().await < wanted {
            if let Some(words) = fleet.stage.unexpected_exit() {
                return Err(words);
            }
            if Instant::now() >= deadline {
                return Err(format!("no coordinator with {wanted} voters within {PATIENCE:?}"));
            }
            sleep(Duration::from_millis(100)).await;
        }
        Ok(fleet)
    }

    /// What the coordinator shows of itself.
    pub(crate) async fn coordinator(&self) -> Option<Value> {
        ask(&self.stage.bus(), &self.keys.write(&Key::ViewCoordinator), &Value::Null, QUERY_TIMEOUT).await
    }

    async fn voters(&self) -> usize {
        self.coordinator().await.and_then(|view| view["voters"].as_array().map(Vec::len)).unwrap_or(0)
    }

    /// Waits for an event, and says when it was heard.
    pub(crate) async fn wait_for_event<T>(
        &mut self,
        what: impl Display,
        limit: Duration,
        mut pick: impl FnMut(Event) -> Option<T>,
    ) -> Result<(T, Instant), BenchError> {
        let deadline = Instant::now() + limit;
        loop {
            let sample = timeout_at(deadline, self.events.recv()).await;
            let sample = sample.map_err(|_| format!("{what} was not heard within {limit:?}"))?;
            let at = Instant::now();
            let sample = sample.ok_or("the bus was closed")?;
            let event = serde_json::from_slice(&sample.payload).map_err(|problem| problem.to_string())?;
            if let Some(found) = pick(event) {
                return Ok((found, at));
            }
        }
    }

    /// Ends it.
    pub(crate) async fn end(self) {
        self.stage.shut_down().await;
    }
}

/// The same cast in another fleet; all its nodes agree on it.
pub(crate) fn in_fleet(mut cast: DemoScenario, fleet: FleetConfig) -> DemoScenario {
    let reference = FleetRef::from(fleet.clone());
    cast.fleet = fleet;
    cast.world.fleet = reference.clone();
    cast.robots.iter_mut().for_each(|robot| robot.fleet = reference.clone());
    cast.stations.iter_mut().for_each(|station| station.fleet = reference.clone());
    cast
}

/// A request for lab samples.
pub(crate) fn lab_samples(request: &str, room: &str) -> Value {
    json!({ "mission": "lab-samples", "parameters": { "room": room }, "request": request })
}

/// The mission that an answer acknowledges.
pub(crate) fn acknowledged(answer: Option<&Value>) -> Option<MissionId> {
    answer?["mission"].as_str()?.parse().ok()
}

/// Asks, and gives the first answer that is JSON.
pub(crate) async fn ask(bus: &SharedBus, key: &str, payload: &Value, limit: Duration) -> Option<Value> {
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

/// The first number among the arguments, or `default`: `cargo bench -p consort --bench auction -- 20`.
pub(crate) fn count(default: usize) -> usize {
    std::env::args().find_map(|argument| argument.parse().ok()).unwrap_or(default)
}
