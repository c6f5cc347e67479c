//! Publisher of a node's events.

use crate::observe::SharedObserver;
use bytes::Bytes;
use consort_bus::clock::Clock;
use consort_bus::{Delivery, Encoding, SharedBus};
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::mpsc::{Sender, channel};
use tracing::debug;

/// Maximum number of events that wait for the bus. Further events are dropped; a gap in the sequence numbers shows it.
const UNSENT_MAX: usize = 1024;

/// Publishes the events of this node, in order. Clones share a single sequence of numbers.
/// Publishing never blocks.
#[derive(Clone)]
pub(crate) struct EventPublisher(Arc<Shared>);

struct Shared {
    node: NodeId,
    clock: Clock,
    observer: Option<SharedObserver>,
    stream: Mutex<NumberedStream>,
    _task: tokio::task::JoinSet<()>,
}

struct NumberedStream {
    count: u64,
    sender: Sender<Event>,
}

impl EventPublisher {
    /// Opens the stream. An observer receives each event first, at the moment it is published.
    pub(crate) fn open(
        node: NodeId,
        keys: &Keys,
        bus: SharedBus,
        clock: Clock,
        observer: Option<SharedObserver>,
    ) -> EventPublisher {
        let (sender, mut events) = channel::<Event>(UNSENT_MAX);
        let key = keys.write(&Key::Events(node.clone()));
        let mut task = tokio::task::JoinSet::new();
        task.spawn(async move {
            while let Some(event) = events.recv().await {
                let json = serde_json::to_vec(&event).expect("an event serializes to JSON");
                if let Err(error) = bus.publish(&key, Bytes::from(json), Encoding::Json, Delivery::Drop).await {
                    debug!(%error, "event not published");
                }
            }
        });
        EventPublisher(Arc::new(Shared {
            node,
            clock,
            observer,
            stream: Mutex::new(NumberedStream { count: 0, sender }),
            _task: task,
        }))
    }

    /// Publishes an event that has just happened on this node.
    pub(crate) fn publish(&self, kind: EventKind) {
        let Shared { node, clock, observer, stream, .. } = &*self.0;
        // Counted and sent under the same lock, so that the numbers follow the order of the stream.
        let mut stream = stream.lock().unwrap_or_else(PoisonError::into_inner);
        stream.count += 1;
        let event = Event { node: node.clone(), sequence: stream.count, at_ms: clock.wall_ms(), kind };
        if let Some(observer) = observer {
            observer.on_event(&event);
        }
        if stream.sender.try_send(event).is_err() {
            debug!(sequence = stream.count, "event not published: too many wait for the bus");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_bus::{LinkModel, VirtualNetwork};
    use consort_protocol::ids::FleetId;
    use std::time::Duration;

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn events_that_wait_for_the_bus_are_limited() {
        let (node, keys) = (NodeId::new("ada").unwrap(), Keys::new(&FleetId::new("ward").unwrap()));
        let bus: SharedBus = Arc::new(VirtualNetwork::new(1, LinkModel::LAN).bus(node.clone()));
        let mut received = bus.subscribe(&keys.any_events()).await.unwrap();
        let publisher = EventPublisher::open(node, &keys, Arc::clone(&bus), Clock::virtual_at(0), None);
        // The task that publishes them does not run meanwhile.
        for term in 0..2 * UNSENT_MAX as u64 {
            publisher.publish(EventKind::SteppedDown { term });
        }
        tokio::time::sleep(Duration::from_secs(1)).await;
        assert_eq!(std::iter::from_fn(|| received.try_recv()).count(), UNSENT_MAX);
        publisher.publish(EventKind::SteppedDown { term: 0 });
        let next: serde_json::Value = serde_json::from_slice(&received.recv().await.unwrap().payload).unwrap();
        assert_eq!(next["sequence"], 2 * UNSENT_MAX + 1, "the gap shows the loss");
    }
}
