//! Group commit: commands that arrive while an entry is being written share the next entry.

use crate::support::{NAMES, TIMEOUT, default_settings, node, on_virtual_time};
use async_trait::async_trait;
use consort_bus::virtual_bus::{LinkModel, VirtualNetwork};
use consort_protocol::ids::NodeId;
use consort_raft::{
    Epoch, LogStore, MemoryLogStore, PersistentState, ProposeError, Replica, StateMachine, StoreIdentity,
};
use futures::future::join_all;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// Duration of a write to the log store.
const SYNC_TIME: Duration = Duration::from_millis(10);

/// Duration of a write to a slow disk, in tests with several voters.
const SLOW_SYNC_TIME: Duration = Duration::from_millis(120);

/// List of numbers, each with its log position.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct NumberLog(Vec<(Epoch, u64)>);

#[derive(Debug, Clone, Serialize, Deserialize)]
enum PutCommand {
    Shared(u64),
    OwnEntry(u64),
    Large(u64, Vec<u8>),
    Numbers(u64, Vec<u64>),
}

impl StateMachine for NumberLog {
    type Command = PutCommand;
    type Outcome = (Epoch, usize);

    fn apply(
        &mut self,
        at: Epoch,
        (PutCommand::Shared(number)
        | PutCommand::OwnEntry(number)
        | PutCommand::Large(number, _)
        | PutCommand::Numbers(number, _)): PutCommand,
    ) -> (Epoch, usize) {
        self.0.push((at, number));
        (at, self.0.len())
    }

    fn grants_epoch(command: &PutCommand) -> bool {
        matches!(command, PutCommand::OwnEntry(_))
    }
}

/// Log store with slow writes of votes and entries.
#[derive(Clone)]
struct SlowLogStore {
    log_store: MemoryLogStore,
    sync: Duration,
    /// Number of entries of each append.
    appends: Arc<Mutex<Vec<usize>>>,
}

impl SlowLogStore {
    fn new(identity_seed: u64, sync: Duration) -> SlowLogStore {
        SlowLogStore { log_store: MemoryLogStore::new(identity_seed), sync, appends: Arc::default() }
    }
}

#[async_trait]
impl LogStore for SlowLogStore {
    fn identity(&self) -> StoreIdentity {
        self.log_store.identity()
    }

    async fn load(&self) -> io::Result<PersistentState> {
        self.log_store.load().await
    }

    async fn save_vote(&self, vote: Vec<u8>) -> io::Result<()> {
        sleep(self.sync).await;
        self.log_store.save_vote(vote).await
    }

    async fn save_committed(&self, committed: Option<Vec<u8>>) -> io::Result<()> {
        self.log_store.save_committed(committed).await
    }

    async fn append(&self, entries: Vec<(u64, Vec<u8>)>) -> io::Result<()> {
        self.appends.lock().unwrap().push(entries.len());
        sleep(self.sync).await;
        self.log_store.append(entries).await
    }

    async fn truncate(&self, index: u64) -> io::Result<()> {
        self.log_store.truncate(index).await
    }

    async fn purge(&self, index: u64, last: Vec<u8>) -> io::Result<()> {
        self.log_store.purge(index, last).await
    }

    async fn save_snapshot(&self, snapshot: Vec<u8>) -> io::Result<()> {
        self.log_store.save_snapshot(snapshot).await
    }
}

/// Starts a node that is the only voter, and returns it with its log store.
async fn single_voter() -> (Replica<NumberLog>, SlowLogStore) {
    let network = VirtualNetwork::new(1, LinkModel::LAN);
    let log_store = SlowLogStore::new(1, SYNC_TIME);
    let bus = Arc::new(network.bus(node("ada")));
    let replica =
        Replica::start(default_settings(node("ada")), bus, Arc::new(log_store.clone()), 1).await.expect("a start");
    replica.bootstrap(BTreeMap::from([(replica.id(), node("ada"))])).await.expect("the first bootstrap");
    replica.leadership().wait_for(|now| now.is_leader).await.expect("a replica");
    (replica, log_store)
}

/// Proposes all commands concurrently, and returns their results.
async fn put_all(replica: &Replica<NumberLog>, commands: impl Iterator<Item = PutCommand>) -> Vec<(Epoch, usize)> {
    let replies = join_all(commands.map(|command| replica.propose(command, TIMEOUT))).await;
    replies.into_iter().map(|reply| reply.expect("a commit")).collect()
}

#[test]
fn many_concurrent_commands_share_few_entries_in_order() {
    on_virtual_time(async {
        let (replica, _) = single_voter().await;
        let started_at = Instant::now();
        let outcomes = put_all(&replica, (0..200).map(PutCommand::Shared)).await;
        assert!(started_at.elapsed() < SYNC_TIME * 4, "{:?}", started_at.elapsed());
        let positions: BTreeSet<Epoch> = outcomes.iter().map(|(at, _)| *at).collect();
        assert!(positions.len() <= 2, "{positions:?}");
        assert_eq!(outcomes.iter().map(|(_, count)| *count).collect::<Vec<_>>(), (1..=200).collect::<Vec<_>>());
        assert_eq!(
            replica.read(NumberLog::clone).0,
            (0..).zip(&outcomes).map(|(n, (at, _))| (*at, n)).collect::<Vec<_>>()
        );
    });
}

#[test]
fn a_single_command_is_proposed_at_once() {
    on_virtual_time(async {
        let (replica, _) = single_voter().await;
        let started_at = Instant::now();
        replica.propose(PutCommand::Shared(1), TIMEOUT).await.expect("a commit");
        assert!(started_at.elapsed() <= SYNC_TIME + Duration::from_millis(1), "{:?}", started_at.elapsed());
    });
}

#[test]
fn each_command_that_grants_an_epoch_gets_its_own_entry() {
    on_virtual_time(async {
        let (replica, _) = single_voter().await;
        let has_own_entry = |number: &u64| number % 4 == 1;
        let command =
            |number| if has_own_entry(&number) { PutCommand::OwnEntry(number) } else { PutCommand::Shared(number) };
        let outcomes = put_all(&replica, (0..40).map(command)).await;
        let own_entries: Vec<Epoch> =
            (0..40).zip(&outcomes).filter(|(number, _)| has_own_entry(number)).map(|(_, (at, _))| *at).collect();
        assert_eq!(own_entries.iter().collect::<BTreeSet<_>>().len(), 10, "{own_entries:?}");
        let positions: BTreeSet<Epoch> = outcomes.iter().map(|(at, _)| *at).collect();
        assert!(positions.len() <= 11, "{positions:?}");
        assert_eq!(
            replica.read(NumberLog::clone).0.iter().map(|(_, n)| *n).collect::<Vec<_>>(),
            (0..40).collect::<Vec<_>>()
        );
    });
}

#[test]
fn commands_share_an_entry_only_while_it_stays_small() {
    on_virtual_time(async {
        let (replica, log_store) = single_voter().await;
        put_all(&replica, (0..30).map(|number| PutCommand::Large(number, vec![7; 5000]))).await;
        let entries = log_store.load().await.expect("a log store").entries;
        let longest = entries.values().map(Vec::len).max().expect("entries");
        assert!((15_000..16 * 1024).contains(&longest), "{longest} bytes");
        // A larger command gets an entry of its own.
        put_all(&replica, (0..3).map(|number| PutCommand::Large(number, vec![7; 30_000]))).await;
        let entries = log_store.load().await.expect("a log store").entries;
        let longest = entries.values().map(Vec::len).max().expect("entries");
        assert!((30_000..31_000).contains(&longest), "{longest} bytes");
    });
}

#[test]
fn a_follower_rejects_all_concurrent_commands() {
    on_virtual_time(async {
        let network = VirtualNetwork::new(1, LinkModel::LAN);
        let bus = Arc::new(network.bus(node("ada")));
        let log_store = Arc::new(MemoryLogStore::new(1));
        let replica =
            Replica::<NumberLog>::start(default_settings(node("ada")), bus, log_store, 1).await.expect("a start");
        let replies = join_all((0..20).map(|number| replica.propose(PutCommand::Shared(number), TIMEOUT))).await;
        assert!(replies.iter().all(|reply| *reply == Err(ProposeError::NotLeader { leader: None })), "{replies:?}");
    });
}

/// Several voters with slow disks.
struct Voters {
    network: VirtualNetwork,
    replicas: BTreeMap<NodeId, Replica<NumberLog>>,
    log_stores: BTreeMap<NodeId, SlowLogStore>,
}

impl Voters {
    async fn bootstrapped(seed: u64, size: usize, sync: Duration, link: LinkModel) -> Voters {
        let network = VirtualNetwork::new(seed, link);
        let (mut replicas, mut log_stores) = (BTreeMap::new(), BTreeMap::new());
        for (number, name) in (1..).zip(&NAMES[..size]) {
            let log_store = SlowLogStore::new(seed * 10 + number, sync);
            log_stores.insert(node(name), log_store.clone());
            let bus = Arc::new(network.bus(node(name)));
            let replica =
                Replica::<NumberLog>::start(default_settings(node(name)), bus, Arc::new(log_store), seed * 10 + number)
                    .await;
            replicas.insert(node(name), replica.expect("a start"));
        }
        let members = replicas.iter().map(|(name, replica)| (replica.id(), name.clone())).collect();
        replicas[&node("ada")].bootstrap(members).await.expect("the first bootstrap");
        Voters { network, replicas, log_stores }
    }

    /// Waits for a leader and returns it.
    async fn leader(&self, limit: Duration) -> (NodeId, Replica<NumberLog>) {
        let started_at = Instant::now();
        loop {
            let mut entries = self.replicas.iter();
            if let Some((name, leader)) = entries.find(|(_, replica)| replica.leadership().borrow().is_leader) {
                return (name.clone(), leader.clone());
            }
            assert!(started_at.elapsed() < limit, "no leader within {limit:?}");
            sleep(Duration::from_millis(1)).await;
        }
    }
}

/// Runs three voters with disks that take `sync_time` for each append: 32 clients propose 4 kB
/// each, four times in sequence.
async fn three_voters_with_slow_disks(seed: u64, sync_time: Duration, link: LinkModel) {
    let fleet = Voters::bootstrapped(seed, 3, sync_time, link).await;
    let (_, leader) = fleet.leader(sync_time * 40).await;
    let voters = &fleet.replicas;
    let first = leader.leadership().borrow().clone();
    let mut views: Vec<_> = voters.values().map(Replica::leadership).collect();
    let leadership_is_stable = async {
        loop {
            for (name, view) in voters.keys().zip(&mut views) {
                let now = view.borrow_and_update();
                assert_eq!(now.term, first.term, "{name}, seed {seed}");
                assert_eq!(now.leader_id, first.leader_id, "{name}, seed {seed}");
            }
            assert!(leader.leadership().borrow().is_leader, "seed {seed}");
            sleep(Duration::from_millis(1)).await;
        }
    };
    // The followers have not received the first entries yet.
    for replica in voters.values() {
        replica.leadership().wait_for(|now| now.leader_id == first.leader_id).await.expect("a replica");
    }
    let clients = join_all((0..32).map(|client| {
        let leader = leader.clone();
        async move {
            for round in 0..4 {
                let command = PutCommand::Large(client * 10 + round, vec![7; 4096]);
                leader.propose(command, sync_time * 100).await.expect("a commit");
            }
        }
    }));
    tokio::select! {
        () = leadership_is_stable => {}
        _ = clients => {}
    }
    assert_eq!(leader.read(NumberLog::clone).0.len(), 128, "seed {seed}");
}

#[test]
fn slow_disks_delay_commits_and_depose_no_leader() {
    for seed in 1..=5 {
        on_virtual_time(three_voters_with_slow_disks(seed, SLOW_SYNC_TIME, LinkModel::LAN));
    }
}

/// The disks are slower than the longest election timeout: voters that wait for their disks still
/// reply to heartbeats.
#[test]
fn disks_slower_than_any_election_depose_no_leader() {
    for seed in 1..=3 {
        on_virtual_time(three_voters_with_slow_disks(seed, SLOW_SYNC_TIME * 7, LinkModel::LAN));
    }
}

/// Longest sync with which a leader can be elected, according to `docs/operations.md`, less a
/// margin.
const SLOWEST_SYNC_TIME: Duration = Duration::from_millis(900);

#[test]
fn voters_with_slow_disks_elect_leaders_within_twelve_syncs() {
    for (seed, size) in (1..=5).flat_map(|seed| [(seed, 3), (seed, 5)]) {
        for sync in [SLOW_SYNC_TIME * 2, SLOWEST_SYNC_TIME] {
            on_virtual_time(async {
                let mut fleet = Voters::bootstrapped(seed, size, sync, LinkModel::LAN).await;
                for round in 0..2 {
                    let (name, leader) = fleet.leader(sync * 12 + TIMEOUT / 5).await;
                    leader.propose(PutCommand::Shared(round), sync * 12).await.expect("a commit");
                    fleet.network.crash(&name);
                    fleet.replicas.remove(&name);
                    drop(leader);
                    if size == 3 {
                        // Two of three voters are left: both votes are needed.
                        let (_, leader) = fleet.leader(sync * 12 + TIMEOUT / 5).await;
                        leader.propose(PutCommand::Shared(7), sync * 12).await.expect("a commit");
                        break;
                    }
                }
            });
        }
    }
}

/// The decoder counts a number by its width: a short encoding may exceed the limit of the decoder.
#[test]
fn entries_of_many_small_numbers_reach_the_followers() {
    on_virtual_time(async {
        let fleet = Voters::bootstrapped(1, 3, Duration::ZERO, LinkModel::LAN).await;
        let (_, leader) = fleet.leader(TIMEOUT).await;
        let largest = PutCommand::Numbers(1, vec![7; 60_000]);
        put_all(&leader, [largest].into_iter()).await;
        put_all(&leader, (2..20).map(|number| PutCommand::Numbers(number, vec![7; 10_000]))).await;
        for (name, replica) in &fleet.replicas {
            let mut applied = replica.applied();
            applied.wait_for(|_| replica.read(|log| log.0.len() == 19)).await.expect("a replica");
            assert_eq!(replica.rejected_requests(), 0, "{name}");
        }
    });
}

#[test]
fn a_lagging_follower_receives_as_many_entries_as_fit() {
    on_virtual_time(async {
        let fleet = Voters::bootstrapped(1, 3, Duration::ZERO, LinkModel::LAN).await;
        let (name, leader) = fleet.leader(TIMEOUT).await;
        let lagging = fleet.replicas.keys().find(|other| **other != name).expect("three voters").clone();
        let others = fleet.replicas.keys().filter(|other| **other != lagging).cloned().collect();
        fleet.network.partition([vec![lagging.clone()], others]);
        for number in 0..80 {
            leader.propose(PutCommand::Large(number, vec![7; 4000]), TIMEOUT).await.expect("a commit");
        }
        fleet.log_stores[&lagging].appends.lock().unwrap().clear();
        fleet.network.heal();
        let mut applied = fleet.replicas[&lagging].applied();
        applied.wait_for(|_| fleet.replicas[&lagging].read(|log| log.0.len() == 80)).await.expect("a replica");
        // Eight of them fit; the first append may contain entries that were not requested.
        let appends = fleet.log_stores[&lagging].appends.lock().unwrap().clone();
        assert!(appends.len() <= 12 && appends.iter().all(|count| *count <= 8), "{appends:?}");
    });
}
