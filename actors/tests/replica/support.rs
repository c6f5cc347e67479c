//! A fleet of replicas on the virtual bus, and what it agrees on.

use consort_actors::bus::SharedBus;
use consort_actors::bus::virtual_bus::{LinkModel, VirtualNetwork};
use consort_actors::raft::{
    Epoch, LeadershipView, LogStore, MemoryLogStore, RaftId, RaftSettings, Replica, StateMachine,
};
use consort_protocol::ids::{FleetId, NodeId};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

pub(crate) const TIMEOUT: Duration = Duration::from_secs(5);
pub(crate) const NAMES: [&str; 7] = ["ada", "bob", "cyd", "dan", "eve", "fay", "gus"];

/// A list of numbers, each with the place at which it was written.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct NumberList {
    pub(crate) written: Vec<(Epoch, u64)>,
    pub(crate) ballast: Vec<u8>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) enum NumberCommand {
    Append(u64),
    Grow(usize),
}

impl StateMachine for NumberList {
    type Command = NumberCommand;
    type Outcome = Epoch;

    fn apply(&mut self, at: Epoch, command: NumberCommand) -> Epoch {
        match command {
            NumberCommand::Append(number) => self.written.push((at, number)),
            NumberCommand::Grow(bytes) => self.ballast.resize(bytes, 7),
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

/// Runs a story on virtual time.
pub(crate) fn on_virtual_time<T>(story: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .start_paused(true)
        .build()
        .expect("runtime")
        .block_on(story)
}

pub(crate) struct Fleet {
    pub(crate) seed: u64,
    pub(crate) network: VirtualNetwork,
    pub(crate) settings: fn(NodeId) -> RaftSettings,
    pub(crate) replicas: BTreeMap<NodeId, Replica<NumberList>>,
    pub(crate) log_stores: BTreeMap<NodeId, MemoryLogStore>,
    pub(crate) began: Instant,
    pub(crate) starts: u64,
}

pub(crate) fn default_settings(node: NodeId) -> RaftSettings {
    RaftSettings::new(FleetId::new("ward").expect("a slug"), node)
}

pub(crate) fn with_short_logs(node: NodeId) -> RaftSettings {
    RaftSettings { snapshot_every: 20, log_entries_kept: 5, ..default_settings(node) }
}

impl Fleet {
    /// `size` nodes that have met and founded a fleet; no leader yet.
    pub(crate) async fn bootstrapped(seed: u64, size: usize, settings: fn(NodeId) -> RaftSettings) -> Fleet {
        let mut fleet = Fleet {
            seed,
            network: VirtualNetwork::new(seed, LinkModel::LAN),
            settings,
            replicas: BTreeMap::new(),
            log_stores: BTreeMap::new(),
            began: Instant::now(),
            starts: 0,
        };
        for name in &NAMES[..size] {
            fleet.start_empty(name).await;
        }
        let members: BTreeMap<_, _> =
            fleet.replicas.iter().map(|(name, replica)| (replica.id(), name.clone())).collect();
        fleet.on("ada").bootstrap(members).await.expect("a first founding");
        fleet
    }

    /// Starts a node with a store of its own that nobody has written to.
    pub(crate) async fn start_empty(&mut self, name: &str) -> RaftId {
        self.starts += 1;
        let seed = self.seed.wrapping_mul(1000) + self.starts;
        self.log_stores.insert(node(name), MemoryLogStore::new(seed));
        self.start(name).await
    }

    /// Starts a node with the store it had.
    pub(crate) async fn start(&mut self, name: &str) -> RaftId {
        self.starts += 1;
        let seed = self.seed.wrapping_mul(1000) + self.starts;
        let disk: Arc<dyn LogStore> = Arc::new(self.log_stores[&node(name)].clone());
        let bus: SharedBus = Arc::new(self.network.bus(node(name)));
        let replica = Replica::start((self.settings)(node(name)), bus, disk, seed).await.expect("a start");
        let id = replica.id();
        self.replicas.insert(node(name), replica);
        id
    }

    /// Ends a node as a power cut does.
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

    /// Who count themselves leader at this moment.
    pub(crate) fn leaders(&self) -> Vec<NodeId> {
        self.replicas.keys().filter(|name| self.view(name).is_leader).cloned().collect()
    }

    /// Waits until `done`, looking every virtual millisecond.
    pub(crate) async fn until(&self, what: &str, mut done: impl FnMut(&Fleet) -> bool) {
        let began = Instant::now();
        while !done(self) {
            assert!(began.elapsed() < Duration::from_secs(20), "waited in vain until {what}, seed {}", self.seed);
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    pub(crate) async fn leader(&self) -> NodeId {
        self.until("there is one leader", |fleet| fleet.leaders().len() == 1).await;
        self.leaders().remove(0)
    }

    /// Writes a number through whoever leads, as often as it takes; tells where it stands.
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
        self.until("all have applied everything", |fleet| {
            fleet.replicas.values().all(|replica| replica.read(|tally| tally.written.len()) >= count)
        })
        .await;
    }

    /// Waits until all have applied the same, which is all that was acknowledged: whoever leads had it applied before.
    pub(crate) async fn until_all_agree(&self) {
        self.until("all hold the same", |fleet| {
            let mut held = fleet.replicas.values().map(|replica| replica.read(NumberList::clone));
            let first = held.next();
            held.all(|tally| Some(&tally) == first.as_ref())
        })
        .await;
    }

    /// What all nodes hold, which must be one and the same.
    pub(crate) fn common(&self) -> NumberList {
        let mut all = self.replicas.values().map(|replica| replica.read(NumberList::clone));
        let first = all.next().expect("a live node");
        for other in all {
            assert_eq!(first, other, "seed {}", self.seed);
        }
        first
    }
}
