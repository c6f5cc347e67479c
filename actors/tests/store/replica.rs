//! A replica on a store on disk: it comes back as the same member, with its vote and all that it held.

use super::hindered::{HookedLogStore, Write, WriteHook};
use super::{Folder, owner};
use async_trait::async_trait;
use consort_actors::bus::virtual_bus::{LinkModel, VirtualNetwork};
use consort_actors::raft::{
    Epoch, LogStore, MemoryLogStore, PersistentState, RaftId, RaftSettings, Replica, StartError, StateMachine,
    StoreIdentity, inspect_log_store, recover_as_only_voter,
};
use consort_actors::store::{DurableStore, LEDGER_FILE, recover};
use consort_protocol::ids::{ClusterId, NodeId};
use consort_protocol::ledger::{Command, Ledger};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::time::Instant;

pub(super) const NAMES: [&str; 3] = ["ada", "bob", "cyd"];

/// A list of numbers.
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

    pub(super) async fn start(&mut self, name: &'static str, journal: Arc<dyn LogStore>) -> RaftId {
        self.starts += 1;
        let bus = Arc::new(self.network.bus(NodeId::new(name).expect("a slug")));
        let replica = Replica::start(settings(name), bus, journal, self.starts).await.expect("a start");
        let id = replica.id();
        self.replicas.insert(name, replica);
        id
    }

    pub(super) async fn bootstrap(&self) {
        let members = self.replicas.iter().map(|(name, replica)| (replica.id(), NodeId::new(*name).expect("a slug")));
        self.replicas["ada"].bootstrap(members.collect()).await.expect("a first founding");
    }

    /// Ends all nodes at once.
    pub(super) async fn stop(&mut self) {
        for (name, replica) in std::mem::take(&mut self.replicas) {
            self.network.crash(&NodeId::new(name).expect("a slug"));
            replica.shutdown().await;
        }
    }

    pub(super) async fn until<T>(&self, what: &str, mut done: impl FnMut(&Fleet) -> Option<T>) -> T {
        let began = Instant::now();
        loop {
            if let Some(found) = done(self) {
                return found;
            }
            assert!(began.elapsed() < Duration::from_secs(30), "waited in vain until {what}");
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    pub(super) async fn leader(&self) -> &'static str {
        let leads = |fleet: &Fleet| {
            let mut all = fleet.replicas.iter();
            all.find(|(_, replica)| replica.leadership().borrow().is_leader).map(|(name, _)| *name)
        };
        self.until("somebody leads", leads).await
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
            fleet.replicas.values().all(|replica| replica.read(|tally| tally.0.len() == count)).then_some(())
        };
        self.until("all hold everything", hold).await;
    }
}

/// Virtual time stands still while a disk is written to.
pub(super) fn on_virtual_time<T>(story: impl Future<Output = T>) -> T {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    builder.enable_time().start_paused(true).build().expect("a runtime").block_on(story)
}

/// Waits until nothing of the last life keeps a directory any more.
pub(super) async fn until_free(folder: &Path, name: &str) {
    let began = std::time::Instant::now();
    while let Err(problem) = DurableStore::open_existing(&folder.join(name)) {
        assert!(began.elapsed() < Duration::from_secs(30), "{problem}");
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
}

#[test]
fn a_fleet_that_was_switched_off_comes_back_as_the_same_members_with_all_that_it_held() {
    let folder = Folder::new();
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
            assert!(term(&fleet) >= terms, "a vote was forgotten");
            terms = term(&fleet);
            fleet.stop().await;
            for name in NAMES {
                until_free(&folder, name).await;
                assert_eq!(fleet.start(name, on_disk(&folder, name)).await, ids[name]);
                // Its vote is what it starts from: it knows the term before it has heard anybody.
                let mut leadership = fleet.replicas[name].leadership();
                let first = leadership.wait_for(|now| now.term > 0).await.expect("a replica").term;
                assert!(first >= terms, "{name} knows of term {first} only, and it voted in {terms}");
            }
            fleet.until_all_hold(count).await;
            assert_eq!(fleet.replicas["cyd"].read(NumberList::clone).0, (0..round * 150).collect::<Vec<_>>());
        }
    });
}

#[test]
fn the_disk_a_store_takes_stays_bounded_however_much_is_written() {
    let folder = Folder::new();
    on_virtual_time(async {
        let mut fleet = Fleet::new(2);
        fleet.start("ada", on_disk(&folder, "ada")).await;
        fleet.bootstrap().await;
        let size = || std::fs::metadata(folder.join("ada").join(LEDGER_FILE)).expect("a file").len();
        fleet.write(0..150).await;
        let early = size();
        // Twenty snapshots more; the state itself grows by some kilobytes.
        fleet.write(150..1150).await;
        let late = size();
        assert!(late <= early.max(2 << 20), "{early} bytes became {late}");
        fleet.stop().await;
        until_free(&folder, "ada").await;
        let reopened = on_disk(&folder, "ada");
        let PersistentState { entries, snapshot, purged, .. } = reopened.load().await.expect("a journal");
        assert!(entries.len() <= 2 * 50 + 20, "{} entries are kept", entries.len());
        assert!(snapshot.is_some() && purged.is_some());
        fleet.start("ada", reopened).await;
        fleet.until_all_hold(1150).await;
    });
}

/// A disk that is full from some moment on.
#[derive(Default)]
struct Filling(AtomicBool);

#[async_trait]
impl WriteHook for Filling {
    async fn before(&self, _: Write) -> io::Result<()> {
        if self.0.load(Ordering::SeqCst) { Err(io::ErrorKind::StorageFull.into()) } else { Ok(()) }
    }
}

#[test]
fn a_leader_whose_disk_is_full_gives_up_for_good_and_says_so_and_another_takes_over() {
    on_virtual_time(async {
        let mut fleet = Fleet::new(3);
        let mut disks = BTreeMap::new();
        for (seed, name) in (70..).zip(NAMES) {
            let disk = Arc::new(HookedLogStore { inner: MemoryLogStore::new(seed), hook: Filling::default() });
            fleet.start(name, Arc::clone(&disk) as _).await;
            disks.insert(name, disk);
        }
        fleet.bootstrap().await;
        fleet.write(0..10).await;
        let old = fleet.leader().await;
        disks[old].hook.0.store(true, Ordering::SeqCst);
        let answer = fleet.replicas[old].propose(10, Duration::from_secs(2)).await;
        assert!(answer.is_err(), "{answer:?}");
        let failed = fleet.replicas[old].wait_failed();
        let problem = tokio::time::timeout(Duration::from_secs(5), failed).await.expect("an end");
        assert!(problem.contains("no storage space"), "{problem}");
        assert!(!fleet.replicas[old].leadership().borrow().is_leader);
        fleet.network.crash(&NodeId::new(old).expect("a slug"));
        fleet.replicas.remove(old);
        fleet.write(11..20).await;
        fleet
            .until("all hold everything", |fleet| {
                let whole = |tally: &NumberList| {
                    tally.0.iter().filter(|number| **number != 10).copied().eq((0..10).chain(11..20))
                };
                fleet.replicas.values().all(|replica| replica.read(whole)).then_some(())
            })
            .await;
    });
}

#[test]
fn a_log_with_a_gap_or_without_its_beginning_is_refused() {
    let folder = Folder::new();
    on_virtual_time(async {
        let mut fleet = Fleet::new(4);
        fleet.start("ada", on_disk(&folder, "ada")).await;
        fleet.bootstrap().await;
        fleet.write(0..40).await;
        fleet.stop().await;
        until_free(&folder, "ada").await;
        let whole = on_disk(&folder, "ada").load().await.expect("a journal");
        let with = |change: fn(&mut PersistentState)| {
            let mut changed = whole.clone();
            change(&mut changed);
            changed
        };
        for (what, recorded) in [
            ("has entry 1.12 at place 12, right after 1.10", with(|log| drop(log.entries.remove(&11)))),
            ("has entry 1.1 at place 1, right after nothing", with(|log| drop(log.entries.remove(&0)))),
            (
                "has entry 1.30 at place 20, right after 1.19",
                with(|log| drop(log.entries.insert(20, log.entries[&30].clone()))),
            ),
        ] {
            until_free(&folder, "ada").await;
            let store = DurableStore::open_existing(&folder.join("ada")).expect("a store");
            store.replace(recorded).expect("a write");
            let bus = Arc::new(fleet.network.bus(NodeId::new("ada").expect("a slug")));
            let refused = Replica::<NumberList>::start(settings("ada"), bus, Arc::new(store), 1).await;
            let Err(StartError::LogStore { location: place, problem }) = refused else {
                panic!("{what}: it was taken up")
            };
            assert!(place.ends_with(LEDGER_FILE), "{place}");
            assert_eq!(problem.kind(), io::ErrorKind::InvalidData);
            assert!(problem.to_string().contains(what), "{problem}");
        }
    });
}

#[test]
fn the_last_of_three_is_made_the_only_voter_with_all_that_it_held_and_others_join_it_anew() {
    let folder = Folder::new();
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
            inspect_log_store::<NumberList>(store.persistent_state().expect("a journal")).expect("a whole one");
        assert_eq!(before.state.0, (0..70).collect::<Vec<_>>());
        assert_eq!(before.voters.into_values().collect::<BTreeSet<_>>(), NAMES.map(|n| NodeId::new(n).unwrap()).into());
        assert!(before.committed <= before.last && before.term >= term);
        let recovered = recover_as_only_voter::<NumberList>(
            store.persistent_state().expect("a journal"),
            &NodeId::new("cyd").expect("a slug"),
            store.identity(),
            |tally| tally.0.push(1000),
        );
        store.replace(recovered.expect("something to recover")).expect("a write");
        let after = inspect_log_store::<NumberList>(store.persistent_state().expect("a journal")).expect("a whole one");
        assert_eq!((after.term, after.last, after.committed), (before.term, before.last, before.last));
        assert_eq!(after.voters.len(), 1);
        drop(store);

        let id = fleet.start("cyd", on_disk(&folder, "cyd")).await;
        assert_eq!(fleet.leader().await, "cyd");
        let now = fleet.replicas["cyd"].leadership().borrow().clone();
        assert_eq!(now.voters.keys().copied().collect::<Vec<_>>(), [id]);
        assert!(now.term > term, "{} after {term}", now.term);
        fleet.write([70]).await;
        let held = || (0..70).chain([1000, 70]).collect::<Vec<_>>();
        assert_eq!(fleet.replicas["cyd"].read(NumberList::clone).0, held());

        // The others come with empty stores.
        std::fs::remove_dir_all(folder.join("ada")).expect("a folder");
        let other = fleet.start("ada", on_disk(&folder, "ada")).await;
        let leader = &fleet.replicas["cyd"];
        let soon = Duration::from_secs(5);
        leader.add_learner(other, NodeId::new("ada").expect("a slug"), soon).await.expect("an observer");
        fleet.until_all_hold(72).await;
        leader.set_voters([id, other].into(), soon).await.expect("two voters");
        assert_eq!(fleet.replicas["ada"].read(NumberList::clone).0, held());
    });
}

#[test]
fn a_store_that_holds_nothing_is_not_made_a_ledger() {
    let name = NodeId::new("ada").expect("a slug");
    let refused = recover_as_only_voter::<NumberList>(PersistentState::default(), &name, StoreIdentity(1), |_| ());
    assert_eq!(refused.expect_err("nothing").to_string(), "it holds no entry: there is nothing to recover");
}

#[test]
fn a_recovered_ledger_is_a_stranger_to_voters_that_come_back_with_the_former_one() {
    let folder = Folder::new();
    on_virtual_time(async {
        let network = VirtualNetwork::new(3, LinkModel::LAN);
        let start = async |name: &str, seed| {
            let bus = Arc::new(network.bus(NodeId::new(name).expect("a slug")));
            Replica::<Ledger>::start(settings(name), bus, on_disk(&folder, name), seed).await.expect("a start")
        };
        let found = Command::Bootstrap { cluster: ClusterId(1) };
        let leads = |replica: &&Replica<Ledger>| replica.leadership().borrow().is_leader;
        let soon = Duration::from_secs(5);
        let mut former = Vec::new();
        for (seed, name) in (1..).zip(NAMES) {
            former.push(start(name, seed).await);
        }
        let members = former.iter().zip(NAMES).map(|(replica, name)| (replica.id(), NodeId::new(name).unwrap()));
        former[0].bootstrap(members.collect()).await.expect("a first founding");
        let began = Instant::now();
        let leader = loop {
            match former.iter().find(leads) {
                Some(leader) => break leader,
                None => tokio::time::sleep(Duration::from_millis(1)).await,
            }
            assert!(began.elapsed() < Duration::from_secs(30), "nobody leads the first cluster");
        };
        leader.propose(found, soon).await.expect("a commit");
        for replica in &former {
            replica.cluster().wait_for(|cluster| *cluster == Some(ClusterId(1))).await.expect("a replica");
        }
        for (replica, name) in former.drain(..).zip(NAMES) {
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
        let reign = cyd.leadership().borrow().leader_id;

        // Against all advice the others come back, and they are a majority of their own.
        let others = [start("ada", 5).await, start("bob", 6).await];
        let began = Instant::now();
        while !others.iter().any(|other| leads(&other)) || cyd.rejected_requests() < 10 {
            assert!(began.elapsed() < Duration::from_secs(30), "{} messages refused", cyd.rejected_requests());
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        let now = cyd.leadership().borrow().clone();
        assert!(now.is_leader && now.leader_id == reign, "{now:?} after {reign:?}");
        assert_eq!(now.voters.len(), 1);
        assert_eq!(*cyd.cluster().borrow(), Some(ClusterId(2)));
        assert_eq!(*others[0].cluster().borrow(), Some(ClusterId(1)));
    });
}
