//! Simulated disk with latency, which loses unacknowledged writes in a crash.
//!
//! Writes reach the platter in the order of their requests. Each write is acknowledged after it has
//! reached the platter, and not before. A crash drops the queue: a random number of waiting writes
//! still reach the platter, the rest is lost. A real disk may do the same when its cache has just
//! been ordered to flush.

use async_trait::async_trait;
use consort_raft::store::{CheckpointStore, NodeStore};
use consort_raft::{LogStore, PersistentState, StoreIdentity};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Duration of a write on a healthy disk: the flush of an SSD.
const QUICK: (Duration, Duration) = (Duration::from_micros(500), Duration::from_millis(3));

/// Effect of a crash on writes in the queue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum UnsyncedWrites {
    /// All of them reach the platter.
    AllKept,
    /// A random prefix reaches the platter; the rest is lost.
    SomeLost,
}

/// Disk of a node. Clones share the same disk; it outlives the node.
#[derive(Clone)]
pub(crate) struct VirtualDisk(Arc<Mutex<State>>);

struct State {
    identity: StoreIdentity,
    journal: PersistentState,
    page: Option<Vec<u8>>,
    /// Queued writes with their sequence numbers.
    waiting: VecDeque<(u64, Write)>,
    /// Sequence number of the last queued write.
    writes: u64,
    /// Sequence number of the last write on the platter.
    there: u64,
    slow: Option<(Duration, Duration)>,
    chance: ChaCha8Rng,
    /// Incarnation of the node that may write. Queued writes of an earlier incarnation are void.
    life: u64,
}

enum Write {
    Vote(Vec<u8>),
    Committed(Option<Vec<u8>>),
    Append(Vec<(u64, Vec<u8>)>),
    Truncate(u64),
    Purge(u64, Vec<u8>),
    Snapshot(Vec<u8>),
    Page(Option<Vec<u8>>),
}

impl VirtualDisk {
    /// Creates an empty disk with its own identity.
    pub(crate) fn new(seed: u64) -> VirtualDisk {
        VirtualDisk(Arc::new(Mutex::new(State {
            identity: StoreIdentity::from_seed(seed),
            journal: PersistentState::default(),
            page: None,
            waiting: VecDeque::new(),
            writes: 0,
            there: 0,
            slow: None,
            chance: ChaCha8Rng::seed_from_u64(seed),
            life: 0,
        })))
    }

    /// Returns the store of the next incarnation. Writes of the previous incarnation are void from
    /// now on.
    pub(crate) fn store(&self) -> NodeStore {
        let mut state = self.lock();
        state.life += 1;
        let end = Arc::new(End { disk: self.clone(), life: state.life });
        NodeStore { log_store: end.clone(), checkpoints: end }
    }

    /// Sets the duration range of each write, from the shortest to the longest; `None` restores the
    /// default.
    pub(crate) fn set_slow(&self, slow: Option<(Duration, Duration)>) {
        self.lock().slow = slow;
    }

    /// Applies a crash of the node.
    pub(crate) fn crash(&self, torn: UnsyncedWrites) {
        let mut state = self.lock();
        let made_it = match torn {
            UnsyncedWrites::AllKept => state.waiting.len(),
            UnsyncedWrites::SomeLost => {
                let most = state.waiting.len();
                state.chance.random_range(0..=most)
            }
        };
        for _ in 0..made_it {
            state.land();
        }
        state.waiting.clear();
        state.life += 1;
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Applies the next queued write to the platter.
    fn land(&mut self) {
        let Some((number, write)) = self.waiting.pop_front() else { return };
        self.there = number;
        let journal = &mut self.journal;
        match write {
            Write::Vote(vote) => journal.vote = Some(vote),
            Write::Committed(committed) => journal.committed = committed,
            Write::Append(entries) => journal.entries.extend(entries),
            Write::Truncate(index) => drop(journal.entries.split_off(&index)),
            Write::Purge(index, last) => {
                journal.entries = journal.entries.split_off(&(index + 1));
                journal.purged = Some(last);
            }
            Write::Snapshot(snapshot) => journal.snapshot = Some(snapshot),
            Write::Page(page) => self.page = page,
        }
    }

    fn delay(&mut self) -> Duration {
        let (least, most) = self.slow.unwrap_or(QUICK);
        self.chance.random_range(least..=most)
    }
}

/// Handle of an incarnation to a disk.
struct End {
    disk: VirtualDisk,
    life: u64,
}

impl End {
    fn state(&self) -> io::Result<MutexGuard<'_, State>> {
        let state = self.disk.lock();
        if state.life == self.life { Ok(state) } else { Err(io::Error::other("the node has crashed")) }
    }

    fn count_write(&self, write: Write) -> io::Result<(u64, Duration)> {
        let mut state = self.state()?;
        state.writes += 1;
        let number = state.writes;
        state.waiting.push_back((number, write));
        let delay = state.delay();
        Ok((number, delay))
    }

    /// Queues a write and returns once it and all earlier writes are on the platter.
    async fn write(&self, write: Write) -> io::Result<()> {
        let (number, delay) = self.count_write(write)?;
        tokio::time::sleep(delay).await;
        let mut state = self.state()?;
        while state.there < number {
            state.land();
        }
        Ok(())
    }
}

#[async_trait]
impl LogStore for End {
    fn identity(&self) -> StoreIdentity {
        self.disk.lock().identity
    }

    async fn load(&self) -> io::Result<PersistentState> {
        Ok(self.state()?.journal.clone())
    }

    async fn save_vote(&self, vote: Vec<u8>) -> io::Result<()> {
        self.write(Write::Vote(vote)).await
    }

    async fn save_committed(&self, committed: Option<Vec<u8>>) -> io::Result<()> {
        // This write may be lazy: it reaches the platter with the next other write.
        self.count_write(Write::Committed(committed)).map(drop)
    }

    async fn append(&self, entries: Vec<(u64, Vec<u8>)>) -> io::Result<()> {
        self.write(Write::Append(entries)).await
    }

    async fn truncate(&self, index: u64) -> io::Result<()> {
        self.write(Write::Truncate(index)).await
    }

    async fn purge(&self, index: u64, last: Vec<u8>) -> io::Result<()> {
        self.write(Write::Purge(index, last)).await
    }

    async fn save_snapshot(&self, snapshot: Vec<u8>) -> io::Result<()> {
        self.write(Write::Snapshot(snapshot)).await
    }
}

#[async_trait]
impl CheckpointStore for End {
    async fn read(&self) -> io::Result<Option<Vec<u8>>> {
        Ok(self.state()?.page.clone())
    }

    async fn write(&self, page: Option<Vec<u8>>) -> io::Result<()> {
        End::write(self, Write::Page(page)).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(index: u64) -> Vec<(u64, Vec<u8>)> {
        vec![(index, vec![1])]
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn a_crash_keeps_acknowledged_writes_and_a_prefix_of_the_rest() {
        let mut kept = vec![];
        for seed in 0..20 {
            let disk = VirtualDisk::new(seed);
            let store = disk.store();
            store.log_store.append(entry(1)).await.expect("a healthy disk");
            for index in 2..=4 {
                let journal = store.log_store.clone();
                tokio::spawn(async move { journal.append(entry(index)).await });
                tokio::task::yield_now().await;
            }
            disk.crash(UnsyncedWrites::SomeLost);
            let held: Vec<u64> = disk.store().log_store.load().await.expect("readable").entries.into_keys().collect();
            assert_eq!(held, (1..=held.len() as u64).collect::<Vec<_>>(), "seed {seed}: no gaps");
            kept.push(held.len());
            assert!(store.log_store.append(entry(9)).await.is_err(), "seed {seed}: the former life is over");
        }
        kept.sort_unstable();
        kept.dedup();
        assert_eq!(kept, [1, 2, 3, 4], "each outcome comes about");
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn a_slow_disk_delays_writes() {
        let disk = VirtualDisk::new(1);
        disk.set_slow(Some((Duration::from_millis(200), Duration::from_millis(300))));
        let before = tokio::time::Instant::now();
        disk.store().checkpoints.write(Some(vec![7])).await.expect("a healthy disk");
        assert!(before.elapsed() >= Duration::from_millis(200));
        assert_eq!(disk.store().checkpoints.read().await.expect("readable"), Some(vec![7]));
    }
}
