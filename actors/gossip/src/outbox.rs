//! Outgoing messages of the actor: their keys and their encoding.

use super::shared::SharedKnowledge;
use bytes::Bytes;
use consort_bus::wire_version::WireVersion;
use consort_bus::{Query, SharedBus};
use consort_protocol::codec::{self, VersionedMessage};
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::knowledge::MotionUpdate;
use consort_protocol::message::{Exchange, RecordUpdate};

/// Capacity of an outbox, in messages.
const CAPACITY: usize = 1024;

/// Outgoing messages. Those that are not sent are counted. Records and replies may wait for a slow link, and a late packet
/// of failure detection ends its sender, so packets have an outbox of their own.
pub(super) struct Outbox {
    node: NodeId,
    keys: Keys,
    wire_version: WireVersion,
    shared: SharedKnowledge,
    messages: consort_bus::Outbox,
    packets: consort_bus::Outbox,
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
        let count_unsent = move || counted.lock().counters.unsent += 1;
        let (messages, sending) = consort_bus::Outbox::new(bus.clone(), CAPACITY, count_unsent.clone());
        let (packets, sending_packets) = consort_bus::Outbox::new(bus, CAPACITY, count_unsent);
        let task = async move {
            tokio::join!(sending, sending_packets);
        };
        (Outbox { node, keys, wire_version, shared, messages, packets }, task)
    }

    /// Publishes an update of the own record.
    pub(super) fn publish(&self, update: RecordUpdate) {
        let key = self.keys.write(&Key::Knowledge(self.node.clone()));
        self.count(self.messages.publish(key, self.encode(update)));
    }

    /// Publishes the motion of the own robot.
    pub(super) fn publish_motion(&self, update: &MotionUpdate) {
        let key = self.keys.write(&Key::Motion(self.node.clone()));
        let bytes = codec::encode(update).expect("the size of a place is limited");
        self.count(self.messages.publish(key, bytes.into()));
    }

    /// Sends a packet of failure detection.
    pub(super) fn send(&self, to: NodeId, packet: Bytes) {
        self.count(self.packets.publish(self.keys.write(&Key::Swim(to)), packet));
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

#[cfg(test)]
mod tests {
    use super::*;
    use consort_bus::{Author, Bus as _, BusError, Encoding, LinkModel, Replier, RequestAuthority, VirtualNetwork};
    use consort_protocol::ids::FleetId;
    use consort_protocol::knowledge::{Digest, DigestScope};
    use ractor::async_trait;
    use std::sync::Arc;
    use std::time::Duration;

    /// A replier that never finishes sending, as on a link that transmits nothing.
    struct Stalled;

    #[async_trait]
    impl Replier for Stalled {
        async fn reply_with_attachment(&self, _: &str, _: Bytes, _: Bytes, _: Encoding) -> Result<(), BusError> {
            std::future::pending().await
        }

        async fn refuse(&self, _: &str) -> Result<(), BusError> {
            std::future::pending().await
        }
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn a_reply_on_a_slow_link_delays_no_packet() {
        let (ada, bob) = (NodeId::new("ada").unwrap(), NodeId::new("bob").unwrap());
        let keys = Keys::new(&FleetId::new("ward").unwrap());
        let network = VirtualNetwork::new(1, LinkModel::LAN);
        let mut packets = network.bus(bob.clone()).subscribe(&keys.write(&Key::Swim(bob.clone()))).await.unwrap();
        let bus: SharedBus = Arc::new(network.bus(ada.clone()));
        let (outbox, sending) =
            Outbox::new(ada.clone(), keys.clone(), WireVersion::default(), SharedKnowledge::default(), bus);
        let query = Query {
            key: keys.write(&Key::Gossip(ada)),
            parameters: String::new(),
            payload: Bytes::new(),
            attachment: Bytes::new(),
            author: Author::UNKNOWN,
            authority: RequestAuthority::Unchecked,
            replier: Box::new(Stalled),
        };
        let exchange = Exchange { sums: vec![], scope: DigestScope::NONE, digest: Digest::new(), records: vec![] };
        outbox.reply(query, exchange);
        outbox.send(bob, Bytes::from_static(b"ping"));
        tokio::select! {
            () = sending => panic!("the outbox has ended"),
            received = packets.recv() => assert_eq!(received.unwrap().payload, "ping"),
            () = tokio::time::sleep(Duration::from_secs(9)) => panic!("the packet waits for the reply"),
        }
    }
}
