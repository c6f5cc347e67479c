//! Outgoing messages of the actor: their keys and their encoding.

use super::shared::SharedKnowledge;
use bytes::Bytes;
use consort_bus::wire_version::WireVersion;
use consort_bus::{Query, SharedBus};
use consort_protocol::codec::{self, VersionedMessage};
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::message::{Exchange, RecordUpdate};

/// Capacity of the outbox, in messages.
const CAPACITY: usize = 1024;

/// Outgoing messages. Those that are not sent are counted.
pub(super) struct Outbox {
    node: NodeId,
    keys: Keys,
    wire_version: WireVersion,
    shared: SharedKnowledge,
    messages: consort_bus::Outbox,
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
        let counted = shared.clone();
        let (messages, task) = consort_bus::Outbox::new(bus, CAPACITY, move || counted.lock().counters.unsent += 1);
        (Outbox { node, keys, wire_version, shared, messages }, task)
    }

    /// Publishes an update of the own record.
    pub(super) fn publish(&self, update: RecordUpdate) {
        let key = self.keys.write(&Key::Knowledge(self.node.clone()));
        self.count(self.messages.publish(key, self.encode(update)));
    }

    /// Sends a packet of failure detection.
    pub(super) fn send(&self, to: NodeId, packet: Bytes) {
        self.count(self.messages.publish(self.keys.write(&Key::Swim(to)), packet));
    }

    /// Replies to a peer.
    pub(super) fn reply(&self, query: Query, exchange: Exchange) {
        let own_key = self.keys.write(&Key::Gossip(self.node.clone()));
        self.count(self.messages.reply(query, own_key, self.encode(exchange)));
    }

    /// Encodes a message in the wire version of the fleet.
    pub(super) fn encode<T: VersionedMessage>(&self, message: T) -> Bytes {
        let bytes = codec::encode_for_version(self.wire_version.get(), message);
        bytes.expect("the size of records and exchanges is limited on creation").into()
    }

    fn count(&self, accepted: bool) {
        if !accepted {
            self.shared.lock().counters.unsent += 1;
        }
    }
}
