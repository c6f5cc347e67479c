//! Follows a fleet over the bus, and tells what it hears.

use crate::fleet_model::{FleetInput, FleetListener};
use crate::query::{self, QueryTarget};
use consort_actors::bus::{Bus, SharedBus};
use consort_actors::robot_driver::DriverState;
use consort_protocol::codec;
use consort_protocol::event::Event;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::message::ClusterEnvelope;
use serde::de::DeserializeOwned;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinSet;
use tracing::{debug, warn};

/// How often views are asked for. What matters sooner comes by itself, as events.
const LOOK: Duration = Duration::from_secs(1);

/// How often it is looked whom the node is linked to.
const LINKS: Duration = Duration::from_millis(250);

/// How long one view may take.
const LIMIT: Duration = Duration::from_millis(1500);

/// How long to wait before something that failed is tried again.
const AGAIN: Duration = Duration::from_secs(1);

/// Missions asked for at once.
const MISSIONS: usize = 16;

/// Follows the fleet, until the tasks end.
pub(crate) fn subscribe_fleet(tasks: &mut JoinSet<()>, bus: SharedBus, keys: Keys, ear: Arc<dyn FleetListener>) {
    let on = |key: String| (Arc::clone(&bus), key, Arc::clone(&ear));
    let (events, bodies, beacons) = (keys.any_events(), keys.any_body_state(), keys.write(&Key::Beacon));
    tasks.spawn(hear(on(events), |payload| match serde_json::from_slice::<Event>(payload) {
        Ok(event) => Some(FleetInput::Event(Box::new(event))),
        Err(problem) => {
            debug!(%problem, "an event that cannot be read");
            None
        }
    }));
    tasks.spawn(hear(on(bodies), |payload| {
        let DriverState { robot, telemetry, .. } = read(payload)?;
        Some(FleetInput::Telemetry { robot: robot.to_string(), telemetry })
    }));
    tasks.spawn(hear(on(beacons), |payload| {
        Some(FleetInput::Beacon(read(&read::<ClusterEnvelope>(payload)?.payload)?))
    }));
    tasks.spawn(look_at_links(Arc::clone(&bus), Arc::clone(&ear)));
    tasks.spawn(look_at_views(bus, keys, ear));
}

fn read<T: DeserializeOwned>(payload: &[u8]) -> Option<T> {
    codec::decode(payload).inspect_err(|problem| debug!(%problem, "a message that cannot be read")).ok()
}

async fn hear(on: (SharedBus, String, Arc<dyn FleetListener>), read: impl Fn(&[u8]) -> Option<FleetInput> + Send) {
    let (bus, key, ear) = on;
    loop {
        match bus.subscribe(&key).await {
            Ok(mut samples) => {
                while let Some(sample) = samples.recv().await {
                    if let Some(heard) = read(&sample.payload) {
                        ear.on_input(heard);
                    }
                }
                return;
            }
            Err(problem) => warn!(%problem, key, "the fleet cannot be followed"),
        }
        tokio::time::sleep(AGAIN).await;
    }
}

async fn look_at_links(bus: SharedBus, ear: Arc<dyn FleetListener>) {
    loop {
        let links = bus.links().await;
        let nodes = links.iter().filter(|link| link.kind != "client").count();
        ear.on_input(FleetInput::Links(nodes));
        tokio::time::sleep(LINKS).await;
    }
}

async fn look_at_views(bus: SharedBus, keys: Keys, ear: Arc<dyn FleetListener>) {
    loop {
        let look = |key: Key| look(&*bus, &keys, &*ear, key);
        if ear.needs_map() {
            look(Key::ViewMap).await;
        }
        tokio::join!(
            look(Key::ViewFleet),
            look(Key::ViewCoordinator),
            look(Key::ViewMissions),
            look(Key::ViewAuctions),
            look(Key::ViewWorld),
            look(Key::ViewHealth),
        );
        let wanted = ear.missions_to_query();
        let wanted = wanted.into_iter().filter_map(|id| MissionId::new(id).ok()).take(MISSIONS);
        for mission in wanted {
            look(Key::ViewMission(mission)).await;
        }
        tokio::time::sleep(LOOK).await;
    }
}

async fn look(bus: &dyn Bus, keys: &Keys, ear: &dyn FleetListener, key: Key) {
    match query::query_once(bus, &keys.write(&key), "", LIMIT, QueryTarget::Nearest).await {
        Ok(view) => ear.on_input(FleetInput::View { key, view }),
        Err(hindrance) => debug!(%key, ?hindrance, "a view that nobody shows"),
    }
}
