//! A replicated ledger on the virtual bus: elections, crashes, partitions, restarts.

use consort_actors::replica::{
    Epoch, Journal, Leadership, MemberError, MemoryJournal, ProposeError, RaftId, Reign, Replica, ReplicaSettings,
    StateMachine,
};
use consort_protocol::ids::{FleetId, NodeId};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

#[path = "replica_tiny.rs"]
mod replica_tiny;
use replica_tiny::VirtualNetwork;

const SOON: Duration = Duration::from_secs(5);
const NAMES: [&str; 7] = ["ada", "bob", "cyd", "dan", "eve", "fay", "gus"];

/// A list of numbers, each with the place at which it was written.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Tally {
    written: Vec<(Epoch, u64)>,
    ballast: Vec<u8>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
enum Ask {
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
    fn numbers(&self) -> Vec<u64> {
        self.written.iter().map(|(_, number)| *number).collect()
    }
}

fn node(name: &str) -> NodeId {
    NodeId::new(name).expect("a slug")
}

/// Runs a story on virtual time.
fn on_virtual_time<T>(story: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().expect("runtime").block_on(story)
}

struct Fleet {
    seed: u64,
    network: VirtualNetwork,
    settings: fn(NodeId) -> ReplicaSettings,
    live: BTreeMap<NodeId, Replica<Tally>>,
    disks: BTreeMap<NodeId, MemoryJournal>,
    began: Instant,
    starts: u64,
}

fn usual(node: NodeId) -> ReplicaSettings {
    ReplicaSettings::new(FleetId::new("ward").expect("a slug"), node)
}

fn with_short_logs(node: NodeId) -> ReplicaSettings {
    ReplicaSettings { snapshot_every: 20, log_kept: 5, ..usual(node) }
}

impl Fleet {
    /// `size` nodes that have met and founded a fleet; no leader yet.
    async fn founded(seed: u64, size: usize, settings: fn(NodeId) -> ReplicaSettings) -> Fleet {
        let mut fleet = Fleet {
            seed,
            network: VirtualNetwork::new(seed),
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
    async fn start_empty(&mut self, name: &str) -> RaftId {
        self.starts += 1;
        let seed = self.seed.wrapping_mul(1000) + self.starts;
        self.disks.insert(node(name), MemoryJournal::new(seed));
        self.start(name).await
    }

    /// Starts a node with the store it had.
    async fn start(&mut self, name: &str) -> RaftId {
        self.starts += 1;
        let seed = self.seed.wrapping_mul(1000) + self.starts;
        let disk: Arc<dyn Journal> = Arc::new(self.disks[&node(name)].clone());
        let bus = self.network.bus(node(name));
        let replica = Replica::start((self.settings)(node(name)), bus, disk, seed).await.expect("a start");
        let id = replica.id();
        self.live.insert(node(name), replica);
        id
    }

    /// Ends a node as a power cut does.
    fn kill(&mut self, name: &NodeId) {
        self.network.crash(name);
        self.live.remove(name).expect("a live node");
    }

    fn on(&self, name: &str) -> &Replica<Tally> {
        &self.live[&node(name)]
    }

    fn believed(&self, name: &NodeId) -> Leadership {
        self.live[name].leadership().borrow().clone()
    }

    /// Who count themselves leader at this moment.
    fn leaders(&self) -> Vec<NodeId> {
        self.live.keys().filter(|name| self.believed(name).is_me).cloned().collect()
    }

    /// Waits until `done`, looking every virtual millisecond.
    async fn until(&self, what: &str, mut done: impl FnMut(&Fleet) -> bool) {
        let began = Instant::now();
        while !done(self) {
            assert!(began.elapsed() < Duration::from_secs(20), "waited in vain until {what}, seed {}", self.seed);
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    async fn leader(&self) -> NodeId {
        self.until("there is one leader", |fleet| fleet.leaders().len() == 1).await;
        self.leaders().remove(0)
    }

    /// Writes a number through whoever leads, as often as it takes; tells where it stands.
    async fn note(&self, number: u64) -> Epoch {
        loop {
            let leader = self.leader().await;
            if let Ok(at) = self.live[&leader].propose(Ask::Note(number), Duration::from_millis(500)).await {
                return at;
            }
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    async fn until_all_hold(&self, count: usize) {
        self.until("all have applied everything", |fleet| {
            fleet.live.values().all(|replica| replica.read(|tally| tally.written.len()) >= count)
        })
        .await;
    }

    /// What all nodes hold, which must be one and the same.
    fn common(&self) -> Tally {
        let mut all = self.live.values().map(|replica| replica.read(Tally::clone));
        let first = all.next().expect("a live node");
        for other in all {
            assert_eq!(first, other, "seed {}", self.seed);
        }
        first
    }
}

#[test]
fn three_and_five_nodes_elect_one_leader_and_apply_all_writes_in_one_order() {
    for size in [3, 5] {
        on_virtual_time(async {
            let fleet = Fleet::founded(1, size, usual).await;
            let leader = fleet.leader().await;
            for number in 0..300 {
                fleet.live[&leader].propose(Ask::Note(number), SOON).await.expect("a commit");
            }
            fleet.until_all_hold(300).await;
            assert_eq!(fleet.common().numbers(), (0..300).collect::<Vec<_>>());
            assert!(fleet.common().written.is_sorted());
            for name in fleet.live.keys() {
                let believed = fleet.believed(name);
                assert_eq!(believed.leader, Some(leader.clone()));
                assert_eq!(believed.voters.len(), size);
                assert_eq!(believed.is_me, *name == leader);
            }
        });
    }
}

#[test]
fn a_killed_leader_is_replaced_and_nothing_acknowledged_is_lost() {
    for seed in 0..50 {
        on_virtual_time(async {
            let mut fleet = Fleet::founded(seed, 5, usual).await;
            let mut acknowledged = BTreeMap::new();
            for round in 0..2 {
                for number in round * 100..round * 100 + 20 {
                    acknowledged.insert(fleet.note(number).await, number);
                }
                // One more is under way when the leader dies: whether it is committed, nobody can say.
                let leader = fleet.leader().await;
                let dying = fleet.live[&leader].clone();
                let open = tokio::spawn(async move { dying.propose(Ask::Note(1_000_000 + round), SOON).await });
                tokio::time::sleep(Duration::from_micros(500)).await;
                open.abort();
                fleet.kill(&leader);
                acknowledged.insert(fleet.note(round * 100 + 50).await, round * 100 + 50);
            }
            fleet.until_all_hold(acknowledged.len()).await;
            tokio::time::sleep(SOON).await;
            let held: BTreeMap<_, _> = fleet.common().written.into_iter().collect();
            for (at, number) in acknowledged {
                assert_eq!(held.get(&at), Some(&number), "at {at}, seed {seed}");
            }
        });
    }
}
