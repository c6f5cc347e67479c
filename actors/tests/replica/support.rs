//! A fleet of replicas on the virtual bus, and what it agrees on.

use consort_actors::bus::SharedBus;
use consort_actors::bus::virtual_bus::{LinkModel, VirtualNetwork};
use consort_actors::replica::{
    Epoch, Journal, Leadership, MemoryJournal, RaftId, Replica, ReplicaSettings, StateMachine,
};
use consort_protocol::ids::{FleetId, NodeId};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

pub(crate) const SOON: Duration = Duration::from_secs(5);
pub(crate) const NAMES: [&str; 7] = ["ada", "bob", "cyd", "dan", "eve", "fay", "gus"];

/// A list of numbers, each with the place at which it was written.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Tally {
    pub(crate) written: Vec<(Epoch, u64)>,
    pub(crate) ballast: Vec<u8>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) enum Ask {
    Note(u64),
    Grow(usize),
}

impl StateMachine for Tally {
    type Command = Ask;
    type Outcome = Epoch;

    fn apply(&mut self, at: Epoch, command: Ask) -> Epoch {
        match command {
            Ask::Note(number) => self.written.push((at, number)),
            Ask::Grow(bytes) => self.ballast.resize(bytes, 7),
        }
        at
    }
}

impl Tally {
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
    pub(crate) settings: fn(NodeId) -> ReplicaSettings,
    pub(crate) live: BTreeMap<NodeId, Replica<Tally>>,
    pub(crate) disks: BTreeMap<NodeId, MemoryJournal>,
    pub(crate) began: Instant,
    pub(crate) starts: u64,
}

pub(crate) fn usual(node: NodeId) -> ReplicaSettings {
    ReplicaSettings::new(FleetId::new("ward").expect("a slug"), node)
}

pub(crate) fn with_short_logs(node: NodeId) -> ReplicaSettings {
    ReplicaSettings { snapshot_every: 20, log_kept: 5, ..usual(node) }
}

impl Fleet {
    /// `size` nodes that have met and founded a fleet; no leader yet.
    pub(crate) async fn founded(seed: u64, size: usize, settings: fn(NodeId) -> ReplicaSettings) -> Fleet {
        let mut fleet = Fleet {
            seed,
            network: VirtualNetwork::new(seed, LinkModel::LAN),
            settings,
            live: BTreeMap::new(),
            disks: BTreeMap::new(),
            began: Instant::now(),
            starts: 0,
        };
        for name in &NAMES[..size] {
            fleet.start_empty(name).await;
        }
        let members: BTreeMap<_, _> = fleet.live.iter().map(|(name, replica)| (replica.id(), name.clone())).collect();
        fleet.on("ada").bootstrap(members).await.expect("a first founding");
        fleet
    }

    /// Starts a node with a store of its own that nobody has written to.
    pub(crate) async fn start_empty(&mut self, name: &str) -> RaftId {
        self.starts += 1;
        let seed = self.seed.wrapping_mul(1000) + self.starts;
        self.disks.insert(node(name), MemoryJournal::new(seed));
        self.start(name).await
    }

    /// Starts a node with the store it had.
    pub(crate) async fn start(&mut self, name: &str) -> RaftId {
        self.starts += 1;
        let seed = self.seed.wrapping_mul(1000) + self.starts;
        let disk: Arc<dyn Journal> = Arc::new(self.disks[&node(name)].clone());
        let bus: SharedBus = Arc::new(self.network.bus(node(name)));
        let replica = Replica::start((self.settings)(node(name)), bus, disk, seed).await.expect("a start");
        let id = replica.id();
        self.live.insert(node(name), replica);
        id
    }

    /// Ends a node as a power cut does.
    pub(crate) fn kill(&mut self, name: &NodeId) {
        self.network.crash(name);
        self.live.remove(name).expect("a live node");
    }

    pub(crate) fn on(&self, name: &str) -> &Replica<Tally> {
        &self.live[&node(name)]
    }

    pub(crate) fn believed(&self, name: &NodeId) -> Leadership {
        self.live[name].leadership().borrow().clone()
    }

    /// Who count themselves leader at this moment.
    pub(crate) fn leaders(&self) -> Vec<NodeId> {
        self.live.keys().filter(|name| self.believed(name).is_me).cloned().collect()
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
    pub(crate) async fn note(&self, number: u64) -> Epoch {
        loop {
            let leader = self.leader().await;
            if let Ok(at) = self.live[&leader].propose(Ask::Note(number), Duration::from_millis(500)).await {
                return at;
            }
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    pub(crate) async fn until_all_hold(&self, count: usize) {
        self.until("all have applied everything", |fleet| {
            fleet.live.values().all(|replica| replica.read(|tally| tally.written.len()) >= count)
        })
        .await;
    }

    /// Waits until all have applied the same, which is all that was acknowledged: whoever leads had it applied before.
    pub(crate) async fn until_all_agree(&self) {
        self.until("all hold the same", |fleet| {
            let mut held = fleet.live.values().map(|replica| replica.read(Tally::clone));
            let first = held.next();
            held.all(|tally| Some(&tally) == first.as_ref())
        })
        .await;
    }

    /// What all nodes hold, which must be one and the same.
    pub(crate) fn common(&self) -> Tally {
        let mut all = self.live.values().map(|replica| replica.read(Tally::clone));
        let first = all.next().expect("a live node");
        for other in all {
            assert_eq!(first, other, "seed {}", self.seed);
        }
        first
    }
}
