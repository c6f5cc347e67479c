//! Fleet of replicas on the virtual bus.

use consort_bus::virtual_bus::{LinkModel, VirtualNetwork};
use consort_bus::{Bus as _, PresenceToken, SharedBus};
use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::keys::{Key, Keys};
use consort_raft::{Epoch, LeadershipView, LogStore, MemoryLogStore, RaftId, RaftSettings, Replica, StateMachine};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

pub(crate) const TIMEOUT: Duration = Duration::from_secs(5);
pub(crate) const NAMES: [&str; 7] = ["ada", "bob", "cyd", "dan", "eve", "fay", "gus"];

/// List of numbers, each with its log position.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct NumberList {
    pub(crate) written: Vec<(Epoch, u64)>,
    pub(crate) ballast: Vec<u8>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) enum NumberCommand {
    Append(u64),
    Grow(usize),
    /// Fills the ballast with bytes that do not repeat.
    Fill(usize),
    /// Has no effect.
    Pad(Vec<u8>),
}

impl StateMachine for NumberList {
    type Command = NumberCommand;
    type Outcome = Epoch;

    fn apply(&mut self, at: Epoch, command: NumberCommand) -> Epoch {
        match command {
            NumberCommand::Append(number) => self.written.push((at, number)),
            NumberCommand::Grow(bytes) => self.ballast.resize(bytes, 7),
            NumberCommand::Fill(bytes) => {
                self.ballast = vec![0; bytes];
                ChaCha8Rng::seed_from_u64(7).fill_bytes(&mut self.ballast);
            }
            NumberCommand::Pad(_) => {}
        }
        at
    }
}

impl NumberList {
    pub(crate) fn numbers(&self) -> Vec<u64> {
        self.written.iter().map(|(_, number)| *number).collect()
    }
}

pub(crate) fn node(name: &str) -> NodeId {
    NodeId::new(name).expect("a slug")
}

/// Runs a test on virtual time.
pub(crate) fn on_virtual_time<T>(test: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .start_paused(true)
        .build()
        .expect("a runtime")
        .block_on(test)
}

pub(crate) struct Fleet {
    pub(crate) seed: u64,
    pub(crate) network: VirtualNetwork,
    pub(crate) settings: fn(NodeId) -> RaftSettings,
    pub(crate) replicas: BTreeMap<NodeId, Replica<NumberList>>,
    pub(crate) log_stores: BTreeMap<NodeId, MemoryLogStore>,
    pub(crate) started_at: Instant,
    pub(crate) starts: u64,
    /// Layer over the bus of each node.
    bus_layer: BusLayer,
}

/// Returns the bus of a node with a layer over it.
pub(crate) type BusLayer = Box<dyn Fn(SharedBus) -> SharedBus>;

pub(crate) fn default_settings(node: NodeId) -> RaftSettings {
    RaftSettings::new(fleet_id(), node)
}

fn fleet_id() -> FleetId {
    FleetId::new("ward").expect("a slug")
}

/// Returns the keys of the fleet.
pub(crate) fn keys() -> Keys {
    Keys::new(&fleet_id())
}

pub(crate) fn with_short_logs(node: NodeId) -> RaftSettings {
    RaftSettings { snapshot_every: 20, log_entries_kept: 5, ..default_settings(node) }
}

impl Fleet {
    /// Starts `size` nodes and bootstraps the cluster; there is no leader yet.
    pub(crate) async fn bootstrapped(seed: u64, size: usize, settings: fn(NodeId) -> RaftSettings) -> Fleet {
        Fleet::bootstrapped_on(seed, size, settings, Box::new(|bus| bus)).await
    }

    /// Same, with a layer over the bus of each node.
    pub(crate) async fn bootstrapped_on(
        seed: u64,
        size: usize,
        settings: fn(NodeId) -> RaftSettings,
        bus_layer: BusLayer,
    ) -> Fleet {
        let mut fleet = Fleet {
            seed,
            network: VirtualNetwork::new(seed, LinkModel::LAN),
            settings,
            replicas: BTreeMap::new(),
            log_stores: BTreeMap::new(),
            started_at: Instant::now(),
            starts: 0,
            bus_layer,
        };
        for name in &NAMES[..size] {
            fleet.start_empty(name).await;
        }
        let members: BTreeMap<_, _> =
            fleet.replicas.iter().map(|(name, replica)| (replica.id(), name.clone())).collect();
        fleet.on("ada").bootstrap(members).await.expect("the first bootstrap");
        fleet
    }

    /// Starts a node with a new, empty log store.
    pub(crate) async fn start_empty(&mut self, name: &str) -> RaftId {
        self.starts += 1;
        let seed = self.seed.wrapping_mul(1000) + self.starts;
        self.log_stores.insert(node(name), MemoryLogStore::new(seed));
        self.start(name).await
    }

    /// Starts a node with its previous log store.
    pub(crate) async fn start(&mut self, name: &str) -> RaftId {
        self.starts += 1;
        let seed = self.seed.wrapping_mul(1000) + self.starts;
        let log_store: Arc<dyn LogStore> = Arc::new(self.log_stores[&node(name)].clone());
        let bus = (self.bus_layer)(Arc::new(self.network.bus(node(name))));
        let replica = Replica::start((self.settings)(node(name)), bus, log_store, seed).await.expect("a start");
        let id = replica.id();
        self.replicas.insert(node(name), replica);
        id
    }

    /// Announces the presence of a node until the token is dropped.
    pub(crate) async fn announce(&self, name: &NodeId) -> PresenceToken {
        let key = keys().write(&Key::AliveNode(name.clone()));
        self.network.bus(name.clone()).announce(&key).await.expect("a token")
    }

    /// Announces the presence of all nodes.
    pub(crate) async fn announce_all(&self) -> BTreeMap<NodeId, PresenceToken> {
        let mut tokens = BTreeMap::new();
        for name in self.replicas.keys() {
            tokens.insert(name.clone(), self.announce(name).await);
        }
        tokens
    }

    /// Stops a node as a power failure does.
    pub(crate) fn kill(&mut self, name: &NodeId) {
        self.network.crash(name);
        self.replicas.remove(name).expect("a live node");
    }

    pub(crate) fn on(&self, name: &str) -> &Replica<NumberList> {
        &self.replicas[&node(name)]
    }

    pub(crate) fn view(&self, name: &NodeId) -> LeadershipView {
        self.replicas[name].leadership().borrow().clone()
    }

    /// Returns the nodes that count themselves leader at this moment.
    pub(crate) fn leaders(&self) -> Vec<NodeId> {
        self.replicas.keys().filter(|name| self.view(name).is_leader).cloned().collect()
    }

    /// Waits until `is_met` returns true; checks it every virtual millisecond.
    pub(crate) async fn until(&self, condition: &str, mut is_met: impl FnMut(&Fleet) -> bool) {
        let started_at = Instant::now();
        while !is_met(self) {
            assert!(
                started_at.elapsed() < Duration::from_secs(20),
                "timed out waiting until {condition}, seed {}",
                self.seed
            );
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    pub(crate) async fn leader(&self) -> NodeId {
        self.until("there is a single leader", |fleet| fleet.leaders().len() == 1).await;
        self.leaders().remove(0)
    }

    /// Cuts a follower off, and commits a large state and `count` numbers without it. Returns the follower.
    pub(crate) async fn advance_without_follower(&self, count: u64) -> NodeId {
        let leader = self.leader().await;
        let lost = self.replicas.keys().find(|name| **name != leader).expect("three nodes").clone();
        let others = self.replicas.keys().filter(|name| **name != lost).cloned().collect();
        self.network.partition([vec![lost.clone()], others]);
        let numbers = (0..count).map(NumberCommand::Append);
        for command in [NumberCommand::Grow(300_000)].into_iter().chain(numbers) {
            self.replicas[&leader].propose(command, Duration::from_secs(2)).await.expect("a commit");
        }
        lost
    }

    /// Appends a number through the current leader, and retries until it succeeds; returns its log
    /// position.
    pub(crate) async fn write(&self, number: u64) -> Epoch {
        loop {
            let leader = self.leader().await;
            if let Ok(at) =
                self.replicas[&leader].propose(NumberCommand::Append(number), Duration::from_millis(500)).await
            {
                return at;
            }
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    pub(crate) async fn until_all_hold(&self, count: usize) {
        self.until("all replicas have applied everything", |fleet| {
            fleet.replicas.values().all(|replica| replica.read(|list| list.written.len()) >= count)
        })
        .await;
    }

    /// Waits until all nodes have applied the same entries. These include all acknowledged entries:
    /// a leader applies an entry before it acknowledges it.
    pub(crate) async fn until_all_agree(&self) {
        self.until("all replicas have the same state", |fleet| {
            let mut states = fleet.replicas.values().map(|replica| replica.read(NumberList::clone));
            let first = states.next();
            states.all(|list| Some(&list) == first.as_ref())
        })
        .await;
    }

    /// Returns the state of all nodes, which must be identical.
    pub(crate) fn common(&self) -> NumberList {
        let mut all = self.replicas.values().map(|replica| replica.read(NumberList::clone));
        let first = all.next().expect("a live node");
        for other in all {
            assert_eq!(first, other, "seed {}", self.seed);
        }
        first
    }
}
