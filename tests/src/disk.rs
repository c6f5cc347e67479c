//! Simulated disks: the durable store over files that lose, tear and damage what was written.
//!
//! A write takes time. At its middle it reaches the files of the store; at its end it is acknowledged.
//! A crash loses the writes that have not reached the files. A power failure may also interrupt the
//! next of them at any call to the file system, and loses data that was not synced.

use async_trait::async_trait;
use consort_raft::store::{
    CheckpointStore, DurableStore, NodeStore, OpenError, SimulatedFile, StorageBackend, StoreOwner,
};
use consort_raft::{LogStore, PersistentState, StoreIdentity};
use rand::seq::IndexedRandom as _;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::{self, Debug};
use std::io;
use std::pin::pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::task::{Context, Poll, Waker};
use std::time::Duration;
use tokio::sync::watch;

/// Duration of a write on a healthy disk: the flush of an SSD.
const QUICK: (Duration, Duration) = (Duration::from_micros(500), Duration::from_millis(3));

/// Largest number of calls to the file system before a power failure interrupts a write.
const CALLS_MAX: u32 = 12;

/// Distance of the damaged bytes in a file: two in each page of the store.
const DAMAGE_DISTANCE: usize = 2048;

/// Index of the ledger file among the files of a disk.
const LEDGER: usize = 0;

/// Numbers of writes that have reached the files of disks, by what they do to the log.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct LogWrites {
    /// Snapshots of the own state.
    pub(crate) snapshots: usize,
    /// Purges of entries that a snapshot covers.
    pub(crate) purges: usize,
    /// Installations of a leader's snapshot.
    pub(crate) installations: usize,
}

impl LogWrites {
    fn of(write: &Write) -> LogWrites {
        LogWrites {
            snapshots: usize::from(matches!(write, Write::Snapshot(_))),
            purges: usize::from(matches!(write, Write::Purge(..))),
            installations: usize::from(matches!(write, Write::LeaderSnapshot(_))),
        }
    }

    /// Adds the writes of another disk.
    pub(crate) fn add(&mut self, other: LogWrites) {
        self.snapshots += other.snapshots;
        self.purges += other.purges;
        self.installations += other.installations;
    }
}

/// Effect of a crash on the files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CrashEffect {
    /// The process is killed: everything that it has written remains.
    Kill,
    /// Power fails: what was not synced is lost in part.
    PowerFailure,
    /// The process is killed, and the ledger file is damaged afterwards.
    Damage,
}

/// Fault of a disk while its node runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DiskFault {
    /// Writes and syncs fail (`EIO`).
    Fails,
    /// The disk is full (`ENOSPC`).
    Full,
    /// Writes do not end.
    Hangs,
    /// Syncs of the ledger file succeed and do nothing.
    Lies,
}

/// Disk of a node. Clones share the same disk; it outlives the node.
#[derive(Clone)]
pub(crate) struct VirtualDisk(Arc<Mutex<State>>);

struct State {
    owner: StoreOwner,
    /// The ledger and its commit marker.
    files: [SimulatedFile; 2],
    slow: Option<(Duration, Duration)>,
    fault: watch::Sender<Option<DiskFault>>,
    /// Number of calls until power fails.
    calls_left: Option<u32>,
    chance: ChaCha8Rng,
    /// Incarnation of the node that may write. Writes of an earlier incarnation have no effect.
    life: u64,
    /// Writes of this incarnation that have not reached the files, by number.
    waiting: BTreeMap<u64, Write>,
    /// Number of writes so far.
    writes: u64,
    /// The store of this incarnation.
    store: Option<DurableStore>,
    /// Number of damaged stores that were replaced.
    replaced: u32,
    /// Writes of all incarnations.
    log_writes: LogWrites,
}

#[derive(Debug, Clone)]
enum Write {
    Vote(Vec<u8>),
    Append(Vec<(u64, Vec<u8>)>),
    Truncate(u64),
    Purge(u64, Vec<u8>),
    Snapshot(Vec<u8>),
    LeaderSnapshot(Vec<u8>),
    Checkpoint(Option<Vec<u8>>),
}

impl VirtualDisk {
    /// Creates an empty disk with its own identity.
    pub(crate) fn new(seed: u64) -> VirtualDisk {
        let owner = StoreOwner { fleet: crate::slug("chaos"), node: crate::slug("node") };
        VirtualDisk(Arc::new(Mutex::new(State {
            owner,
            files: Default::default(),
            slow: None,
            fault: watch::Sender::new(None),
            calls_left: None,
            chance: ChaCha8Rng::seed_from_u64(seed),
            life: 0,
            waiting: BTreeMap::new(),
            writes: 0,
            store: None,
            replaced: 0,
            log_writes: LogWrites::default(),
        })))
    }

    /// Opens the store for the next incarnation, and replaces it if it is damaged, as a node does.
    pub(crate) fn store(&self) -> NodeStore {
        let (life, owner, identity) = {
            let mut state = self.lock();
            state.life += 1;
            (state.life, state.owner.clone(), StoreIdentity::from_seed(state.chance.random()))
        };
        let file = |index| File { disk: Arc::downgrade(&self.0), index, life };
        let store = match DurableStore::open_on(file(0), file(1), &owner, identity) {
            Err(OpenError::Damaged { .. }) => {
                {
                    let mut state = self.lock();
                    state.files = Default::default();
                    state.replaced += 1;
                }
                DurableStore::create_on(file(0), file(1), &owner, identity, Some(0))
            }
            opened => opened,
        };
        let store = store.expect("the files of a disk without an active fault");
        self.lock().store = Some(store.clone());
        let incarnation = Arc::new(Incarnation { disk: self.clone(), life, store });
        NodeStore { log_store: incarnation.clone(), checkpoints: incarnation }
    }

    /// Sets the duration range of each write, from the shortest to the longest; `None` restores the
    /// default.
    pub(crate) fn set_slow(&self, slow: Option<(Duration, Duration)>) {
        self.lock().slow = slow;
    }

    /// Begins or ends a fault.
    pub(crate) fn set_fault(&self, fault: Option<DiskFault>) {
        self.lock().fault.send_replace(fault);
    }

    /// Returns the numbers of writes that have reached the files while their node ran.
    pub(crate) fn log_writes(&self) -> LogWrites {
        self.lock().log_writes
    }

    /// Returns the number of damaged stores that were replaced.
    pub(crate) fn replaced(&self) -> u32 {
        self.lock().replaced
    }

    /// Checks whether a fault is active.
    pub(crate) fn has_fault(&self) -> bool {
        self.lock().fault.borrow().is_some()
    }

    /// Applies a crash of the node, which has ended. It also ends a fault. After a power failure, the ledger
    /// file of a disk that lied lacks what was not synced, and its commit marker is complete: without the
    /// marker a store cannot detect the loss.
    pub(crate) fn crash(&self, effect: CrashEffect) {
        let (store, waiting, complete) = {
            let mut state = self.lock();
            let waiting: Vec<Write> = std::mem::take(&mut state.waiting).into_values().collect();
            let complete = match effect {
                CrashEffect::Kill | CrashEffect::Damage => waiting.len(),
                CrashEffect::PowerFailure => state.chance.random_range(0..=waiting.len()),
            };
            (state.store.take(), waiting, complete)
        };
        if let Some(store) = store {
            // An error was due to a fault, or to the loss of power. Nobody waits for the result.
            let perform = |write: &Write| drop(now(perform(&store, write.clone())));
            waiting[..complete].iter().for_each(perform);
            if let Some(interrupted) = waiting.get(complete) {
                let calls = self.lock().chance.random_range(0..CALLS_MAX);
                self.lock().calls_left = Some(calls);
                perform(interrupted);
            }
            self.lock().life += 1;
        }
        let mut state = self.lock();
        let state = &mut *state;
        state.calls_left = None;
        let fault = state.fault.send_replace(None);
        match effect {
            CrashEffect::Kill => {}
            CrashEffect::PowerFailure => {
                let State { files: [ledger, marker], chance, .. } = state;
                *ledger = SimulatedFile::with_content(ledger.after_power_failure(chance));
                if fault != Some(DiskFault::Lies) {
                    *marker = SimulatedFile::with_content(marker.after_power_failure(chance));
                }
            }
            CrashEffect::Damage => state.damage(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Result of work that never waits: a store on simulated files does not.
fn now<T>(work: impl Future<Output = T>) -> Option<T> {
    match pin!(work).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(result) => Some(result),
        Poll::Pending => None,
    }
}

async fn perform(store: &DurableStore, write: Write) -> io::Result<()> {
    match write {
        Write::Vote(vote) => store.save_vote(vote).await,
        Write::Append(entries) => store.append(entries).await,
        Write::Truncate(index) => store.truncate(index).await,
        Write::Purge(index, last) => store.purge(index, last).await,
        Write::Snapshot(snapshot) => store.save_snapshot(snapshot).await,
        Write::LeaderSnapshot(snapshot) => store.install_snapshot(snapshot).await,
        Write::Checkpoint(checkpoint) => store.write(checkpoint).await,
    }
}

impl State {
    /// Damages the ledger file: bits flip, the end is missing, or pages contain other pages.
    fn damage(&mut self) {
        let mut content = self.files[LEDGER].content().to_vec();
        let half = content.len() / 2;
        match [0, 1, 2].choose(&mut self.chance).expect("three kinds") {
            0 => content.iter_mut().skip(DAMAGE_DISTANCE).step_by(DAMAGE_DISTANCE).for_each(|byte| *byte ^= 0x10),
            1 => content.truncate(half),
            _ => content.copy_within(half.., DAMAGE_DISTANCE * 2),
        }
        self.files[LEDGER] = SimulatedFile::with_content(content);
    }

    fn delay(&mut self) -> Duration {
        let (least, most) = self.slow.unwrap_or(QUICK);
        self.chance.random_range(least..=most)
    }

    /// Counts a call to the file system that changes a file.
    fn call(&mut self) -> io::Result<()> {
        let fault = *self.fault.borrow();
        match fault {
            Some(DiskFault::Fails) => return Err(io::Error::from_raw_os_error(5)), // EIO
            Some(DiskFault::Full) => return Err(io::Error::from_raw_os_error(28)), // ENOSPC
            Some(DiskFault::Hangs | DiskFault::Lies) | None => {}
        }
        match &mut self.calls_left {
            Some(0) => Err(io::Error::other("power has failed")),
            Some(calls) => {
                *calls -= 1;
                Ok(())
            }
            None => Ok(()),
        }
    }
}

/// File of a disk, opened by an incarnation. The disk contains the store, which contains its files.
struct File {
    disk: Weak<Mutex<State>>,
    index: usize,
    life: u64,
}

impl Debug for File {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "file {}", self.index)
    }
}

impl File {
    /// Runs an operation on the state of the disk, unless the node has crashed.
    fn with<T>(&self, operation: impl FnOnce(&mut State) -> io::Result<T>) -> io::Result<T> {
        let disk = self.disk.upgrade().ok_or_else(|| io::Error::other("the disk is gone"))?;
        let mut state = disk.lock().unwrap_or_else(PoisonError::into_inner);
        if state.life == self.life { operation(&mut state) } else { Err(io::Error::other("the node has crashed")) }
    }
}

impl StorageBackend for File {
    fn len(&self) -> io::Result<u64> {
        self.with(|state| Ok(state.files[self.index].content().len() as u64))
    }

    fn read(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        self.with(|state| state.files[self.index].read(offset, out))
    }

    fn set_len(&self, length: u64) -> io::Result<()> {
        self.with(|state| {
            state.call()?;
            state.files[self.index].set_len(length)
        })
    }

    fn sync_data(&self) -> io::Result<()> {
        self.with(|state| {
            state.call()?;
            let lies = self.index == LEDGER && *state.fault.borrow() == Some(DiskFault::Lies);
            if !lies {
                state.files[self.index].sync();
            }
            Ok(())
        })
    }

    fn write(&self, offset: u64, data: &[u8]) -> io::Result<()> {
        self.with(|state| {
            state.call()?;
            state.files[self.index].write(offset, data)
        })
    }
}

/// Store of an incarnation.
struct Incarnation {
    disk: VirtualDisk,
    life: u64,
    store: DurableStore,
}

impl Incarnation {
    fn state(&self) -> io::Result<MutexGuard<'_, State>> {
        let state = self.disk.lock();
        if state.life == self.life { Ok(state) } else { Err(io::Error::other("the node has crashed")) }
    }

    /// Writes, and returns when the write is acknowledged.
    async fn write(&self, write: Write) -> io::Result<()> {
        let (number, half, mut fault) = {
            let mut state = self.state()?;
            state.writes += 1;
            let (number, half) = (state.writes, state.delay() / 2);
            state.waiting.insert(number, write);
            (number, half, state.fault.subscribe())
        };
        tokio::time::sleep(half).await;
        // The sender lives as long as the disk.
        let _ = fault.wait_for(|fault| *fault != Some(DiskFault::Hangs)).await;
        // Writes reach the files in their order.
        let due: Vec<Write> = {
            let mut state = self.state()?;
            let later = state.waiting.split_off(&(number + 1));
            std::mem::replace(&mut state.waiting, later).into_values().collect()
        };
        for write in due {
            let performed = LogWrites::of(&write);
            perform(&self.store, write).await?;
            self.disk.lock().log_writes.add(performed);
        }
        tokio::time::sleep(half).await;
        self.state().map(drop)
    }
}

#[async_trait]
impl LogStore for Incarnation {
    fn identity(&self) -> StoreIdentity {
        self.store.identity()
    }

    fn replaces_damaged(&self) -> bool {
        self.store.replaces_damaged()
    }

    async fn load(&self) -> io::Result<PersistentState> {
        self.store.load().await
    }

    async fn save_vote(&self, vote: Vec<u8>) -> io::Result<()> {
        self.write(Write::Vote(vote)).await
    }

    async fn save_committed(&self, committed: Option<Vec<u8>>) -> io::Result<()> {
        drop(self.state()?);
        self.store.save_committed(committed).await
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

    async fn install_snapshot(&self, snapshot: Vec<u8>) -> io::Result<()> {
        self.write(Write::LeaderSnapshot(snapshot)).await
    }
}

#[async_trait]
impl CheckpointStore for Incarnation {
    async fn read(&self) -> io::Result<Option<Vec<u8>>> {
        self.store.read().await
    }

    async fn write(&self, page: Option<Vec<u8>>) -> io::Result<()> {
        Incarnation::write(self, Write::Checkpoint(page)).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(index: u64) -> Vec<(u64, Vec<u8>)> {
        vec![(index, vec![1])]
    }

    async fn entries(disk: &VirtualDisk) -> Vec<u64> {
        disk.store().log_store.load().await.expect("readable").entries.into_keys().collect()
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn a_power_failure_keeps_acknowledged_writes_and_a_prefix_of_the_rest() {
        let mut kept = vec![];
        for seed in 0..40 {
            let disk = VirtualDisk::new(seed);
            let store = disk.store();
            store.log_store.append(entry(1)).await.expect("a healthy disk");
            for index in 2..=4 {
                let log_store = store.log_store.clone();
                tokio::spawn(async move { log_store.append(entry(index)).await });
                tokio::task::yield_now().await;
            }
            disk.crash(CrashEffect::PowerFailure);
            let held = entries(&disk).await;
            assert_eq!(held, (1..=held.len() as u64).collect::<Vec<_>>(), "seed {seed}: no gaps");
            assert_eq!(disk.replaced(), 0, "seed {seed}: a power failure is no damage");
            kept.push(held.len());
            assert!(store.log_store.append(entry(9)).await.is_err(), "seed {seed}: the former life is over");
        }
        kept.sort_unstable();
        kept.dedup();
        assert_eq!(kept, [1, 2, 3, 4], "each outcome comes about");
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn snapshots_and_purges_that_reach_the_files_are_counted() {
        let disk = VirtualDisk::new(1);
        let store = disk.store().log_store;
        store.append(entry(1)).await.expect("a healthy disk");
        assert_eq!(disk.log_writes(), LogWrites::default());
        store.save_snapshot(vec![1]).await.expect("a healthy disk");
        store.purge(1, vec![1]).await.expect("a healthy disk");
        disk.set_fault(Some(DiskFault::Fails));
        store.save_snapshot(vec![2]).await.expect_err("a fault");
        let mut writes = disk.log_writes();
        assert_eq!(writes, LogWrites { snapshots: 1, purges: 1, installations: 0 });
        writes.add(LogWrites { installations: 2, ..writes });
        assert_eq!(writes, LogWrites { snapshots: 2, purges: 2, installations: 2 });
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn a_disk_is_freed_with_its_last_user() {
        let disk = VirtualDisk::new(1);
        let (freed, store) = (Arc::downgrade(&disk.0), disk.store());
        store.log_store.append(entry(1)).await.expect("a healthy disk");
        drop((disk, store));
        assert!(freed.upgrade().is_none(), "thousands of runs would not fit into memory");
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn damage_and_lost_syncs_are_detected() {
        for seed in 0..20 {
            let disk = VirtualDisk::new(seed);
            let store = disk.store();
            for index in 1..30 {
                store.log_store.append(entry(index)).await.expect("a healthy disk");
            }
            disk.crash(CrashEffect::Damage);
            assert_eq!((entries(&disk).await, disk.replaced()), (vec![], 1), "seed {seed}");
            disk.crash(CrashEffect::Kill);
            let store = disk.store();
            assert!(store.log_store.replaces_damaged(), "seed {seed}");
            disk.set_fault(Some(DiskFault::Lies));
            for index in 1..5 {
                store.log_store.append(entry(index)).await.expect("a disk that lies");
            }
            disk.crash(CrashEffect::PowerFailure);
            let held = entries(&disk).await;
            assert!(disk.replaced() == 2 || held == [1, 2, 3, 4], "seed {seed}: {held:?}");
        }
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn a_disk_that_fails_is_usable_after_a_restart() {
        for (fault, code) in [(DiskFault::Fails, 5), (DiskFault::Full, 28)] {
            let disk = VirtualDisk::new(1);
            let store = disk.store();
            store.log_store.append(entry(1)).await.expect("a healthy disk");
            disk.set_fault(Some(fault));
            let error = store.log_store.append(entry(2)).await.expect_err("a fault").to_string();
            assert!(error.contains(&format!("os error {code}")), "{error}");
            disk.set_fault(None);
            assert!(store.log_store.append(entry(3)).await.is_err(), "nothing is written after a failure");
            disk.crash(CrashEffect::Kill);
            assert_eq!((entries(&disk).await, disk.replaced()), (vec![1], 0));
        }
    }

    #[tokio::test(flavor = "current_thread", start_paused = true)]
    async fn slow_and_hanging_disks_delay_writes() {
        let disk = VirtualDisk::new(1);
        disk.set_slow(Some((Duration::from_millis(200), Duration::from_millis(300))));
        let before = tokio::time::Instant::now();
        let store = disk.store();
        store.checkpoints.write(Some(vec![7])).await.expect("a healthy disk");
        assert!(before.elapsed() >= Duration::from_millis(200));
        disk.set_fault(Some(DiskFault::Hangs));
        let mut write = store.checkpoints.write(Some(vec![8]));
        tokio::time::timeout(Duration::from_secs(60), &mut write).await.expect_err("the write must not end");
        disk.set_fault(None);
        write.await.expect("a healthy disk");
        assert_eq!(disk.store().checkpoints.read().await.expect("readable"), Some(vec![8]));
    }
}
