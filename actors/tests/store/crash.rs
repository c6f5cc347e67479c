//! Power that fails, processes that are killed and disks that are full, at any moment of a write.
//!
//! The disk is simulated: what was written and not synced may be on it after a power cut, sector by sector, or not.

use super::{bytes, owner};
use consort_actors::raft::{LogStore, PersistentState, StoreIdentity};
use consort_actors::store::{DurableStore, OpenError, StorageBackend};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::io;
use std::sync::{Arc, Mutex};

/// What a disk writes as a whole, in bytes.
const SECTOR: usize = 512;

/// A machine with two files, which remembers how its disk would look if its power failed now.
#[derive(Debug, Clone, Default)]
struct Machine(Arc<Mutex<Inside>>);

#[derive(Debug, Default)]
struct Inside {
    files: [Content; 2],
    /// Calls so far.
    calls: u64,
    /// At which calls to take an image, the last first.
    cuts: Vec<u64>,
    /// How many writes have been acknowledged.
    acknowledged: usize,
    images: Vec<Image>,
    rng: Option<ChaCha8Rng>,
    /// Bytes that a file may have.
    room: Option<usize>,
}

#[derive(Debug, Clone, Default)]
struct Content {
    /// What the process reads.
    now: Vec<u8>,
    synced: Vec<u8>,
    since: Vec<Unsynced>,
}

#[derive(Debug, Clone)]
enum Unsynced {
    Length(usize),
    Write(usize, Vec<u8>),
}

/// What is found after a failure.
#[derive(Debug)]
struct Image {
    files: [Vec<u8>; 2],
    acknowledged: usize,
    kind: &'static str,
}

impl Content {
    fn after_power_cut(&self, rng: &mut ChaCha8Rng) -> Vec<u8> {
        let mut left = self.synced.clone();
        let luck = rng.random_range(0..=4_u8);
        let mut survives = || rng.random_range(0..4) < luck;
        for unsynced in &self.since {
            match unsynced {
                Unsynced::Length(length) => {
                    if survives() {
                        left.resize(*length, 0);
                    }
                }
                Unsynced::Write(offset, data) => {
                    let mut done = 0;
                    while done < data.len() {
                        let place = offset + done;
                        let part = (SECTOR - place % SECTOR).min(data.len() - done);
                        // Beyond the end of a file that did not grow there is nothing.
                        if survives() && place + part <= left.len() {
                            left[place..place + part].copy_from_slice(&data[done..done + part]);
                        }
                        done += part;
                    }
                }
            }
        }
        left
    }
}

impl Inside {
    fn count_call(&mut self) {
        self.calls += 1;
        if self.cuts.last() != Some(&self.calls) {
            return;
        }
        self.cuts.pop();
        let rng = self.rng.as_mut().expect("a generator");
        let cut = [0, 1].map(|file| self.files[file].after_power_cut(rng));
        let killed = [0, 1].map(|file| self.files[file].now.clone());
        for (files, kind) in [(cut, "power cut"), (killed, "kill")] {
            self.images.push(Image { files, acknowledged: self.acknowledged, kind });
        }
    }
}

impl Machine {
    fn holding(files: [Vec<u8>; 2]) -> Machine {
        let files = files.map(|now| Content { synced: now.clone(), now, since: vec![] });
        Machine(Arc::new(Mutex::new(Inside { files, ..Inside::default() })))
    }

    fn inside(&self) -> std::sync::MutexGuard<'_, Inside> {
        self.0.lock().expect("no panic")
    }

    fn open(&self) -> Result<DurableStore, OpenError> {
        let file = |index| File { machine: self.clone(), index };
        DurableStore::open_on(file(0), file(1), &owner("ada"), StoreIdentity(5))
    }
}

/// One of a machine's files.
#[derive(Debug)]
struct File {
    machine: Machine,
    index: usize,
}

impl StorageBackend for File {
    fn len(&self) -> io::Result<u64> {
        Ok(self.machine.inside().files[self.index].now.len() as u64)
    }

    fn read(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        let inside = self.machine.inside();
        let offset = usize::try_from(offset).expect("a small file");
        let found = inside.files[self.index].now.get(offset..offset + out.len());
        out.copy_from_slice(found.ok_or(io::ErrorKind::UnexpectedEof)?);
        Ok(())
    }

    fn set_len(&self, len: u64) -> io::Result<()> {
        let mut inside = self.machine.inside();
        let len = usize::try_from(len).expect("a small file");
        if inside.room.is_some_and(|room| len > room) {
            return Err(io::Error::from_raw_os_error(28)); // ENOSPC
        }
        let file = &mut inside.files[self.index];
        file.now.resize(len, 0);
        file.since.push(Unsynced::Length(len));
        inside.count_call();
        Ok(())
    }

    fn sync_data(&self) -> io::Result<()> {
        let mut inside = self.machine.inside();
        inside.count_call();
        let file = &mut inside.files[self.index];
        file.synced = file.now.clone();
        file.since.clear();
        Ok(())
    }

    fn write(&self, offset: u64, data: &[u8]) -> io::Result<()> {
        let mut inside = self.machine.inside();
        let offset = usize::try_from(offset).expect("a small file");
        let file = &mut inside.files[self.index];
        let there = file.now.get_mut(offset..offset + data.len()).ok_or(io::ErrorKind::UnexpectedEof)?;
        there.copy_from_slice(data);
        file.since.push(Unsynced::Write(offset, data.to_vec()));
        inside.count_call();
        Ok(())
    }
}

/// Writes `count` times, and tells what must be there after each of them, and before the first.
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
        let wrote = match rng.random_range(0..20) {
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
                let some: Vec<_> = (0..rng.random_range(1..5)).map(|more| (next + more, bytes(rng, 2000))).collect();
                next += some.len() as u64;
                now.entries.extend(some.iter().cloned());
                store.append(some).await
            }
        };
        wrote.expect("a write");
        all.push(now.clone());
        machine.inside().acknowledged = all.len() - 1;
    }
    all
}

#[test]
fn whatever_moment_the_power_fails_at_all_that_was_acknowledged_is_there() {
    for seed in 0..6 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let machine = Machine::default();
        let store = machine.open().expect("a store");
        {
            let mut inside = machine.inside();
            let begun = inside.calls;
            inside.cuts = (0..60).map(|_| begun + rng.random_range(1..1500)).collect();
            inside.cuts.sort_unstable_by(|one, other| other.cmp(one));
            inside.cuts.dedup();
            inside.rng = Some(ChaCha8Rng::seed_from_u64(seed + 1000));
        }
        let all = super::block_on(write_all(&store, &machine, &mut rng, 120));
        drop(store);
        let images = std::mem::take(&mut machine.inside().images);
        assert!(images.len() > 60, "{} images, seed {seed}", images.len());
        for (number, Image { files, acknowledged, kind }) in images.into_iter().enumerate() {
            let what = format!("{kind} {number} after {acknowledged} writes, seed {seed}");
            let store = Machine::holding(files).open().unwrap_or_else(|problem| panic!("{what}: {problem}"));
            let found = store.persistent_state().expect("a journal");
            // The write under way may have been finished or not.
            let possible = &all[acknowledged..all.len().min(acknowledged + 2)];
            assert!(possible.contains(&found), "{what}: something else is there");
        }
    }
}

#[test]
fn a_store_whose_disk_is_full_says_so_writes_nothing_more_and_has_lost_nothing() {
    let machine = Machine::default();
    let store = machine.open().expect("a store");
    let begun = machine.inside().files[0].now.len();
    machine.inside().room = Some(begun + 200_000);
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
    // Even if there is room again: what is on disk is known again only after the next start.
    machine.inside().room = None;
    let problem = super::block_on(store.save_vote(vec![1])).expect_err("a store that has failed");
    assert!(problem.to_string().contains("an earlier write has failed: No space left on device"), "{problem}");
    drop(store);
    let found = machine.open().expect("the same store").persistent_state().expect("a journal");
    assert!(found.entries.len() as u64 >= acknowledged, "{} of {acknowledged}", found.entries.len());
    assert_eq!(found.vote, None);
}
