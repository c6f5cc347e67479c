//! Durable storage of a replica's log, vote and snapshot. It stores bytes only, so it does not
//! depend on the ledger.

use async_trait::async_trait;
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

/// Identity of a store, assigned at its creation and lost with the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct StoreIdentity(pub u128);

impl StoreIdentity {
    /// Creates an identity for a new store. Equal seeds give equal identities: a fresh store needs
    /// a fresh seed.
    pub fn from_seed(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        StoreIdentity(u128::from(rng.next_u64()) << 64 | u128::from(rng.next_u64()))
    }
}

/// Everything in a log store, as read when a node starts.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PersistentState {
    /// Last vote.
    pub vote: Option<Vec<u8>>,
    /// Committed position of the log; may lag.
    pub committed: Option<Vec<u8>>,
    /// Last purged entry.
    pub purged: Option<Vec<u8>>,
    /// Log entries by index, without gaps.
    pub entries: BTreeMap<u64, Vec<u8>>,
    /// Newest snapshot.
    pub snapshot: Option<Vec<u8>>,
}

/// Durable storage of a replica. A single task writes to it. It is read once, at the start.
///
/// When a method returns `Ok`, its data survives a crash; only [`LogStore::save_committed`] may be
/// lazy. An error stops the replica for good: it must not continue when it cannot tell which
/// promises are stored.
#[async_trait]
pub trait LogStore: Send + Sync + 'static {
    /// Returns the identity of this store. The raft id is derived from it.
    fn identity(&self) -> StoreIdentity;

    /// Returns the location of the store, for error messages.
    fn location(&self) -> String {
        "this process's memory".to_owned()
    }

    /// Checks whether this store replaces a damaged store, whose ledger may be the only one of its fleet.
    /// Its node never bootstraps a cluster.
    fn replaces_damaged(&self) -> bool {
        false
    }

    /// Returns advice for the operator when the stored data is damaged, if there is any.
    fn repair_advice(&self) -> Option<&'static str> {
        None
    }

    /// Reads everything stored.
    async fn load(&self) -> io::Result<PersistentState>;

    /// Replaces the vote.
    async fn save_vote(&self, vote: Vec<u8>) -> io::Result<()>;

    /// Replaces the committed position. Losing the last updates only costs time at the next start.
    async fn save_committed(&self, committed: Option<Vec<u8>>) -> io::Result<()>;

    /// Appends entries, which follow the last stored entry without a gap.
    async fn append(&self, entries: Vec<(u64, Vec<u8>)>) -> io::Result<()>;

    /// Removes all entries from `index` to the end.
    async fn truncate(&self, index: u64) -> io::Result<()>;

    /// Removes all entries up to and including `index`, and stores the id of the last of them.
    async fn purge(&self, index: u64, last: Vec<u8>) -> io::Result<()>;

    /// Replaces the snapshot. Other writes may happen meanwhile, except of another snapshot.
    async fn save_snapshot(&self, snapshot: Vec<u8>) -> io::Result<()>;

    /// Replaces the snapshot by a snapshot of the leader. Other writes may wait longer than for
    /// [`LogStore::save_snapshot`]: the log lags in any case.
    async fn install_snapshot(&self, snapshot: Vec<u8>) -> io::Result<()> {
        self.save_snapshot(snapshot).await
    }
}

/// Adds `advice` to an error that reports damaged data.
pub(crate) fn with_repair_advice(error: io::Error, advice: Option<&str>) -> io::Error {
    match advice {
        Some(advice) if error.kind() == io::ErrorKind::InvalidData => {
            io::Error::new(io::ErrorKind::InvalidData, format!("{error}; {advice}"))
        }
        _ => error,
    }
}

/// Log store in memory, lost with its last clone. A clone given to a restarted node simulates a
/// disk that survived.
#[derive(Debug, Clone)]
pub struct MemoryLogStore {
    identity: StoreIdentity,
    replaces_damaged: bool,
    state: Arc<Mutex<PersistentState>>,
}

impl MemoryLogStore {
    /// Creates an empty log store with an identity of its own; see [`StoreIdentity::from_seed`].
    pub fn new(identity_seed: u64) -> Self {
        MemoryLogStore {
            identity: StoreIdentity::from_seed(identity_seed),
            replaces_damaged: false,
            state: Arc::default(),
        }
    }

    /// Same as [`new`](Self::new), after damage to a former log store.
    pub fn replacing_damaged(identity_seed: u64) -> Self {
        MemoryLogStore { replaces_damaged: true, ..MemoryLogStore::new(identity_seed) }
    }

    fn write(&self, change: impl FnOnce(&mut PersistentState)) -> io::Result<()> {
        // No change below can panic half-way, so a poisoned lock still guards a consistent value.
        change(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner));
        Ok(())
    }
}

#[async_trait]
impl LogStore for MemoryLogStore {
    fn identity(&self) -> StoreIdentity {
        self.identity
    }

    fn replaces_damaged(&self) -> bool {
        self.replaces_damaged
    }

    async fn load(&self) -> io::Result<PersistentState> {
        Ok(self.state.lock().unwrap_or_else(PoisonError::into_inner).clone())
    }

    async fn save_vote(&self, vote: Vec<u8>) -> io::Result<()> {
        self.write(|state| state.vote = Some(vote))
    }

    async fn save_committed(&self, committed: Option<Vec<u8>>) -> io::Result<()> {
        self.write(|state| state.committed = committed)
    }

    async fn append(&self, entries: Vec<(u64, Vec<u8>)>) -> io::Result<()> {
        self.write(|state| state.entries.extend(entries))
    }

    async fn truncate(&self, index: u64) -> io::Result<()> {
        self.write(|state| {
            state.entries.split_off(&index);
        })
    }

    async fn purge(&self, index: u64, last: Vec<u8>) -> io::Result<()> {
        self.write(|state| {
            state.entries = state.entries.split_off(&(index + 1));
            state.purged = Some(last);
        })
    }

    async fn save_snapshot(&self, snapshot: Vec<u8>) -> io::Result<()> {
        self.write(|state| state.snapshot = Some(snapshot))
    }
}
