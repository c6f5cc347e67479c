//! A disk that takes time, and that forgets at a crash what it had not acknowledged.
//!
//! Writes reach the platter in the order in which they were asked for. Each is acknowledged when it is there, and not
//! before. A crash tears off the queue: how many of the waiting writes made it is drawn by chance, the rest is gone, as it
//! may be on a real disk whose cache has just been ordered to be flushed.

use async_trait::async_trait;
use consort_actors::raft::{LogStore, PersistentState, StoreIdentity};
use consort_actors::store::{CheckpointStore, NodeStore};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How long a write takes on a disk in good order: an SSD's flush.
const QUICK: (Duration, Duration) = (Duration::from_micros(500), Duration::from_millis(3));

/// What becomes of writes that a crash meets on their way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UnsyncedWrites {
    /// All of them made it.
    AllKept,
    /// Some of the first made it, by chance; the rest is gone.
    SomeLost,
}

/// A node's disk. Clones are the same disk; it outlives the node.
#[derive(Clone)]
pub struct VirtualDisk(Arc<Mutex<State>>);

struct State {
    identity: StoreIdentity,
    journal: PersistentState,
    page: Option<Vec<u8>>,
    /// Asked for and not there yet, with a running number.
    waiting: VecDeque<(u64, Write)>,
    /// Number of the last write that was asked for.
    asked: u64,
    /// Number of the last write that is there.
    there: u64,
    slow: Option<(Duration, Duration)>,
    chance: ChaCha8Rng,
    /// Which life of the node writes: what an earlier one still has in hand is void.
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
    /// An empty disk with a name of its own.
    pub fn new(seed: u64) -> VirtualDisk {
        VirtualDisk(Arc::new(Mutex::new(State {
            identity: StoreIdentity::from_seed(seed),
            journal: PersistentState::default(),
            page: None,
            waiting: VecDeque::new(),
            asked: 0,
            there: 0,
            slow: None,
            chance: ChaCha8Rng::seed_from_u64(seed),
            life: 0,
        })))
    }

    /// The memory of the node's next life. The former one's writes are void from now on.
    pub fn store(&self) -> NodeStore {
        let mut state = self.lock();
        state.life += 1;
        let end = Arc::new(End { disk: self.clone(), life: state.life });
        NodeStore { log_store: end.clone(), checkpoints: end }
    }

    /// From now on each write takes so long, from the shortest to the longest; `None` ends that.
    pub fn set_slow(&self, slow: Option<(Duration, Duration)>) {
        self.lock().slow = slow;
    }

    /// The node has crashed.
    pub fn crash(&self, torn: UnsyncedWrites) {
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
    /// The next write reaches the platter.
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

/// One life's end of a disk.
struct End {
    disk: VirtualDisk,
    life: u64,
}

impl End {
    fn state(&self) -> io::Result<MutexGuard<'_, State>> {
        let state = self.disk.lock();
        if state.life == self.life { Ok(state) } else { Err(io::Error::other("the node has crashed")) }
    }

    fn ask(&self, write: Write) -> io::Result<(u64, Duration)> {
        let mut state = self.state()?;
        state.asked += 1;
        let number = state.asked;
        state.waiting.push_back((number, write));
        let delay = state.delay();
        Ok((number, delay))
    }

    /// Writes, and returns when it is there; with it, all that was asked for before.
    async fn write(&self, write: Write) -> io::Result<()> {
        let (number, delay) = self.ask(write)?;
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
        // It may be lazy: it lands with whatever is written next.
        self.ask(Write::Committed(committed)).map(drop)
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
    async fn what_was_acknowledged_survives_and_what_was_not_is_torn_off_in_order() {
        let mut kept = vec![];
        for seed in 0..20 {
            let disk = VirtualDisk::new(seed);
            let store = disk.store();
            store.log_store.append(entry(1)).await.expect("a disk in good order");
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
    async fn a_slow_disk_takes_its_time() {
        let disk = VirtualDisk::new(1);
        disk.set_slow(Some((Duration::from_millis(200), Duration::from_millis(300))));
        let before = tokio::time::Instant::now();
        disk.store().checkpoints.write(Some(vec![7])).await.expect("a disk in good order");
        assert!(before.elapsed() >= Duration::from_millis(200));
        assert_eq!(disk.store().checkpoints.read().await.expect("readable"), Some(vec![7]));
    }
}
