//! Subscribes to a fleet over the bus, and passes its inputs to a listener.

use crate::fleet_model::{FleetInput, FleetListener};
use crate::missions_copy::MissionsCopy;
use crate::query::{self, QueryTarget};
use consort_bus::{Bus, SharedBus};
use consort_fleet::robot_driver::DriverState;
use consort_protocol::codec;
use consort_protocol::event::Event;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::message::ClusterEnvelope;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinSet;
use tracing::{debug, warn};

/// Poll interval of views. Urgent changes arrive as events.
const LOOK: Duration = Duration::from_secs(1);

/// Poll interval of links.
const LINKS: Duration = Duration::from_millis(250);

/// Time limit of a view.
const LIMIT: Duration = Duration::from_millis(1500);

/// Delay before a failed operation is retried.
const AGAIN: Duration = Duration::from_secs(1);

/// Maximum number of missions queried per round.
const MISSIONS: usize = 16;

/// Subscribes to the fleet, until the tasks end.
pub fn subscribe_fleet(tasks: &mut JoinSet<()>, bus: SharedBus, keys: Keys, listener: Arc<dyn FleetListener>) {
    let on = |key: String| (Arc::clone(&bus), key, Arc::clone(&listener));
    let (events, bodies, beacons) = (keys.any_events(), keys.any_driver_state(), keys.write(&Key::Beacon));
    tasks.spawn(receive(on(events), |payload| match serde_json::from_slice::<Event>(payload) {
        Ok(event) => Some(FleetInput::Event(Box::new(event))),
        Err(problem) => {
            debug!(%problem, "an event cannot be parsed");
            None
        }
    }));
    tasks.spawn(receive(on(bodies), |payload| {
        let state: DriverState = read(payload)?;
        let feedback = state.feedback();
        Some(FleetInput::Telemetry { robot: state.robot.to_string(), telemetry: state.telemetry, feedback })
    }));
    tasks.spawn(receive(on(beacons), |payload| {
        Some(FleetInput::Beacon(read(&read::<ClusterEnvelope>(payload)?.payload)?))
    }));
    tasks.spawn(poll_links(Arc::clone(&bus), Arc::clone(&listener)));
    tasks.spawn(poll_views(bus, keys, listener));
}

fn read<T: DeserializeOwned>(payload: &[u8]) -> Option<T> {
    codec::decode(payload).inspect_err(|problem| debug!(%problem, "a message cannot be parsed")).ok()
}

async fn receive(on: (SharedBus, String, Arc<dyn FleetListener>), read: impl Fn(&[u8]) -> Option<FleetInput> + Send) {
    let (bus, key, listener) = on;
    loop {
        match bus.subscribe(&key).await {
            Ok(mut samples) => {
                while let Some(sample) = samples.recv().await {
                    if let Some(input) = read(&sample.payload) {
                        listener.on_input(input);
                    }
                }
                return;
            }
            Err(problem) => warn!(%problem, key, "subscription failed"),
        }
        tokio::time::sleep(AGAIN).await;
    }
}

async fn poll_links(bus: SharedBus, listener: Arc<dyn FleetListener>) {
    loop {
        let links = bus.links().await;
        let nodes = links.iter().filter(|link| link.kind != "client").count();
        listener.on_input(FleetInput::Links(nodes));
        tokio::time::sleep(LINKS).await;
    }
}

async fn poll_views(bus: SharedBus, keys: Keys, listener: Arc<dyn FleetListener>) {
    let mut missions = MissionsCopy::default();
    loop {
        let query_view = |key: Key| query_view(&*bus, &keys, &*listener, key);
        if listener.needs_map() {
            query_view(Key::ViewMap).await;
        }
        tokio::join!(
            query_view(Key::ViewFleet),
            query_view(Key::ViewCoordinator),
            query_missions(&*bus, &keys, &*listener, &mut missions),
            query_view(Key::ViewSchedules),
            query_view(Key::ViewAuctions),
            query_view(Key::ViewWorld),
            query_view(Key::ViewHealth),
        );
        let wanted = listener.missions_to_query();
        let wanted = wanted.into_iter().filter_map(|id| MissionId::new(id).ok()).take(MISSIONS);
        for mission in wanted {
            query_view(Key::ViewMission(mission)).await;
        }
        tokio::time::sleep(LOOK).await;
    }
}

async fn query_view(bus: &dyn Bus, keys: &Keys, listener: &dyn FleetListener, key: Key) {
    if let Some(view) = read_view(bus, &keys.write(&key)).await {
        listener.on_input(FleetInput::View { key, view });
    }
}

/// Reads what has changed of the missions since the copy. The listener receives all of them: it also applies events,
/// which the latest view corrects, and recordings contain whole views.
async fn query_missions(bus: &dyn Bus, keys: &Keys, listener: &dyn FleetListener, copy: &mut MissionsCopy) {
    let key = Key::ViewMissions;
    if let Some(mut view) = read_view(bus, &format!("{}{}", keys.write(&key), copy.parameters())).await {
        copy.complete(&mut view);
        listener.on_input(FleetInput::View { key, view });
    }
}

async fn read_view(bus: &dyn Bus, selector: &str) -> Option<Value> {
    let reply = query::query_once(bus, selector, "", LIMIT, QueryTarget::Nearest).await;
    reply.inspect_err(|error| debug!(selector, ?error, "no node returned the view")).ok()
}
