//! What a snapshot is to stand for is removed from the log only when the snapshot is in the journal: whatever moment the
//! power fails at, the store can be taken up again.

use super::hindered::{HookedLogStore, Write, WriteHook};
use super::replica::{Fleet, NAMES, NumberList, on_disk, on_virtual_time, settings, until_free};
use super::{Folder, owner};
use async_trait::async_trait;
use consort_actors::raft::{MemoryLogStore, PersistentState, Replica, StartError, StoreIdentity, inspect_log_store};
use consort_actors::store::{COMMIT_MARKER_FILE, DurableStore, LEDGER_FILE, REPAIR_ADVICE, inspect_ledger, recover};
use consort_protocol::ids::{ClusterId, NodeId};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::watch;

/// A disk that comes to no end with a snapshot.
struct Stuck {
    begun: watch::Sender<bool>,
}

#[async_trait]
impl WriteHook for Stuck {
    async fn before(&self, write: Write) -> io::Result<()> {
        if write == Write::Snapshot {
            self.begun.send_replace(true);
            std::future::pending::<()>().await;
        }
        Ok(())
    }
}

#[test]
fn a_voter_that_is_killed_while_it_keeps_the_leaders_snapshot_starts_again_and_catches_up() {
    let folder = Folder::new();
    on_virtual_time(async {
        let mut fleet = Fleet::new(6);
        for name in NAMES {
            fleet.start(name, on_disk(&folder, name)).await;
        }
        fleet.bootstrap().await;
        fleet.write(0..10).await;
        fleet.until_all_hold(10).await;
        let cyd = NodeId::new("cyd").expect("a slug");
        fleet.network.crash(&cyd);
        fleet.replicas.remove("cyd").expect("it runs").shutdown().await;
        fleet.write(10..200).await;

        // Its log ends before that of the others begins: they send it a snapshot.
        until_free(&folder, "cyd").await;
        let journal = DurableStore::open_existing(&folder.join("cyd")).expect("a store");
        let stuck = Arc::new(HookedLogStore { inner: journal, hook: Stuck { begun: watch::Sender::new(false) } });
        fleet.start("cyd", Arc::clone(&stuck) as _).await;
        stuck.hook.begun.subscribe().wait_for(|begun| *begun).await.expect("a journal");
        // Whatever does not wait for the snapshot is on the disk by then.
        tokio::time::sleep(Duration::from_secs(1)).await;

        // What a process that is killed now leaves behind.
        std::fs::create_dir(folder.join("left")).expect("a folder");
        for file in [LEDGER_FILE, COMMIT_MARKER_FILE] {
            std::fs::copy(folder.join("cyd").join(file), folder.join("left").join(file)).expect("a copy");
        }
        fleet.network.crash(&cyd);
        fleet.replicas.remove("cyd");
        let left = DurableStore::open(&folder.join("left"), &owner("cyd"), StoreIdentity(99)).expect("a whole file");
        fleet.start("cyd", Arc::new(left)).await;
        fleet.until_all_hold(200).await;
    });
}

/// A disk on which each write takes its own time, and which is looked at after each.
struct Uneven {
    chance: Mutex<ChaCha8Rng>,
    look: Box<dyn Fn(Write, PersistentState) + Send + Sync>,
}

#[async_trait]
impl WriteHook for Uneven {
    async fn before(&self, _: Write) -> io::Result<()> {
        let ms = self.chance.lock().expect("no panic").random_range(0..40);
        tokio::time::sleep(Duration::from_millis(ms)).await;
        Ok(())
    }

    fn after(&self, write: Write, recorded: PersistentState) {
        (self.look)(write, recorded);
    }
}

#[test]
fn after_whatever_write_the_power_fails_the_journal_can_be_taken_up() {
    for seed in 1..9 {
        on_virtual_time(async {
            let mut fleet = Fleet::new(seed);
            let snapshots = Arc::new(AtomicU64::new(0));
            for (number, name) in (0..).zip(NAMES) {
                let snapshots = Arc::clone(&snapshots);
                let look = move |write: Write, recorded: PersistentState| {
                    snapshots.fetch_add(u64::from(write == Write::Snapshot), Ordering::Relaxed);
                    let found = inspect_log_store::<NumberList>(recorded);
                    let found = found.unwrap_or_else(|problem| panic!("seed {seed}, {name}, {write:?}: {problem}"));
                    assert!(found.state.0.iter().copied().eq(0..found.state.0.len() as u64), "seed {seed}, {name}");
                };
                let chance = Mutex::new(ChaCha8Rng::seed_from_u64(seed * 10 + number));
                let by = Uneven { chance, look: Box::new(look) };
                fleet
                    .start(name, Arc::new(HookedLogStore { inner: MemoryLogStore::new(seed * 10 + number), hook: by }))
                    .await;
            }
            fleet.bootstrap().await;
            fleet.write(0..10).await;
            for round in 1..4_usize {
                let leader = fleet.leader().await;
                let cut = NAMES.into_iter().find(|name| *name != leader).expect("three");
                fleet.network.partition([[NodeId::new(cut).expect("a slug")]]);
                let before = fleet.replicas[cut].read(|tally| tally.0.len());
                // More than the others keep: they have only a snapshot to send it.
                fleet.write(10 + (round as u64 - 1) * 100..10 + round as u64 * 100).await;
                assert!(
                    fleet.replicas[cut].read(|tally| tally.0.len()) < before + 10,
                    "seed {seed}: it was not cut off"
                );
                fleet.network.heal();
                fleet.until_all_hold(10 + round * 100).await;
            }
            let snapshots = snapshots.load(Ordering::Relaxed);
            assert!(snapshots > 10, "seed {seed}: {snapshots} snapshots");
        });
    }
}

#[test]
fn a_log_whose_purged_part_no_snapshot_covers_is_refused_with_what_may_be_done() {
    let folder = Folder::new();
    on_virtual_time(async {
        let mut fleet = Fleet::new(7);
        fleet.start("ada", on_disk(&folder, "ada")).await;
        fleet.bootstrap().await;
        fleet.write(0..150).await;
        fleet.stop().await;
        until_free(&folder, "ada").await;
        let store = DurableStore::open_existing(&folder.join("ada")).expect("a store");
        let whole = store.persistent_state().expect("a journal");
        let before = whole.entries.keys().next().expect("some are kept") - 1;
        store.replace(PersistentState { snapshot: None, ..whole }).expect("a write");

        let what = format!("its log begins after 1.{before}, and its snapshot ends with nothing; {REPAIR_ADVICE}");
        // To these two it is unreadable before that shows, since its entries are no ledger's.
        for problem in [inspect_ledger(&store).map(drop), recover(&store, 1, ClusterId(1)).map(drop)] {
            let problem = problem.expect_err("a tally").to_string();
            assert!(problem.ends_with(&format!("; {REPAIR_ADVICE}")), "{problem}");
        }
        let bus = Arc::new(fleet.network.bus(NodeId::new("ada").expect("a slug")));
        let refused = Replica::<NumberList>::start(settings("ada"), bus, Arc::new(store), 1).await;
        let Err(StartError::LogStore { problem, .. }) = refused else { panic!("it was taken up") };
        assert_eq!(problem.to_string(), what);
    });
}
