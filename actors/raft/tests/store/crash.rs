//! Power failures, killed processes and full disks, at any moment of a write.
//!
//! The disk is simulated: see `SimulatedFile`.

use super::{bytes, owner};
use consort_raft::store::{DurableStore, OpenError, SimulatedFile, StorageBackend};
use consort_raft::{LogStore, PersistentState, StoreIdentity};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::io;
use std::sync::{Arc, Mutex};

/// A machine with two files. It can compute the content of its disk after a power failure at the
/// present moment.
#[derive(Debug, Clone, Default)]
struct Machine(Arc<Mutex<Simulation>>);

#[derive(Debug, Default)]
struct Simulation {
    files: [SimulatedFile; 2],
    /// Number of calls so far.
    calls: u64,
    /// Call numbers at which to take an image, in descending order.
    image_calls: Vec<u64>,
    /// Number of acknowledged writes.
    acknowledged: usize,
    images: Vec<Image>,
    rng: Option<ChaCha8Rng>,
    /// Size limit of a file, in bytes.
    size_max: Option<u64>,
    /// Size of the largest write, in bytes.
    largest_write: usize,
    syncs: u64,
}

/// Content of the files after a failure.
#[derive(Debug)]
struct Image {
    files: [Vec<u8>; 2],
    acknowledged: usize,
    kind: &'static str,
}

impl Simulation {
    fn count_call(&mut self) {
        self.calls += 1;
        if self.image_calls.last() != Some(&self.calls) {
            return;
        }
        self.image_calls.pop();
        let rng = self.rng.as_mut().expect("a generator");
        let after_power_cut = [0, 1].map(|file| self.files[file].after_power_failure(rng));
        let after_kill = [0, 1].map(|file| self.files[file].content().to_vec());
        for (files, kind) in [(after_power_cut, "power cut"), (after_kill, "kill")] {
            self.images.push(Image { files, acknowledged: self.acknowledged, kind });
        }
    }
}

impl Machine {
    fn with_files(files: [Vec<u8>; 2]) -> Machine {
        let files = files.map(SimulatedFile::with_content);
        Machine(Arc::new(Mutex::new(Simulation { files, ..Simulation::default() })))
    }

    fn simulation(&self) -> std::sync::MutexGuard<'_, Simulation> {
        self.0.lock().expect("no panic")
    }

    fn open(&self) -> Result<DurableStore, OpenError> {
        let file = |index| File { machine: self.clone(), index };
        DurableStore::open_on(file(0), file(1), &owner("ada"), StoreIdentity(5))
    }
}

/// File of a machine.
#[derive(Debug)]
struct File {
    machine: Machine,
    index: usize,
}

impl StorageBackend for File {
    fn len(&self) -> io::Result<u64> {
        Ok(self.machine.simulation().files[self.index].content().len() as u64)
    }

    fn read(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        self.machine.simulation().files[self.index].read(offset, out)
    }

    fn set_len(&self, len: u64) -> io::Result<()> {
        let mut simulation = self.machine.simulation();
        if simulation.size_max.is_some_and(|size_max| len > size_max) {
            return Err(io::Error::from_raw_os_error(28)); // ENOSPC
        }
        simulation.files[self.index].set_len(len)?;
        simulation.count_call();
        Ok(())
    }

    fn sync_data(&self) -> io::Result<()> {
        let mut simulation = self.machine.simulation();
        simulation.count_call();
        simulation.files[self.index].sync();
        simulation.syncs += 1;
        Ok(())
    }

    fn write(&self, offset: u64, data: &[u8]) -> io::Result<()> {
        let mut simulation = self.machine.simulation();
        simulation.files[self.index].write(offset, data)?;
        simulation.largest_write = simulation.largest_write.max(data.len());
        simulation.count_call();
        Ok(())
    }
}

/// Writes `count` times; returns the expected content before the first write and after each of
/// them.
async fn write_all(
    store: &DurableStore,
    machine: &Machine,
    rng: &mut ChaCha8Rng,
    count: usize,
) -> Vec<PersistentState> {
    let mut now = PersistentState::default();
    let mut all = vec![now.clone()];
    let mut next = 0;
    let mut first = 0;
    for _ in 0..count {
        let result = match rng.random_range(0..20) {
            0..2 => {
                let vote = bytes(rng, 40);
                now.vote = Some(vote.clone());
                store.save_vote(vote).await
            }
            2 if next > first => {
                next = rng.random_range(first..next);
                now.entries.split_off(&next);
                store.truncate(next).await
            }
            3 => {
                // Every other snapshot may be written in pieces.
                let size_max = [30_000, 300_000][rng.random_range(0..2)];
                let snapshot = bytes(rng, size_max);
                now.snapshot = Some(snapshot.clone());
                match rng.random_range(0..2) {
                    0 => store.save_snapshot(snapshot).await,
                    _ => store.install_snapshot(snapshot).await,
                }
            }
            4 if next > first => {
                let through = rng.random_range(first..next);
                first = through + 1;
                let last = bytes(rng, 40);
                now.entries = now.entries.split_off(&first);
                now.purged = Some(last.clone());
                store.purge(through, last).await
            }
            _ => {
                let entries: Vec<_> = (0..rng.random_range(1..5)).map(|more| (next + more, bytes(rng, 2000))).collect();
                next += entries.len() as u64;
                now.entries.extend(entries.iter().cloned());
                store.append(entries).await
            }
        };
        result.expect("a write");
        all.push(now.clone());
        machine.simulation().acknowledged = all.len() - 1;
    }
    all
}

#[test]
fn acknowledged_writes_survive_a_power_cut_at_any_moment() {
    for seed in 0..6 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let machine = Machine::default();
        let store = machine.open().expect("a store");
        {
            let mut simulation = machine.simulation();
            let calls_before = simulation.calls;
            simulation.image_calls = (0..60).map(|_| calls_before + rng.random_range(1..1500)).collect();
            simulation.image_calls.sort_unstable_by(|a, b| b.cmp(a));
            simulation.image_calls.dedup();
            simulation.rng = Some(ChaCha8Rng::seed_from_u64(seed + 1000));
        }
        let all = super::block_on(write_all(&store, &machine, &mut rng, 120));
        drop(store);
        let images = std::mem::take(&mut machine.simulation().images);
        assert!(images.len() > 60, "{} images, seed {seed}", images.len());
        for (number, Image { files, acknowledged, kind }) in images.into_iter().enumerate() {
            let case = format!("{kind} {number} after {acknowledged} writes, seed {seed}");
            let store = Machine::with_files(files).open().unwrap_or_else(|problem| panic!("{case}: {problem}"));
            let found = store.persistent_state().expect("a log store");
            // The write in progress may be complete or not.
            let possible = &all[acknowledged..all.len().min(acknowledged + 2)];
            assert!(possible.contains(&found), "{case}: unexpected content");
        }
    }
}

#[test]
fn a_piece_of_a_snapshot_fills_a_page() {
    let machine = Machine::default();
    let store = machine.open().expect("a store");
    machine.simulation().largest_write = 0;
    super::block_on(store.save_snapshot(vec![7; 1_000_000])).expect("a write");
    let largest = machine.simulation().largest_write;
    assert!((60 * 1024..=64 * 1024).contains(&largest), "{largest} bytes");
}

#[test]
fn a_snapshot_of_the_leader_needs_few_syncs() {
    let machine = Machine::default();
    let store = machine.open().expect("a store");
    let snapshot = vec![7; 3_000_000];
    super::block_on(store.save_snapshot(snapshot.clone())).expect("a write");
    let before = machine.simulation().syncs;
    super::block_on(store.save_snapshot(snapshot.clone())).expect("a write");
    let saved = machine.simulation().syncs - before;
    super::block_on(store.install_snapshot(snapshot.clone())).expect("a write");
    let installed = machine.simulation().syncs - before - saved;
    assert!(saved > 40 && installed < 10, "{installed} syncs, and {saved} of a snapshot of its own");
    drop(store);
    let found = machine.open().expect("the same store").persistent_state().expect("a log store");
    assert!(found.snapshot == Some(snapshot));
}

#[test]
fn a_crash_during_an_installation_keeps_the_former_snapshot() {
    let machine = Machine::default();
    let store = machine.open().expect("a store");
    // The pieces of the next snapshot take two transactions.
    let (former, next) = (vec![7; 100_000], vec![8; 4_500_000]);
    super::block_on(store.save_snapshot(former.clone())).expect("a write");
    {
        let mut simulation = machine.simulation();
        let calls_before = simulation.calls;
        simulation.image_calls = (0..5).rev().map(|image| calls_before + 1 + image * 20).collect();
        simulation.rng = Some(ChaCha8Rng::seed_from_u64(7));
    }
    super::block_on(store.install_snapshot(next.clone())).expect("a write");
    drop(store);
    let images = std::mem::take(&mut machine.simulation().images);
    let mut kept = 0;
    for Image { files, kind, .. } in images {
        let store = Machine::with_files(files).open().unwrap_or_else(|problem| panic!("{kind}: {problem}"));
        let found = store.persistent_state().expect("a log store").snapshot.expect("a snapshot");
        assert!(found == former || found == next, "{kind}: {} bytes", found.len());
        kept += usize::from(found == former);
    }
    assert!(kept >= 4, "{kept} crashes before the end of the installation");
}

#[test]
fn a_store_on_a_full_disk_fails_and_loses_nothing() {
    let machine = Machine::default();
    let store = machine.open().expect("a store");
    let length_before = machine.simulation().files[0].content().len() as u64;
    machine.simulation().size_max = Some(length_before + 200_000);
    let mut acknowledged = 0;
    let problem = super::block_on(async {
        loop {
            match store.append(vec![(acknowledged, vec![7; 5000])]).await {
                Ok(()) => acknowledged += 1,
                Err(problem) => return problem,
            }
        }
    });
    assert!(acknowledged > 5, "{acknowledged}");
    assert_eq!(problem.kind(), io::ErrorKind::StorageFull);
    assert_eq!(problem.to_string(), "ledger.redb cannot be written: No space left on device (os error 28)");
    // This holds even after space becomes available: the content of the disk is only known again
    // after the next start.
    machine.simulation().size_max = None;
    let problem = super::block_on(store.save_vote(vec![1])).expect_err("a store that has failed");
    assert!(problem.to_string().contains("an earlier write has failed: No space left on device"), "{problem}");
    drop(store);
    let found = machine.open().expect("the same store").persistent_state().expect("a log store");
    assert!(found.entries.len() as u64 >= acknowledged, "{} of {acknowledged}", found.entries.len());
    assert_eq!(found.vote, None);
}
