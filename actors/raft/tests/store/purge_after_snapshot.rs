//! Order of snapshot and purge: entries are purged from the log only after the snapshot that covers
//! them is stored. So the store can be opened after a power failure at any moment.

use super::hooked_log_store::{HookedLogStore, Write, WriteHook};
use super::replica::{Fleet, NAMES, NumberList, on_disk, on_virtual_time, settings, until_free};
use super::{TempDir, owner};
use async_trait::async_trait;
use consort_protocol::ids::{ClusterId, NodeId};
use consort_raft::store::{COMMIT_MARKER_FILE, DurableStore, LEDGER_FILE, REPAIR_ADVICE, inspect_ledger, recover};
use consort_raft::{MemoryLogStore, PersistentState, Replica, StartError, StoreIdentity, inspect_log_store};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::watch;

/// Hook that never completes the write of a snapshot.
struct StuckSnapshot {
    begun: watch::Sender<bool>,
}

#[async_trait]
impl WriteHook for StuckSnapshot {
    async fn before(&self, write: Write) -> io::Result<()> {
        if write == Write::Snapshot {
            self.begun.send_replace(true);
            std::future::pending::<()>().await;
        }
        Ok(())
    }
}

#[test]
fn a_voter_killed_during_a_snapshot_write_catches_up() {
    let folder = TempDir::new();
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

        // Its log ends before the others' logs begin: they send it a snapshot.
        until_free(&folder, "cyd").await;
        let inner_store = DurableStore::open_existing(&folder.join("cyd")).expect("a store");
        let log_store =
            Arc::new(HookedLogStore { inner: inner_store, hook: StuckSnapshot { begun: watch::Sender::new(false) } });
        fleet.start("cyd", Arc::clone(&log_store) as _).await;
        log_store.hook.begun.subscribe().wait_for(|begun| *begun).await.expect("a log store");
        // By then, all writes that do not depend on the snapshot are on disk.
        tokio::time::sleep(Duration::from_secs(1)).await;

        // Copies the files that a killed process leaves behind.
        std::fs::create_dir(folder.join("left")).expect("a folder");
        for file in [LEDGER_FILE, COMMIT_MARKER_FILE] {
            std::fs::copy(folder.join("cyd").join(file), folder.join("left").join(file)).expect("a copy");
        }
        fleet.network.crash(&cyd);
        fleet.replicas.remove("cyd");
        let remaining_files =
            DurableStore::open(&folder.join("left"), &owner("cyd"), StoreIdentity(99)).expect("a whole file");
        fleet.start("cyd", Arc::new(remaining_files)).await;
        fleet.until_all_hold(200).await;
    });
}

/// Hook that delays each write by a random time, and inspects the store after each write.
struct RandomDelays {
    rng: Mutex<ChaCha8Rng>,
    inspect: Box<dyn Fn(Write, PersistentState) + Send + Sync>,
}

#[async_trait]
impl WriteHook for RandomDelays {
    async fn before(&self, _: Write) -> io::Result<()> {
        let ms = self.rng.lock().expect("no panic").random_range(0..40);
        tokio::time::sleep(Duration::from_millis(ms)).await;
        Ok(())
    }

    fn after(&self, write: Write, stored: PersistentState) {
        (self.inspect)(write, stored);
    }
}

#[test]
fn a_log_store_can_be_loaded_after_a_power_cut_at_any_write() {
    for seed in 1..9 {
        on_virtual_time(async {
            let mut fleet = Fleet::new(seed);
            let snapshots = Arc::new(AtomicU64::new(0));
            for (number, name) in (0..).zip(NAMES) {
                let snapshots = Arc::clone(&snapshots);
                let inspect = move |write: Write, stored: PersistentState| {
                    snapshots.fetch_add(u64::from(write == Write::Snapshot), Ordering::Relaxed);
                    let contents = inspect_log_store::<NumberList>(stored);
                    let contents =
                        contents.unwrap_or_else(|problem| panic!("seed {seed}, {name}, {write:?}: {problem}"));
                    assert!(
                        contents.state.0.iter().copied().eq(0..contents.state.0.len() as u64),
                        "seed {seed}, {name}"
                    );
                };
                let rng = Mutex::new(ChaCha8Rng::seed_from_u64(seed * 10 + number));
                let hook = RandomDelays { rng, inspect: Box::new(inspect) };
                fleet
                    .start(name, Arc::new(HookedLogStore { inner: MemoryLogStore::new(seed * 10 + number), hook }))
                    .await;
            }
            fleet.bootstrap().await;
            fleet.write(0..10).await;
            for round in 1..4_usize {
                let leader = fleet.leader().await;
                let cut = NAMES.into_iter().find(|name| *name != leader).expect("three");
                fleet.network.partition([[NodeId::new(cut).expect("a slug")]]);
                let before = fleet.replicas[cut].read(|list| list.0.len());
                // More entries than the others keep in their logs: they can only send it a
                // snapshot.
                fleet.write(10 + (round as u64 - 1) * 100..10 + round as u64 * 100).await;
                assert!(fleet.replicas[cut].read(|list| list.0.len()) < before + 10, "seed {seed}: it was not cut off");
                fleet.network.heal();
                fleet.until_all_hold(10 + round * 100).await;
            }
            let snapshots = snapshots.load(Ordering::Relaxed);
            assert!(snapshots > 10, "seed {seed}: {snapshots} snapshots");
        });
    }
}

#[test]
fn a_purged_log_without_a_snapshot_is_rejected_with_advice() {
    let folder = TempDir::new();
    on_virtual_time(async {
        let mut fleet = Fleet::new(7);
        fleet.start("ada", on_disk(&folder, "ada")).await;
        fleet.bootstrap().await;
        fleet.write(0..150).await;
        fleet.stop().await;
        until_free(&folder, "ada").await;
        let store = DurableStore::open_existing(&folder.join("ada")).expect("a store");
        let stored = store.persistent_state().expect("a log store");
        let before = stored.entries.keys().next().expect("entries are left") - 1;
        store.replace(PersistentState { snapshot: None, ..stored }).expect("a write");

        let message = format!("the log begins after 1.{before}, but the snapshot ends with nothing; {REPAIR_ADVICE}");
        // For these two functions the store is unreadable for a different reason: its entries are
        // not ledger commands.
        for problem in [inspect_ledger(&store).map(drop), recover(&store, 1, ClusterId(1)).map(drop)] {
            let problem = problem.expect_err("a list of numbers").to_string();
            assert!(problem.ends_with(&format!("; {REPAIR_ADVICE}")), "{problem}");
        }
        let bus = Arc::new(fleet.network.bus(NodeId::new("ada").expect("a slug")));
        let started = Replica::<NumberList>::start(settings("ada"), bus, Arc::new(store), 1).await;
        let Err(StartError::LogStore { problem, .. }) = started else { panic!("it was loaded") };
        assert_eq!(problem.to_string(), message);
    });
}
