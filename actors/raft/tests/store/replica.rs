//! A replica on a durable store: after a restart it is the same member, with its vote and all its
//! entries.

use super::hooked_log_store::{HookedLogStore, Write, WriteHook};
use super::{TempDir, owner};
use async_trait::async_trait;
use consort_bus::virtual_bus::{LinkModel, VirtualNetwork};
use consort_protocol::ids::{ClusterId, NodeId};
use consort_protocol::ledger::{Command, Ledger};
use consort_raft::store::{DurableStore, LEDGER_FILE, recover};
use consort_raft::{
    Epoch, LogStore, MemoryLogStore, PersistentState, RaftId, RaftSettings, Replica, StartError, StateMachine,
    StoreIdentity, inspect_log_store, recover_as_only_voter,
};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::time::Instant;

pub(super) const NAMES: [&str; 3] = ["ada", "bob", "cyd"];

/// List of numbers.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct NumberList(pub(super) Vec<u64>);

impl StateMachine for NumberList {
    type Command = u64;
    type Outcome = usize;

    fn apply(&mut self, _: Epoch, number: u64) -> usize {
        self.0.push(number);
        self.0.len()
    }
}

pub(super) struct Fleet {
    pub(super) network: VirtualNetwork,
    pub(super) replicas: BTreeMap<&'static str, Replica<NumberList>>,
    starts: u64,
}

pub(super) fn settings(name: &str) -> RaftSettings {
    let owner = owner(name);
    RaftSettings { snapshot_every: 50, log_entries_kept: 20, ..RaftSettings::new(owner.fleet, owner.node) }
}

pub(super) fn on_disk(folder: &Path, name: &str) -> Arc<dyn LogStore> {
    let fresh = StoreIdentity(name.len() as u128 + u128::from(name.as_bytes()[0]));
    Arc::new(DurableStore::open(&folder.join(name), &owner(name), fresh).expect("a store"))
}

impl Fleet {
    pub(super) fn new(seed: u64) -> Fleet {
        Fleet { network: VirtualNetwork::new(seed, LinkModel::LAN), replicas: BTreeMap::new(), starts: seed * 100 }
    }

    pub(super) async fn start(&mut self, name: &'static str, log_store: Arc<dyn LogStore>) -> RaftId {
        self.starts += 1;
        let bus = Arc::new(self.network.bus(NodeId::new(name).expect("a slug")));
        let replica = Replica::start(settings(name), bus, log_store, self.starts).await.expect("a start");
        let id = replica.id();
        self.replicas.insert(name, replica);
        id
    }

    pub(super) async fn bootstrap(&self) {
        let members = self.replicas.iter().map(|(name, replica)| (replica.id(), NodeId::new(*name).expect("a slug")));
        self.replicas["ada"].bootstrap(members.collect()).await.expect("the first bootstrap");
    }

    /// Stops all nodes.
    pub(super) async fn stop(&mut self) {
        for (name, replica) in std::mem::take(&mut self.replicas) {
            self.network.crash(&NodeId::new(name).expect("a slug"));
            replica.shutdown().await;
        }
    }

    pub(super) async fn until<T>(&self, condition: &str, mut is_met: impl FnMut(&Fleet) -> Option<T>) -> T {
        let started_at = Instant::now();
        loop {
            if let Some(value) = is_met(self) {
                return value;
            }
            assert!(started_at.elapsed() < Duration::from_secs(30), "timed out waiting until {condition}");
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    pub(super) async fn leader(&self) -> &'static str {
        let is_leader = |fleet: &Fleet| {
            let mut all = fleet.replicas.iter();
            all.find(|(_, replica)| replica.leadership().borrow().is_leader).map(|(name, _)| *name)
        };
        self.until("there is a leader", is_leader).await
    }

    pub(super) async fn write(&self, numbers: impl IntoIterator<Item = u64>) {
        for number in numbers {
            loop {
                let leader = self.leader().await;
                if self.replicas[leader].propose(number, Duration::from_secs(2)).await.is_ok() {
                    break;
                }
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        }
    }

    pub(super) async fn until_all_hold(&self, count: usize) {
        let hold = |fleet: &Fleet| {
            fleet.replicas.values().all(|replica| replica.read(|list| list.0.len() == count)).then_some(())
        };
        self.until("all replicas have applied everything", hold).await;
    }
}

/// Runs a test on virtual time. Virtual time stands still during disk writes.
pub(super) fn on_virtual_time<T>(test: impl Future<Output = T>) -> T {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    builder.enable_time().start_paused(true).build().expect("a runtime").block_on(test)
}

/// Waits until the previous process lifetime has released the data directory.
pub(super) async fn until_free(folder: &Path, name: &str) {
    let started_at = std::time::Instant::now();
    while let Err(problem) = DurableStore::open_existing(&folder.join(name)) {
        assert!(started_at.elapsed() < Duration::from_secs(30), "{problem}");
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
}

#[test]
fn a_restarted_fleet_has_the_same_members_and_entries() {
    let folder = TempDir::new();
    on_virtual_time(async {
        let mut fleet = Fleet::new(1);
        let mut ids = BTreeMap::new();
        for name in NAMES {
            ids.insert(name, fleet.start(name, on_disk(&folder, name)).await);
        }
        fleet.bootstrap().await;
        let mut terms = 0;
        for round in 1..4_u64 {
            fleet.write((round - 1) * 150..round * 150).await;
            let count = usize::try_from(round * 150).expect("a small number");
            fleet.until_all_hold(count).await;
            let term = |fleet: &Fleet| fleet.replicas["ada"].leadership().borrow().term;
            assert!(term(&fleet) >= terms, "a vote was lost");
            terms = term(&fleet);
            fleet.stop().await;
            for name in NAMES {
                until_free(&folder, name).await;
                assert_eq!(fleet.start(name, on_disk(&folder, name)).await, ids[name]);
                // It starts from its stored vote: its term is restored before it has contact with
                // another node.
                let mut leadership = fleet.replicas[name].leadership();
                let first = leadership.wait_for(|now| now.term > 0).await.expect("a replica").term;
                assert!(first >= terms, "{name} is in term {first}, but voted in term {terms}");
            }
            fleet.until_all_hold(count).await;
            assert_eq!(fleet.replicas["cyd"].read(NumberList::clone).0, (0..round * 150).collect::<Vec<_>>());
        }
    });
}

#[test]
fn the_disk_usage_of_a_store_stays_bounded() {
    let folder = TempDir::new();
    on_virtual_time(async {
        let mut fleet = Fleet::new(2);
        fleet.start("ada", on_disk(&folder, "ada")).await;
        fleet.bootstrap().await;
        let size = || std::fs::metadata(folder.join("ada").join(LEDGER_FILE)).expect("a file").len();
        fleet.write(0..150).await;
        let early = size();
        // Twenty more snapshots; the state itself grows by some kilobytes.
        fleet.write(150..1150).await;
        let late = size();
        assert!(late <= early.max(2 << 20), "{early} bytes became {late}");
        fleet.stop().await;
        until_free(&folder, "ada").await;
        let reopened = on_disk(&folder, "ada");
        let PersistentState { entries, snapshot, purged, .. } = reopened.load().await.expect("a log store");
        assert!(entries.len() <= 2 * 50 + 20, "{} entries are kept", entries.len());
        assert!(snapshot.is_some() && purged.is_some());
        fleet.start("ada", reopened).await;
        fleet.until_all_hold(1150).await;
    });
}

/// Hook that simulates a full disk once it is switched on.
#[derive(Default)]
struct FullDisk(AtomicBool);

#[async_trait]
impl WriteHook for FullDisk {
    async fn before(&self, _: Write) -> io::Result<()> {
        if self.0.load(Ordering::SeqCst) { Err(io::ErrorKind::StorageFull.into()) } else { Ok(()) }
    }
}

#[test]
fn a_leader_with_a_full_disk_stops_and_is_replaced() {
    on_virtual_time(async {
        let mut fleet = Fleet::new(3);
        let mut disks = BTreeMap::new();
        for (seed, name) in (70..).zip(NAMES) {
            let disk = Arc::new(HookedLogStore { inner: MemoryLogStore::new(seed), hook: FullDisk::default() });
            fleet.start(name, Arc::clone(&disk) as _).await;
            disks.insert(name, disk);
        }
        fleet.bootstrap().await;
        fleet.write(0..10).await;
        let failed_leader = fleet.leader().await;
        disks[failed_leader].hook.0.store(true, Ordering::SeqCst);
        let result = fleet.replicas[failed_leader].propose(10, Duration::from_secs(2)).await;
        assert!(result.is_err(), "{result:?}");
        let failed = fleet.replicas[failed_leader].wait_failed();
        let problem = tokio::time::timeout(Duration::from_secs(5), failed).await.expect("an end");
        assert!(problem.contains("no storage space"), "{problem}");
        assert!(!fleet.replicas[failed_leader].leadership().borrow().is_leader);
        fleet.network.crash(&NodeId::new(failed_leader).expect("a slug"));
        fleet.replicas.remove(failed_leader);
        fleet.write(11..20).await;
        fleet
            .until("all replicas have applied everything", |fleet| {
                let stored = |list: &NumberList| {
                    list.0.iter().filter(|number| **number != 10).copied().eq((0..10).chain(11..20))
                };
                fleet.replicas.values().all(|replica| replica.read(stored)).then_some(())
            })
            .await;
    });
}

#[test]
fn a_log_that_cannot_be_continued_is_rejected() {
    let folder = TempDir::new();
    on_virtual_time(async {
        let mut fleet = Fleet::new(4);
        fleet.start("ada", on_disk(&folder, "ada")).await;
        fleet.bootstrap().await;
        fleet.write(0..40).await;
        fleet.stop().await;
        until_free(&folder, "ada").await;
        let stored = on_disk(&folder, "ada").load().await.expect("a log store");
        let with = |change: fn(&mut PersistentState)| {
            let mut changed = stored.clone();
            change(&mut changed);
            changed
        };
        for (condition, recorded) in [
            // As releases up to 0.2.0 wrote it.
            ("version 1; this decoder reads version 2", with(|log| log.vote.as_mut().expect("a vote")[0] = 1)),
            ("has entry 1.12 at index 12, directly after 1.10", with(|log| drop(log.entries.remove(&11)))),
            ("has entry 1.1 at index 1, directly after nothing", with(|log| drop(log.entries.remove(&0)))),
            (
                "has entry 1.30 at index 20, directly after 1.19",
                with(|log| drop(log.entries.insert(20, log.entries[&30].clone()))),
            ),
        ] {
            until_free(&folder, "ada").await;
            let store = DurableStore::open_existing(&folder.join("ada")).expect("a store");
            store.replace(recorded).expect("a write");
            let bus = Arc::new(fleet.network.bus(NodeId::new("ada").expect("a slug")));
            let started = Replica::<NumberList>::start(settings("ada"), bus, Arc::new(store), 1).await;
            let Err(StartError::LogStore { location: place, problem }) = started else {
                panic!("{condition}: it was loaded")
            };
            assert!(place.ends_with(LEDGER_FILE), "{place}");
            assert_eq!(problem.kind(), io::ErrorKind::InvalidData);
            assert!(problem.to_string().contains(condition), "{problem}");
        }
    });
}

#[test]
fn the_last_of_three_voters_is_recovered_as_the_only_voter() {
    let folder = TempDir::new();
    on_virtual_time(async {
        let mut fleet = Fleet::new(5);
        for name in NAMES {
            fleet.start(name, on_disk(&folder, name)).await;
        }
        fleet.bootstrap().await;
        fleet.write(0..70).await;
        fleet.until_all_hold(70).await;
        let term = fleet.replicas["cyd"].leadership().borrow().term;
        fleet.stop().await;
        until_free(&folder, "cyd").await;

        let store = DurableStore::open_existing(&folder.join("cyd")).expect("a store");
        let before =
            inspect_log_store::<NumberList>(store.persistent_state().expect("a log store")).expect("a whole one");
        assert_eq!(before.state.0, (0..70).collect::<Vec<_>>());
        assert_eq!(before.voters.into_values().collect::<BTreeSet<_>>(), NAMES.map(|n| NodeId::new(n).unwrap()).into());
        assert!(before.committed <= before.last && before.term >= term);
        let recovered = recover_as_only_voter::<NumberList>(
            store.persistent_state().expect("a log store"),
            &NodeId::new("cyd").expect("a slug"),
            store.identity(),
            |list| list.0.push(1000),
        );
        store.replace(recovered.expect("something to recover")).expect("a write");
        let after =
            inspect_log_store::<NumberList>(store.persistent_state().expect("a log store")).expect("a whole one");
        assert_eq!((after.term, after.last, after.committed), (before.term, before.last, before.last));
        assert_eq!(after.voters.len(), 1);
        drop(store);

        let id = fleet.start("cyd", on_disk(&folder, "cyd")).await;
        assert_eq!(fleet.leader().await, "cyd");
        let now = fleet.replicas["cyd"].leadership().borrow().clone();
        assert_eq!(now.voters.keys().copied().collect::<Vec<_>>(), [id]);
        assert!(now.term > term, "{} after {term}", now.term);
        fleet.write([70]).await;
        let expected = || (0..70).chain([1000, 70]).collect::<Vec<_>>();
        assert_eq!(fleet.replicas["cyd"].read(NumberList::clone).0, expected());

        // The other nodes join with empty stores.
        std::fs::remove_dir_all(folder.join("ada")).expect("a folder");
        let other = fleet.start("ada", on_disk(&folder, "ada")).await;
        let leader = &fleet.replicas["cyd"];
        let timeout = Duration::from_secs(5);
        leader.add_learner(other, NodeId::new("ada").expect("a slug"), timeout).await.expect("an observer");
        fleet.until_all_hold(72).await;
        leader.set_voters([id, other].into(), timeout).await.expect("two voters");
        assert_eq!(fleet.replicas["ada"].read(NumberList::clone).0, expected());
    });
}

#[test]
fn an_empty_store_cannot_be_recovered() {
    let name = NodeId::new("ada").expect("a slug");
    let started = recover_as_only_voter::<NumberList>(PersistentState::default(), &name, StoreIdentity(1), |_| ());
    assert_eq!(started.expect_err("nothing").to_string(), "the log store is empty: there is nothing to recover");
}

#[test]
fn former_voters_do_not_join_a_recovered_ledger() {
    let folder = TempDir::new();
    on_virtual_time(async {
        let network = VirtualNetwork::new(3, LinkModel::LAN);
        let start = async |name: &str, seed| {
            let bus = Arc::new(network.bus(NodeId::new(name).expect("a slug")));
            Replica::<Ledger>::start(settings(name), bus, on_disk(&folder, name), seed).await.expect("a start")
        };
        let command = Command::Bootstrap { cluster: ClusterId(1) };
        let is_leader = |replica: &&Replica<Ledger>| replica.leadership().borrow().is_leader;
        let timeout = Duration::from_secs(5);
        let mut former_replicas = Vec::new();
        for (seed, name) in (1..).zip(NAMES) {
            former_replicas.push(start(name, seed).await);
        }
        let members =
            former_replicas.iter().zip(NAMES).map(|(replica, name)| (replica.id(), NodeId::new(name).unwrap()));
        former_replicas[0].bootstrap(members.collect()).await.expect("the first bootstrap");
        let started_at = Instant::now();
        let leader = loop {
            match former_replicas.iter().find(is_leader) {
                Some(leader) => break leader,
                None => tokio::time::sleep(Duration::from_millis(1)).await,
            }
            assert!(started_at.elapsed() < Duration::from_secs(30), "the first cluster has no leader");
        };
        leader.propose(command, timeout).await.expect("a commit");
        for replica in &former_replicas {
            replica.cluster().wait_for(|cluster| *cluster == Some(ClusterId(1))).await.expect("a replica");
        }
        for (replica, name) in former_replicas.drain(..).zip(NAMES) {
            network.crash(&NodeId::new(name).expect("a slug"));
            replica.shutdown().await;
        }
        for name in NAMES {
            until_free(&folder, name).await;
        }
        let store = DurableStore::open_existing(&folder.join("cyd")).expect("a store");
        recover(&store, 1, ClusterId(2)).expect("something to recover");
        drop(store);
        let cyd = start("cyd", 4).await;
        cyd.leadership().wait_for(|now| now.is_leader).await.expect("a replica");
        let leadership = cyd.leadership().borrow().leader_id;

        // The other nodes come back, against all advice, and they have a majority of the former
        // voters.
        let others = [start("ada", 5).await, start("bob", 6).await];
        let started_at = Instant::now();
        while !others.iter().any(|other| is_leader(&other)) || cyd.rejected_requests() < 10 {
            assert!(started_at.elapsed() < Duration::from_secs(30), "{} messages refused", cyd.rejected_requests());
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        let now = cyd.leadership().borrow().clone();
        assert!(now.is_leader && now.leader_id == leadership, "{now:?} after {leadership:?}");
        assert_eq!(now.voters.len(), 1);
        assert_eq!(*cyd.cluster().borrow(), Some(ClusterId(2)));
        assert_eq!(*others[0].cluster().borrow(), Some(ClusterId(1)));
    });
}
