//! Power failures, killed processes and full disks, at any moment of a write.
//!
//! The disk is simulated: after a power failure, data that was written and not synced is on the
//! disk or not, independently for each sector.

use super::{bytes, owner};
use consort_raft::store::{DurableStore, OpenError, StorageBackend};
use consort_raft::{LogStore, PersistentState, StoreIdentity};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::io;
use std::sync::{Arc, Mutex};

/// Unit that a disk writes atomically, in bytes.
const SECTOR: usize = 512;

/// A machine with two files. It can compute the content of its disk after a power failure at the
/// present moment.
#[derive(Debug, Clone, Default)]
struct Machine(Arc<Mutex<Simulation>>);

#[derive(Debug, Default)]
struct Simulation {
    files: [FileContent; 2],
    /// Number of calls so far.
    calls: u64,
    /// Call numbers at which to take an image, in descending order.
    image_calls: Vec<u64>,
    /// Number of acknowledged writes.
    acknowledged: usize,
    images: Vec<Image>,
    rng: Option<ChaCha8Rng>,
    /// Size limit of a file, in bytes.
    size_max: Option<usize>,
}

#[derive(Debug, Clone, Default)]
struct FileContent {
    /// Content as seen by the process.
    now: Vec<u8>,
    synced: Vec<u8>,
    unsynced: Vec<Unsynced>,
}

#[derive(Debug, Clone)]
enum Unsynced {
    Length(usize),
    Write(usize, Vec<u8>),
}

/// Content of the files after a failure.
#[derive(Debug)]
struct Image {
    files: [Vec<u8>; 2],
    acknowledged: usize,
    kind: &'static str,
}

impl FileContent {
    fn after_power_cut(&self, rng: &mut ChaCha8Rng) -> Vec<u8> {
        let mut remaining = self.synced.clone();
        let survival_chance = rng.random_range(0..=4_u8);
        let mut survives = || rng.random_range(0..4) < survival_chance;
        for operation in &self.unsynced {
            match operation {
                Unsynced::Length(length) => {
                    if survives() {
                        remaining.resize(*length, 0);
                    }
                }
                Unsynced::Write(offset, data) => {
                    let mut done = 0;
                    while done < data.len() {
                        let position = offset + done;
                        let length = (SECTOR - position % SECTOR).min(data.len() - done);
                        // There is nothing beyond the end of a file that did not grow.
                        if survives() && position + length <= remaining.len() {
                            remaining[position..position + length].copy_from_slice(&data[done..done + length]);
                        }
                        done += length;
                    }
                }
            }
        }
        remaining
    }
}

impl Simulation {
    fn count_call(&mut self) {
        self.calls += 1;
        if self.image_calls.last() != Some(&self.calls) {
            return;
        }
        self.image_calls.pop();
        let rng = self.rng.as_mut().expect("a generator");
        let after_power_cut = [0, 1].map(|file| self.files[file].after_power_cut(rng));
        let after_kill = [0, 1].map(|file| self.files[file].now.clone());
        for (files, kind) in [(after_power_cut, "power cut"), (after_kill, "kill")] {
            self.images.push(Image { files, acknowledged: self.acknowledged, kind });
        }
    }
}

impl Machine {
    fn with_files(files: [Vec<u8>; 2]) -> Machine {
        let files = files.map(|now| FileContent { synced: now.clone(), now, unsynced: vec![] });
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
        Ok(self.machine.simulation().files[self.index].now.len() as u64)
    }

    fn read(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        let simulation = self.machine.simulation();
        let offset = usize::try_from(offset).expect("a small file");
        let found = simulation.files[self.index].now.get(offset..offset + out.len());
        out.copy_from_slice(found.ok_or(io::ErrorKind::UnexpectedEof)?);
        Ok(())
    }

    fn set_len(&self, len: u64) -> io::Result<()> {
        let mut simulation = self.machine.simulation();
        let len = usize::try_from(len).expect("a small file");
        if simulation.size_max.is_some_and(|size_max| len > size_max) {
            return Err(io::Error::from_raw_os_error(28)); // ENOSPC
        }
        let file = &mut simulation.files[self.index];
        file.now.resize(len, 0);
        file.unsynced.push(Unsynced::Length(len));
        simulation.count_call();
        Ok(())
    }

    fn sync_data(&self) -> io::Result<()> {
        let mut simulation = self.machine.simulation();
        simulation.count_call();
        let file = &mut simulation.files[self.index];
        file.synced = file.now.clone();
        file.unsynced.clear();
        Ok(())
    }

    fn write(&self, offset: u64, data: &[u8]) -> io::Result<()> {
        let mut simulation = self.machine.simulation();
        let offset = usize::try_from(offset).expect("a small file");
        let file = &mut simulation.files[self.index];
        let target = file.now.get_mut(offset..offset + data.len()).ok_or(io::ErrorKind::UnexpectedEof)?;
        target.copy_from_slice(data);
        file.unsynced.push(Unsynced::Write(offset, data.to_vec()));
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
                let snapshot = bytes(rng, 30_000);
                now.snapshot = Some(snapshot.clone());
                store.save_snapshot(snapshot).await
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
fn a_store_on_a_full_disk_fails_and_loses_nothing() {
    let machine = Machine::default();
    let store = machine.open().expect("a store");
    let calls_before = machine.simulation().files[0].now.len();
    machine.simulation().size_max = Some(calls_before + 200_000);
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
