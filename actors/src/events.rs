//! A node's voice on the event stream.

use crate::bus::{Delivery, Encoding, SharedBus};
use crate::clock::Clock;
use bytes::Bytes;
use consort_protocol::event::{Event, Happening};
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys};
use std::sync::Arc;
use tokio::sync::mpsc::{UnboundedSender, unbounded_channel};
use tracing::debug;

/// Publishes what happens on this node, in order. Clones share one sequence; telling never waits.
#[derive(Clone)]
pub struct Events {
    told: UnboundedSender<Happening>,
    _task: Arc<tokio::task::JoinSet<()>>,
}

impl Events {
    /// Opens the stream.
    pub fn open(node: NodeId, keys: &Keys, bus: SharedBus, clock: Clock) -> Events {
        let (told, mut happened) = unbounded_channel();
        let key = keys.write(&Key::Events);
        let mut task = tokio::task::JoinSet::new();
        task.spawn(async move {
            let mut sequence = 0;
            while let Some(what) = happened.recv().await {
                sequence += 1;
                let event = Event { node: node.clone(), sequence, at_ms: clock.wall_ms(), what };
                let json = serde_json::to_vec(&event).expect("an event can be told in JSON");
                if let Err(problem) = bus.publish(&key, Bytes::from(json), Encoding::Json, Delivery::Drop).await {
                    debug!(%problem, "an event was not published");
                }
            }
        });
        Events { told, _task: Arc::new(task) }
    }

    /// Tells of something that has just happened here.
    pub fn tell(&self, what: Happening) {
        // The task behind the channel lives as long as any clone.
        let _ = self.told.send(what);
    }
}
