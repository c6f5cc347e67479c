//! Outgoing messages of the actor, sent in order by a task of their own.

use super::shared::SharedKnowledge;
use bytes::Bytes;
use consort_bus::wire_version::WireVersion;
use consort_bus::{BusError, Delivery, Encoding, Query, SharedBus};
use consort_protocol::codec::{self, VersionedMessage};
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::message::{Exchange, RecordUpdate};
use tokio::sync::mpsc;

/// Capacity of the outbox, in messages.
const CAPACITY: usize = 1024;

/// Outgoing messages. If the bus stalls, the outbox fills and then drops further messages.
pub(super) struct Outbox {
    node: NodeId,
    keys: Keys,
    wire_version: WireVersion,
    shared: SharedKnowledge,
    sender: mpsc::Sender<Outgoing>,
}

enum Outgoing {
    Publish(String, Bytes),
    Reply(Query, Bytes),
}

impl Outbox {
    /// Creates an outbox of a node, and the task that sends its messages.
    pub(super) fn new(
        node: NodeId,
        keys: Keys,
        wire_version: WireVersion,
        shared: SharedKnowledge,
        bus: SharedBus,
    ) -> (Outbox, impl Future<Output = ()> + Send) {
        let (sender, outgoing) = mpsc::channel(CAPACITY);
        let task = send(bus, outgoing, keys.write(&Key::Gossip(node.clone())), shared.clone());
        (Outbox { node, keys, wire_version, shared, sender }, task)
    }

    /// Publishes an update of the own record.
    pub(super) fn publish(&self, update: RecordUpdate) {
        let key = self.keys.write(&Key::Knowledge(self.node.clone()));
        self.push(Outgoing::Publish(key, self.encode(update)));
    }

    /// Sends a packet of failure detection.
    pub(super) fn send(&self, to: NodeId, packet: Bytes) {
        self.push(Outgoing::Publish(self.keys.write(&Key::Swim(to)), packet));
    }

    /// Replies to a peer.
    pub(super) fn reply(&self, query: Query, exchange: Exchange) {
        self.push(Outgoing::Reply(query, self.encode(exchange)));
    }

    /// Encodes a message in the wire version of the fleet.
    pub(super) fn encode<T: VersionedMessage>(&self, message: T) -> Bytes {
        let bytes = codec::encode_for_version(self.wire_version.get(), message);
        bytes.expect("the size of records and exchanges is limited on creation").into()
    }

    fn push(&self, outgoing: Outgoing) {
        if self.sender.try_send(outgoing).is_err() {
            self.shared.lock().counters.unsent += 1;
        }
    }
}

/// Sends the messages in the outbox, in order.
async fn send(bus: SharedBus, mut outgoing: mpsc::Receiver<Outgoing>, own_key: String, shared: SharedKnowledge) {
    while let Some(message) = outgoing.recv().await {
        let sent: Result<(), BusError> = match message {
            Outgoing::Publish(key, payload) => bus.publish(&key, payload, Encoding::Wire, Delivery::Drop).await,
            Outgoing::Reply(query, payload) => query.replier.reply(&own_key, payload, Encoding::Wire).await,
        };
        if let Err(problem) = sent {
            tracing::debug!(%problem, "failed to send a message");
            shared.lock().counters.unsent += 1;
        }
    }
}
