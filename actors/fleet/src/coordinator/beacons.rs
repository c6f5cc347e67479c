//! Beacons of a coordinator. A task beside the coordinator actor publishes them, so they do not wait behind its work.

use super::settings::NodeParts;
use bytes::Bytes;
use consort_bus::clock::Clock;
use consort_bus::{Delivery, Encoding, SharedBus};
use consort_protocol::codec;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::ledger::Ledger;
use consort_protocol::message::Beacon;
use consort_protocol::units::NodeTime;
use consort_raft::Replica;
use std::time::Duration;
use tokio::time::sleep;
use tracing::debug;

/// Publisher of the beacons of a session: the node, term and voters of the coordinator.
#[derive(Clone)]
pub(super) struct Beacons {
    node: NodeId,
    term: u64,
    /// Start of the session.
    since: NodeTime,
    clock: Clock,
    replica: Replica<Ledger>,
    bus: SharedBus,
    keys: Keys,
}

impl Beacons {
    /// Creates the publisher of a session that starts now.
    pub(super) fn new(NodeParts { node, clock, replica, bus, keys, .. }: &NodeParts, term: u64) -> Beacons {
        let (node, clock, replica) = (node.clone(), *clock, replica.clone());
        Beacons { node, term, since: clock.now(), clock, replica, bus: bus.clone(), keys: keys.clone() }
    }

    /// Publishes a beacon.
    pub(super) async fn publish(&self) {
        let elapsed = self.clock.now().since(self.since);
        let beacon = Beacon {
            node: self.node.clone(),
            term: self.term,
            voters: self.replica.leadership().borrow().voters.values().cloned().collect(),
            since_ms: u64::try_from(elapsed.as_millis()).unwrap_or(u64::MAX),
            cluster: *self.replica.cluster().borrow(),
            wire: self.replica.read(Ledger::wire),
        };
        let bytes = Bytes::from(codec::encode(&beacon).expect("a beacon fits a message"));
        let key = self.keys.write(&Key::Beacon);
        if let Err(problem) = self.bus.publish(&key, bytes, Encoding::Wire, Delivery::Drop).await {
            debug!(%problem, key, "not published");
        }
    }

    /// Publishes a beacon at each interval, first after one interval. The actor may notice the end of its term late, so a node that
    /// does not lead publishes none.
    pub(super) async fn publish_at_intervals(self, interval: Duration) {
        loop {
            sleep(interval).await;
            if self.is_leader() {
                self.publish().await;
            }
        }
    }

    fn is_leader(&self) -> bool {
        let leadership = self.replica.leadership();
        let now = leadership.borrow();
        now.is_leader && now.term == self.term
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_leader::TestLeader;
    use super::*;
    use consort_bus::Bus as _;

    /// Returns the number of beacons of a session of this term in 2 s.
    async fn beacons_of(later: u64) -> usize {
        let TestLeader { network, node, keys, bus, clock, replica } = TestLeader::start().await;
        let observer = network.bus("bob".parse().unwrap());
        let mut received = observer.subscribe(&keys.write(&Key::Beacon)).await.unwrap();
        let (term, since) = (replica.leadership().borrow().term + later, clock.now());
        let beacons = Beacons { node, term, since, clock, replica, bus, keys };
        tokio::spawn(beacons.publish_at_intervals(Duration::from_millis(250)));
        sleep(Duration::from_millis(2100)).await;
        std::iter::from_fn(|| received.try_recv()).count()
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn only_the_leader_publishes_beacons() {
        assert_eq!(beacons_of(0).await, 8);
        assert_eq!(beacons_of(1).await, 0, "the node leads in another term");
    }
}
