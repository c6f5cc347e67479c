//! Outgoing messages of an actor that must not wait for the bus. A task of their own sends them, in order.

use crate::bus::{BusError, Delivery, Encoding, Query, Replier, SharedBus};
use bytes::Bytes;
use tokio::sync::mpsc;
use tracing::debug;

/// Outgoing messages. While the bus is blocked, the outbox fills and then drops further messages.
pub struct Outbox(mpsc::Sender<Outgoing>);

enum Outgoing {
    Publish(String, Bytes),
    Reply(Box<dyn Replier>, String, Bytes),
}

impl Outbox {
    /// Creates an outbox for `capacity` messages, and the task that sends them. `on_failure` is called for
    /// each message that the bus did not send.
    pub fn new(
        bus: SharedBus,
        capacity: usize,
        on_failure: impl Fn() + Send + 'static,
    ) -> (Outbox, impl Future<Output = ()> + Send) {
        let (sender, outgoing) = mpsc::channel(capacity);
        (Outbox(sender), send(bus, outgoing, on_failure))
    }

    /// Publishes a wire message. Returns false if it was dropped.
    pub fn publish(&self, key: String, payload: Bytes) -> bool {
        self.0.try_send(Outgoing::Publish(key, payload)).is_ok()
    }

    /// Replies to a query with a wire message on `key`. Returns false if it was dropped.
    pub fn reply(&self, query: Query, key: String, payload: Bytes) -> bool {
        self.0.try_send(Outgoing::Reply(query.replier, key, payload)).is_ok()
    }
}

async fn send(bus: SharedBus, mut outgoing: mpsc::Receiver<Outgoing>, on_failure: impl Fn()) {
    while let Some(message) = outgoing.recv().await {
        let sent: Result<(), BusError> = match message {
            Outgoing::Publish(key, payload) => bus.publish(&key, payload, Encoding::Wire, Delivery::Drop).await,
            Outgoing::Reply(replier, key, payload) => replier.reply(&key, payload, Encoding::Wire).await,
        };
        if let Err(problem) = sent {
            debug!(%problem, "failed to send a message");
            on_failure();
        }
    }
}
