//! Follows a fleet over the bus, and puts what it hears on the board.

use super::Board;
use crate::asking::{self, Whom};
use consort_actors::body::BodyState;
use consort_actors::bus::{Bus, SharedBus};
use consort_protocol::codec;
use consort_protocol::event::Event;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::message::{Beacon, Within};
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
pub(crate) fn watch(tasks: &mut JoinSet<()>, bus: SharedBus, keys: Keys, board: Arc<Board>) {
    let ear = |key: String| (Arc::clone(&bus), key, Arc::clone(&board));
    let (events, bodies, beacons) = (keys.any_events(), keys.any_body_state(), keys.write(&Key::Beacon));
    let (at, key, shown) = ear(events);
    tasks.spawn(hear(at, key, move |payload| match serde_json::from_slice::<Event>(payload) {
        Ok(event) => shown.with(|picture, now_ms| picture.take_event(&event, now_ms)),
        Err(problem) => debug!(%problem, "an event that cannot be read"),
    }));
    let (at, key, shown) = ear(bodies);
    tasks.spawn(hear(at, key, move |payload| {
        if let Some(state) = read::<BodyState>(payload) {
            shown.with(|picture, now_ms| picture.take_body(state.robot.as_str(), &state.telemetry, now_ms));
        }
    }));
    let (at, key, shown) = ear(beacons);
    tasks.spawn(hear(at, key, move |payload| {
        let beacon = read::<Within>(payload).and_then(|within| read::<Beacon>(&within.said));
        if let Some(beacon) = beacon {
            shown.with(|picture, now_ms| picture.take_beacon(&beacon, now_ms));
        }
    }));
    tasks.spawn(look_at_links(Arc::clone(&bus), Arc::clone(&board)));
    tasks.spawn(look_at_views(bus, keys, board));
}

fn read<T: DeserializeOwned>(payload: &[u8]) -> Option<T> {
    codec::decode(payload).inspect_err(|problem| debug!(%problem, "a message that cannot be read")).ok()
}

async fn hear(bus: SharedBus, key: String, take_in: impl Fn(&[u8]) + Send) {
    loop {
        match bus.subscribe(&key).await {
            Ok(mut samples) => {
                while let Some(sample) = samples.recv().await {
                    take_in(&sample.payload);
                }
                return;
            }
            Err(problem) => warn!(%problem, key, "the dashboard cannot follow"),
        }
        tokio::time::sleep(AGAIN).await;
    }
}

async fn look_at_links(bus: SharedBus, board: Arc<Board>) {
    loop {
        let links = bus.links().await;
        let nodes = links.iter().filter(|link| link.kind != "client").count();
        board.with(|picture, now_ms| picture.take_links(nodes, now_ms));
        tokio::time::sleep(LINKS).await;
    }
}

async fn look_at_views(bus: SharedBus, keys: Keys, board: Arc<Board>) {
    loop {
        let look = |key: Key| look(&*bus, &keys, &board, key);
        tokio::join!(
            look(Key::ViewFleet),
            look(Key::ViewCoordinator),
            look(Key::ViewMissions),
            look(Key::ViewAuctions),
            look(Key::ViewWorld),
            look(Key::ViewHealth),
        );
        let wanted = board.with(|picture, _| picture.missions_to_ask_for());
        let wanted = wanted.iter().filter_map(|id| MissionId::new(id.clone()).ok()).take(MISSIONS);
        for mission in wanted {
            look(Key::ViewMission(mission)).await;
        }
        tokio::time::sleep(LOOK).await;
    }
}

async fn look(bus: &dyn Bus, keys: &Keys, board: &Board, key: Key) {
    match asking::once(bus, &keys.write(&key), "", LIMIT, Whom::Nearest).await {
        Ok(view) => board.with(|picture, now_ms| picture.take_view(&key, &view, now_ms)),
        Err(hindrance) => debug!(%key, ?hindrance, "a view that nobody shows"),
    }
}
