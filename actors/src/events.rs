//! A node's voice on the event stream.

use crate::bus::{Delivery, Encoding, SharedBus};
use crate::clock::Clock;
use crate::observe::SharedObserver;
use bytes::Bytes;
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::mpsc::{UnboundedSender, unbounded_channel};
use tracing::debug;

/// Publishes what happens on this node, in order. Clones share one sequence; telling never waits.
#[derive(Clone)]
pub struct EventPublisher(Arc<Shared>);

struct Shared {
    node: NodeId,
    clock: Clock,
    observer: Option<SharedObserver>,
    told: Mutex<Told>,
    _task: tokio::task::JoinSet<()>,
}

struct Told {
    count: u64,
    to: UnboundedSender<Event>,
}

impl EventPublisher {
    /// Opens the stream. An observer is told first, at the instant of telling.
    pub fn open(
        node: NodeId,
        keys: &Keys,
        bus: SharedBus,
        clock: Clock,
        observer: Option<SharedObserver>,
    ) -> EventPublisher {
        let (to, mut happened) = unbounded_channel::<Event>();
        let key = keys.write(&Key::Events(node.clone()));
        let mut task = tokio::task::JoinSet::new();
        task.spawn(async move {
            while let Some(event) = happened.recv().await {
                let json = serde_json::to_vec(&event).expect("an event can be told in JSON");
                if let Err(problem) = bus.publish(&key, Bytes::from(json), Encoding::Json, Delivery::Drop).await {
                    debug!(%problem, "an event was not published");
                }
            }
        });
        EventPublisher(Arc::new(Shared { node, clock, observer, told: Mutex::new(Told { count: 0, to }), _task: task }))
    }

    /// Tells of something that has just happened here.
    pub fn publish(&self, what: EventKind) {
        let Shared { node, clock, observer, told, .. } = &*self.0;
        // Counted and sent as one, so that numbers stand in the order of the stream.
        let mut told = told.lock().unwrap_or_else(PoisonError::into_inner);
        told.count += 1;
        let event = Event { node: node.clone(), sequence: told.count, at_ms: clock.wall_ms(), kind: what };
        if let Some(observer) = observer {
            observer.on_event(&event);
        }
        // The task behind the channel lives as long as any clone.
        let _ = told.to.send(event);
    }
}
