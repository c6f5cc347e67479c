//! A node that leads a ledger alone, for unit tests.

use consort_bus::clock::Clock;
use consort_bus::{LinkModel, SharedBus, VirtualNetwork};
use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::keys::Keys;
use consort_protocol::ledger::Ledger;
use consort_raft::{MemoryLogStore, RaftSettings, Replica};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// The only voter of a ledger on a virtual bus.
pub(super) struct TestLeader {
    pub(super) network: VirtualNetwork,
    pub(super) node: NodeId,
    pub(super) keys: Keys,
    pub(super) bus: SharedBus,
    pub(super) clock: Clock,
    pub(super) replica: Replica<Ledger>,
}

impl TestLeader {
    /// Starts the node, and waits until it leads.
    pub(super) async fn start() -> TestLeader {
        let (fleet, node) = (FleetId::new("ward").unwrap(), NodeId::new("ada").unwrap());
        let network = VirtualNetwork::new(1, LinkModel::steady(Duration::from_millis(1)));
        let bus: SharedBus = Arc::new(network.bus(node.clone()));
        let (keys, clock) = (Keys::new(&fleet), Clock::virtual_at(0));
        let (settings, log_store) = (RaftSettings::new(fleet, node.clone()), Arc::new(MemoryLogStore::new(1)));
        let replica = Replica::<Ledger>::start(settings, Arc::clone(&bus), log_store, 1).await.unwrap();
        replica.bootstrap(BTreeMap::from([(replica.id(), node.clone())])).await.unwrap();
        replica.leadership().wait_for(|now| now.is_leader).await.unwrap();
        TestLeader { network, node, keys, bus, clock, replica }
    }
}
