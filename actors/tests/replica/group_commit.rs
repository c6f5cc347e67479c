//! Commands that arrive while an entry is being written share the next one.

use crate::support::{NAMES, TIMEOUT, default_settings, node, on_virtual_time};
use async_trait::async_trait;
use consort_actors::bus::virtual_bus::{LinkModel, VirtualNetwork};
use consort_actors::raft::{
    Epoch, LogStore, MemoryLogStore, PersistentState, ProposeError, Replica, StateMachine, StoreIdentity,
};
use consort_protocol::ids::NodeId;
use futures::future::join_all;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// How long the journal takes to write.
const SLOW: Duration = Duration::from_millis(10);

/// How long a slow disk does, of several voters.
const SLOWER: Duration = Duration::from_millis(120);

/// What was put on it, in order, with its place.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Shelf(Vec<(Epoch, u64)>);

#[derive(Debug, Clone, Serialize, Deserialize)]
enum Put {
    Plain(u64),
    Apart(u64),
    Bulky(u64, Vec<u8>),
    Numbers(u64, Vec<u64>),
}

impl StateMachine for Shelf {
    type Command = Put;
    type Outcome = (Epoch, usize);

    fn apply(
        &mut self,
        at: Epoch,
        (Put::Plain(number) | Put::Apart(number) | Put::Bulky(number, _) | Put::Numbers(number, _)): Put,
    ) -> (Epoch, usize) {
        self.0.push((at, number));
        (at, self.0.len())
    }

    fn grants_epoch(command: &Put) -> bool {
        matches!(command, Put::Apart(_))
    }
}

/// A journal that takes its time to write votes and entries.
#[derive(Clone)]
struct Slow {
    journal: MemoryLogStore,
    sync: Duration,
    /// How many entries each append brought.
    appends: Arc<Mutex<Vec<usize>>>,
}

impl Slow {
    fn new(identity_seed: u64, sync: Duration) -> Slow {
        Slow { journal: MemoryLogStore::new(identity_seed), sync, appends: Arc::default() }
    }
}

#[async_trait]
impl LogStore for Slow {
    fn identity(&self) -> StoreIdentity {
        self.journal.identity()
    }

    async fn load(&self) -> io::Result<PersistentState> {
        self.journal.load().await
    }

    async fn save_vote(&self, vote: Vec<u8>) -> io::Result<()> {
        sleep(self.sync).await;
        self.journal.save_vote(vote).await
    }

    async fn save_committed(&self, committed: Option<Vec<u8>>) -> io::Result<()> {
        self.journal.save_committed(committed).await
    }

    async fn append(&self, entries: Vec<(u64, Vec<u8>)>) -> io::Result<()> {
        self.appends.lock().unwrap().push(entries.len());
        sleep(self.sync).await;
        self.journal.append(entries).await
    }

    async fn truncate(&self, index: u64) -> io::Result<()> {
        self.journal.truncate(index).await
    }

    async fn purge(&self, index: u64, last: Vec<u8>) -> io::Result<()> {
        self.journal.purge(index, last).await
    }

    async fn save_snapshot(&self, snapshot: Vec<u8>) -> io::Result<()> {
        self.journal.save_snapshot(snapshot).await
    }
}

/// A node that leads alone, and its journal.
async fn alone() -> (Replica<Shelf>, Slow) {
    let network = VirtualNetwork::new(1, LinkModel::LAN);
    let journal = Slow::new(1, SLOW);
    let bus = Arc::new(network.bus(node("ada")));
    let replica =
        Replica::start(default_settings(node("ada")), bus, Arc::new(journal.clone()), 1).await.expect("a start");
    replica.bootstrap(BTreeMap::from([(replica.id(), node("ada"))])).await.expect("a first founding");
    replica.leadership().wait_for(|now| now.is_leader).await.expect("a replica");
    (replica, journal)
}

/// Proposes all at once, and gives the places they came to stand at.
async fn put_all(replica: &Replica<Shelf>, all: impl Iterator<Item = Put>) -> Vec<(Epoch, usize)> {
    let answers = join_all(all.map(|put| replica.propose(put, TIMEOUT))).await;
    answers.into_iter().map(|answer| answer.expect("a commit")).collect()
}

#[test]
fn many_commands_at_once_share_few_entries_and_keep_their_order() {
    on_virtual_time(async {
        let (replica, _) = alone().await;
        let began = Instant::now();
        let outcomes = put_all(&replica, (0..200).map(Put::Plain)).await;
        assert!(began.elapsed() < SLOW * 4, "{:?}", began.elapsed());
        let places: BTreeSet<Epoch> = outcomes.iter().map(|(at, _)| *at).collect();
        assert!(places.len() <= 2, "{places:?}");
        assert_eq!(outcomes.iter().map(|(_, count)| *count).collect::<Vec<_>>(), (1..=200).collect::<Vec<_>>());
        assert_eq!(replica.read(Shelf::clone).0, (0..).zip(&outcomes).map(|(n, (at, _))| (*at, n)).collect::<Vec<_>>());
    });
}

#[test]
fn a_command_that_comes_alone_waits_for_no_company() {
    on_virtual_time(async {
        let (replica, _) = alone().await;
        let began = Instant::now();
        replica.propose(Put::Plain(1), TIMEOUT).await.expect("a commit");
        assert!(began.elapsed() <= SLOW + Duration::from_millis(1), "{:?}", began.elapsed());
    });
}

#[test]
fn commands_that_grant_epochs_have_one_each() {
    on_virtual_time(async {
        let (replica, _) = alone().await;
        let is_apart = |number: &u64| number % 4 == 1;
        let put = |number| if is_apart(&number) { Put::Apart(number) } else { Put::Plain(number) };
        let outcomes = put_all(&replica, (0..40).map(put)).await;
        let apart: Vec<Epoch> =
            (0..40).zip(&outcomes).filter(|(number, _)| is_apart(number)).map(|(_, (at, _))| *at).collect();
        assert_eq!(apart.iter().collect::<BTreeSet<_>>().len(), 10, "{apart:?}");
        let places: BTreeSet<Epoch> = outcomes.iter().map(|(at, _)| *at).collect();
        assert!(places.len() <= 11, "{places:?}");
        assert_eq!(
            replica.read(Shelf::clone).0.iter().map(|(_, n)| *n).collect::<Vec<_>>(),
            (0..40).collect::<Vec<_>>()
        );
    });
}

#[test]
fn commands_share_an_entry_only_while_it_stays_small() {
    on_virtual_time(async {
        let (replica, journal) = alone().await;
        put_all(&replica, (0..30).map(|number| Put::Bulky(number, vec![7; 5000]))).await;
        let entries = journal.load().await.expect("a journal").entries;
        let longest = entries.values().map(Vec::len).max().expect("entries");
        assert!((15_000..16 * 1024).contains(&longest), "{longest} bytes");
        // One that is larger goes alone.
        put_all(&replica, (0..3).map(|number| Put::Bulky(number, vec![7; 30_000]))).await;
        let entries = journal.load().await.expect("a journal").entries;
        let longest = entries.values().map(Vec::len).max().expect("entries");
        assert!((30_000..31_000).contains(&longest), "{longest} bytes");
    });
}

#[test]
fn a_node_that_does_not_lead_refuses_each_of_many_at_once() {
    on_virtual_time(async {
        let network = VirtualNetwork::new(1, LinkModel::LAN);
        let bus = Arc::new(network.bus(node("ada")));
        let journal = Arc::new(MemoryLogStore::new(1));
        let replica = Replica::<Shelf>::start(default_settings(node("ada")), bus, journal, 1).await.expect("a start");
        let answers = join_all((0..20).map(|number| replica.propose(Put::Plain(number), TIMEOUT))).await;
        assert!(answers.iter().all(|answer| *answer == Err(ProposeError::NotLeader { leader: None })), "{answers:?}");
    });
}

/// Some voters with disks that take their time, and one of them, which leads.
struct Voters {
    network: VirtualNetwork,
    all: BTreeMap<NodeId, Replica<Shelf>>,
    journals: BTreeMap<NodeId, Slow>,
}

impl Voters {
    async fn founded(seed: u64, size: usize, sync: Duration, link: LinkModel) -> Voters {
        let network = VirtualNetwork::new(seed, link);
        let (mut all, mut journals) = (BTreeMap::new(), BTreeMap::new());
        for (number, name) in (1..).zip(&NAMES[..size]) {
            let journal = Slow::new(seed * 10 + number, sync);
            journals.insert(node(name), journal.clone());
            let bus = Arc::new(network.bus(node(name)));
            let replica =
                Replica::<Shelf>::start(default_settings(node(name)), bus, Arc::new(journal), seed * 10 + number).await;
            all.insert(node(name), replica.expect("a start"));
        }
        let members = all.iter().map(|(name, replica)| (replica.id(), name.clone())).collect();
        all[&node("ada")].bootstrap(members).await.expect("a first founding");
        Voters { network, all, journals }
    }

    /// Who leads, and how long it took to become so.
    async fn leader(&self, limit: Duration) -> (NodeId, Replica<Shelf>) {
        let began = Instant::now();
        loop {
            let mut all = self.all.iter();
            if let Some((name, leader)) = all.find(|(_, replica)| replica.leadership().borrow().is_leader) {
                return (name.clone(), leader.clone());
            }
            assert!(began.elapsed() < limit, "nobody leads within {limit:?}");
            sleep(Duration::from_millis(1)).await;
        }
    }
}

/// Three voters whose disks take `slow` for each append: 32 clients ask for 4 kB each, four times over.
async fn three_voters_with_slow_disks(seed: u64, slow: Duration, link: LinkModel) {
    let fleet = Voters::founded(seed, 3, slow, link).await;
    let (_, leader) = fleet.leader(slow * 40).await;
    let voters = &fleet.all;
    let first = leader.leadership().borrow().clone();
    let mut beliefs: Vec<_> = voters.values().map(Replica::leadership).collect();
    let steady = async {
        loop {
            for (name, belief) in voters.keys().zip(&mut beliefs) {
                let now = belief.borrow_and_update();
                assert_eq!(now.term, first.term, "{name}, seed {seed}");
                assert_eq!(now.leader_id, first.leader_id, "{name}, seed {seed}");
            }
            assert!(leader.leadership().borrow().is_leader, "seed {seed}");
            sleep(Duration::from_millis(1)).await;
        }
    };
    // The others have yet to learn of the first entries.
    for replica in voters.values() {
        replica.leadership().wait_for(|now| now.leader_id == first.leader_id).await.expect("a replica");
    }
    let asked = join_all((0..32).map(|client| {
        let leader = leader.clone();
        async move {
            for round in 0..4 {
                let put = Put::Bulky(client * 10 + round, vec![7; 4096]);
                leader.propose(put, slow * 100).await.expect("a commit");
            }
        }
    }));
    tokio::select! {
        () = steady => {}
        _ = asked => {}
    }
    assert_eq!(leader.read(Shelf::clone).0.len(), 128, "seed {seed}");
}

#[test]
fn slow_disks_hold_up_commits_and_cost_no_leader() {
    for seed in 1..=5 {
        on_virtual_time(three_voters_with_slow_disks(seed, SLOWER, LinkModel::LAN));
    }
}

/// Longer than the longest election: those who wait for their disks still say that they are there.
#[test]
fn disks_slower_than_any_election_cost_no_leader_either() {
    for seed in 1..=3 {
        on_virtual_time(three_voters_with_slow_disks(seed, SLOWER * 7, LinkModel::LAN));
    }
}

/// The longest sync with which a leader can be elected, as `nodes/docs/operations.md` has it, less a little.
const SLOWEST: Duration = Duration::from_millis(900);

#[test]
fn voters_with_slow_disks_elect_a_leader_and_the_next_one_within_some_ten_syncs() {
    for (seed, size) in (1..=5).flat_map(|seed| [(seed, 3), (seed, 5)]) {
        for sync in [SLOWER * 2, SLOWEST] {
            on_virtual_time(async {
                let mut fleet = Voters::founded(seed, size, sync, LinkModel::LAN).await;
                for round in 0..2 {
                    let (name, leader) = fleet.leader(sync * 12 + TIMEOUT / 5).await;
                    leader.propose(Put::Plain(round), sync * 12).await.expect("a commit");
                    fleet.network.crash(&name);
                    fleet.all.remove(&name);
                    drop(leader);
                    if size == 3 {
                        // Two of three, whose votes are both needed.
                        let (_, leader) = fleet.leader(sync * 12 + TIMEOUT / 5).await;
                        leader.propose(Put::Plain(7), sync * 12).await.expect("a commit");
                        break;
                    }
                }
            });
        }
    }
}

/// A number is counted by its width when it is read: what is short to send may be long to read.
#[test]
fn entries_of_many_small_numbers_reach_the_others() {
    on_virtual_time(async {
        let fleet = Voters::founded(1, 3, Duration::ZERO, LinkModel::LAN).await;
        let (_, leader) = fleet.leader(TIMEOUT).await;
        let largest = Put::Numbers(1, vec![7; 60_000]);
        put_all(&leader, [largest].into_iter()).await;
        put_all(&leader, (2..20).map(|number| Put::Numbers(number, vec![7; 10_000]))).await;
        for (name, replica) in &fleet.all {
            let mut applied = replica.applied();
            applied.wait_for(|_| replica.read(|shelf| shelf.0.len() == 19)).await.expect("a replica");
            assert_eq!(replica.rejected_requests(), 0, "{name}");
        }
    });
}

#[test]
fn a_follower_that_lags_is_sent_as_many_entries_at_once_as_fit_a_message() {
    on_virtual_time(async {
        let fleet = Voters::founded(1, 3, Duration::ZERO, LinkModel::LAN).await;
        let (name, leader) = fleet.leader(TIMEOUT).await;
        let lost = fleet.all.keys().find(|other| **other != name).expect("three voters").clone();
        let others = fleet.all.keys().filter(|other| **other != lost).cloned().collect();
        fleet.network.partition([vec![lost.clone()], others]);
        for number in 0..80 {
            leader.propose(Put::Bulky(number, vec![7; 4000]), TIMEOUT).await.expect("a commit");
        }
        fleet.journals[&lost].appends.lock().unwrap().clear();
        fleet.network.heal();
        let mut applied = fleet.all[&lost].applied();
        applied.wait_for(|_| fleet.all[&lost].read(|shelf| shelf.0.len() == 80)).await.expect("a replica");
        // Eight of them fit; a first question may have brought some that were not asked for.
        let appends = fleet.journals[&lost].appends.lock().unwrap().clone();
        assert!(appends.len() <= 12 && appends.iter().all(|count| *count <= 8), "{appends:?}");
    });
}
