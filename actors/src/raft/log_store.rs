//! Where a replica's log, vote and snapshot rest. Bytes only, so that a journal knows nothing of the ledger.

use async_trait::async_trait;
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

/// The name of one store, given at its creation and lost with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct StoreIdentity(pub u128);

impl StoreIdentity {
    /// An identity for a new store. Equal seeds give equal identities: a fresh store needs a fresh seed.
    pub fn from_seed(seed: u64) -> Self {
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        StoreIdentity(u128::from(chance.next_u64()) << 64 | u128::from(chance.next_u64()))
    }
}

/// Everything a journal holds, as read when a node starts.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PersistentState {
    /// The last vote.
    pub vote: Option<Vec<u8>>,
    /// How far the log was known to be committed; may lag.
    pub committed: Option<Vec<u8>>,
    /// The last entry that was purged.
    pub purged: Option<Vec<u8>>,
    /// The log, by index, without gaps.
    pub entries: BTreeMap<u64, Vec<u8>>,
    /// The newest snapshot.
    pub snapshot: Option<Vec<u8>>,
}

/// Durable storage of one replica, written by one task at a time and read once, at the start.
///
/// When a method returns `Ok`, what it was given survives a crash; [`Journal::record_committed`] alone may be lazy.
/// An error stops the replica for good: it must not go on without knowing what it has promised.
#[async_trait]
pub trait LogStore: Send + Sync + 'static {
    /// This store's name. The raft id follows from it.
    fn identity(&self) -> StoreIdentity;

    /// Where it is, for people to read.
    fn location(&self) -> String {
        "this process's memory".to_owned()
    }

    /// What a person may do when what it holds is not whole, if anything.
    fn repair_advice(&self) -> Option<&'static str> {
        None
    }

    /// All that was recorded.
    async fn load(&self) -> io::Result<PersistentState>;

    /// Replaces the vote.
    async fn save_vote(&self, vote: Vec<u8>) -> io::Result<()>;

    /// Replaces the committed position. Losing the last ones costs only time at the next start.
    async fn save_committed(&self, committed: Option<Vec<u8>>) -> io::Result<()>;

    /// Adds entries, which follow the last one without a gap.
    async fn append(&self, entries: Vec<(u64, Vec<u8>)>) -> io::Result<()>;

    /// Removes all entries from `index` on.
    async fn truncate(&self, index: u64) -> io::Result<()>;

    /// Removes all entries up to and including `index`, and remembers the last of them.
    async fn purge(&self, index: u64, last: Vec<u8>) -> io::Result<()>;

    /// Replaces the snapshot.
    async fn save_snapshot(&self, snapshot: Vec<u8>) -> io::Result<()>;
}

/// The problem, and what may be done about it if it says that the journal is not whole.
pub(crate) fn with_repair_advice(problem: io::Error, advice: Option<&str>) -> io::Error {
    match advice {
        Some(advice) if problem.kind() == io::ErrorKind::InvalidData => {
            io::Error::new(io::ErrorKind::InvalidData, format!("{problem}; {advice}"))
        }
        _ => problem,
    }
}

/// A journal in memory: gone with its last clone. A clone given to a restarted node plays a disk that survived.
#[derive(Debug, Clone)]
pub struct MemoryLogStore {
    identity: StoreIdentity,
    recorded: Arc<Mutex<PersistentState>>,
}

impl MemoryLogStore {
    /// An empty journal with an identity of its own; see [`StoreIdentity::from_seed`].
    pub fn new(identity_seed: u64) -> Self {
        MemoryLogStore { identity: StoreIdentity::from_seed(identity_seed), recorded: Arc::default() }
    }

    fn write(&self, change: impl FnOnce(&mut PersistentState)) -> io::Result<()> {
        // No change below can panic half-way, so a poisoned lock still guards a sound value.
        change(&mut self.recorded.lock().unwrap_or_else(PoisonError::into_inner));
        Ok(())
    }
}

#[async_trait]
impl LogStore for MemoryLogStore {
    fn identity(&self) -> StoreIdentity {
        self.identity
    }

    async fn load(&self) -> io::Result<PersistentState> {
        Ok(self.recorded.lock().unwrap_or_else(PoisonError::into_inner).clone())
    }

    async fn save_vote(&self, vote: Vec<u8>) -> io::Result<()> {
        self.write(|recorded| recorded.vote = Some(vote))
    }

    async fn save_committed(&self, committed: Option<Vec<u8>>) -> io::Result<()> {
        self.write(|recorded| recorded.committed = committed)
    }

    async fn append(&self, entries: Vec<(u64, Vec<u8>)>) -> io::Result<()> {
        self.write(|recorded| recorded.entries.extend(entries))
    }

    async fn truncate(&self, index: u64) -> io::Result<()> {
        self.write(|recorded| {
            recorded.entries.split_off(&index);
        })
    }

    async fn purge(&self, index: u64, last: Vec<u8>) -> io::Result<()> {
        self.write(|recorded| {
            recorded.entries = recorded.entries.split_off(&(index + 1));
            recorded.purged = Some(last);
        })
    }

    async fn save_snapshot(&self, snapshot: Vec<u8>) -> io::Result<()> {
        self.write(|recorded| recorded.snapshot = Some(snapshot))
    }
}
