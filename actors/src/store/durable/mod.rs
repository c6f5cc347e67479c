//! A store on disk: what a node has promised outlives its process, and its machine's power.
//!
//! ```text
//!   DATA_DIR/ledger.redb   log, vote, snapshot, and the page of the robot's notebook
//!            ledger.seal   whose ledger it is, and up to which write it is known to be on disk (see `seal`)
//!            lock          held by the one process that may write
//! ```
//!
//! What is promised:
//! - When a write returns `Ok`, it is on disk; only the committed position may lag. Writes are carried out in the order
//!   in which they were asked for, and those that wait together share one sync of the disk.
//! - After a failed write nothing more is written: nobody knows what is on disk then. The replica stops for good.
//! - What is read back is what was written, or an error that names the file and says what may be done: pages are
//!   compared with their checksums when the store is opened, and the last write with the seal. One case is left: damage
//!   to the very last write before the *power* failed, within [`SETTLE`] of it, looks like a write that was never
//!   finished.
//! - A directory that once held a ledger is never taken for a new one.

mod commit_marker;
mod directory;
mod ledger_file;
mod open;

use super::{CheckpointStore, NodeStore};
use crate::raft::{LogStore, PersistentState, StoreIdentity};
use async_trait::async_trait;
use commit_marker::CommitMarker;
use consort_protocol::ids::{FleetId, NodeId};
use directory::DirectoryLock;
use ledger_file::{LedgerFile, LedgerWrite};
pub use open::{OpenError, REPAIR_ADVICE};
pub use redb::StorageBackend;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::task::{JoinError, spawn_blocking};
use tracing::warn;

/// The ledger's file in a data directory.
pub const LEDGER_FILE: &str = "ledger.redb";

/// The seal beside it.
pub const COMMIT_MARKER_FILE: &str = "ledger.seal";

/// The lock beside it.
pub const LOCK_FILE: &str = "lock";

/// So long after the last write what may lag is brought to disk as well. A guess: long beside a write, short beside an
/// operator's hand.
const SETTLE: Duration = Duration::from_millis(50);

/// Whose store it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoreOwner {
    /// The fleet.
    pub fleet: FleetId,
    /// Its node.
    pub node: NodeId,
}

impl fmt::Display for StoreOwner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "node {} of fleet {}", self.node, self.fleet)
    }
}

/// A journal and a notebook on disk. Clones are the same store; the directory is given back with the last of them.
#[derive(Debug, Clone)]
pub struct DurableStore {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    path: PathBuf,
    owner: StoreOwner,
    identity: StoreIdentity,
    queue: Mutex<Queue>,
    files: Mutex<Files>,
    /// Writes so far, by which a settling task sees that it is not yet quiet.
    writes: AtomicU64,
    settling: AtomicBool,
    /// Given back last.
    _lock: Option<DirectoryLock>,
}

/// What is to be written, in order.
#[derive(Debug, Default)]
struct Queue {
    changes: Vec<(LedgerWrite, oneshot::Sender<io::Result<()>>)>,
    /// The committed position, if it is not written yet: it goes with the next write.
    committed: Option<Option<Vec<u8>>>,
}

#[derive(Debug)]
struct Files {
    ledger: LedgerFile,
    seal: CommitMarker,
    /// Why nothing more may be written, if so.
    failed: Option<String>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl DurableStore {
    fn new(ledger: LedgerFile, seal: CommitMarker, path: &Path, folder_lock: Option<DirectoryLock>) -> DurableStore {
        let shared = Shared {
            path: path.to_owned(),
            owner: ledger.owner().clone(),
            identity: ledger.identity(),
            queue: Mutex::default(),
            files: Mutex::new(Files { ledger, seal, failed: None }),
            writes: AtomicU64::default(),
            settling: AtomicBool::default(),
            _lock: folder_lock,
        };
        DurableStore { shared: Arc::new(shared) }
    }

    /// Whose store it is.
    pub fn owner(&self) -> &StoreOwner {
        &self.shared.owner
    }

    /// The ledger's file.
    pub fn path(&self) -> &Path {
        &self.shared.path
    }

    /// A node's memory on this store.
    pub fn into_node_store(self) -> NodeStore {
        let store = Arc::new(self);
        NodeStore { log_store: Arc::clone(&store) as _, checkpoints: store }
    }

    /// Begins a life of the node, and gives its incarnation: `wall_ms`, the wall clock's milliseconds since 1970, or one
    /// more than in the last life if the clock has been put back since. Blocks until it is on disk.
    ///
    /// # Errors
    /// The store cannot be written.
    pub fn begin_incarnation(&self, wall_ms: u64) -> io::Result<u64> {
        let last = lock(&self.shared.files).ledger.incarnation()?;
        let incarnation = wall_ms.max(last.saturating_add(1));
        self.shared.write(&[LedgerWrite::Incarnation(incarnation)])?;
        Ok(incarnation)
    }

    /// All that the journal recorded; blocks until it is read.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn persistent_state(&self) -> io::Result<PersistentState> {
        lock(&self.shared.files).ledger.persistent_state()
    }

    /// Puts `recorded` in the place of log, vote and snapshot, all at once; blocks until it is on disk.
    ///
    /// # Errors
    /// The store cannot be written; what was there is still there.
    pub fn replace(&self, recorded: PersistentState) -> io::Result<()> {
        self.shared.write(&[LedgerWrite::Replace(Box::new(recorded))])
    }

    /// Copies the ledger's file and its seal to files beside them, which have `ending` added to their names; blocks until
    /// they are on disk.
    ///
    /// # Errors
    /// A file of that name is there already, or cannot be written.
    pub fn copy_files(&self, ending: &str) -> io::Result<Vec<PathBuf>> {
        // Nobody writes meanwhile.
        let _files = lock(&self.shared.files);
        let seal = self.shared.path.with_file_name(COMMIT_MARKER_FILE);
        let copies =
            [&self.shared.path, &seal].map(|file| directory::copy(file, &directory::with_suffix(file, ending)));
        copies.into_iter().collect()
    }

    async fn submit(&self, change: LedgerWrite) -> io::Result<()> {
        let (done, heard) = oneshot::channel();
        lock(&self.shared.queue).changes.push((change, done));
        let shared = Arc::clone(&self.shared);
        // The first to find the files free writes all that waits; the others then find nothing to do. On a thread for
        // what blocks, and not on one of our own, since virtual time stands still meanwhile.
        spawn_blocking(move || shared.write_queued()).await.map_err(died)?;
        self.settle_soon();
        heard.await.map_err(|_| io::Error::other("the write was given up"))?
    }

    /// Brings to disk what may lag, when nothing has been written for a while.
    fn settle_soon(&self) {
        if self.shared.settling.swap(true, Ordering::SeqCst) {
            return;
        }
        // The task must not keep the store open.
        let weak = Arc::downgrade(&self.shared);
        tokio::spawn(async move {
            let mut seen = None;
            loop {
                let Some(shared) = weak.upgrade() else { return };
                let writes = shared.writes.load(Ordering::SeqCst);
                if seen == Some(writes) {
                    shared.settling.store(false, Ordering::SeqCst);
                    let settled = spawn_blocking(move || shared.settle()).await.map_err(died).flatten();
                    if let Err(problem) = settled {
                        warn!(%problem, "the store did not settle");
                    }
                    return;
                }
                seen = Some(writes);
                drop(shared);
                tokio::time::sleep(SETTLE).await;
            }
        });
    }
}

fn died(problem: JoinError) -> io::Error {
    io::Error::other(format!("writing ended with its thread: {problem}"))
}

impl Shared {
    /// Writes all that waits, in one go.
    fn write_queued(&self) {
        let mut files = lock(&self.files);
        let Queue { changes, committed } = {
            let mut queue = lock(&self.queue);
            if queue.changes.is_empty() {
                return; // whoever came before has written it
            }
            std::mem::take(&mut *queue)
        };
        let (mut changes, done): (Vec<_>, Vec<_>) = changes.into_iter().unzip();
        changes.extend(committed.map(LedgerWrite::Committed));
        let outcome = files.write(&changes);
        self.writes.fetch_add(1, Ordering::SeqCst);
        drop(files);
        for done in done {
            // Whoever asked may have gone.
            let _ = done.send(self.told(&outcome));
        }
    }

    /// Writes this before anything that waits; for when nobody else writes.
    fn write(&self, changes: &[LedgerWrite]) -> io::Result<()> {
        let outcome = lock(&self.files).write(changes);
        self.told(&outcome)
    }

    /// Brings to disk what may lag.
    fn settle(&self) -> io::Result<()> {
        let mut files = lock(&self.files);
        let committed = lock(&self.queue).committed.take();
        if let Some(committed) = committed {
            files.write(&[LedgerWrite::Committed(committed)])?;
        }
        files.seal.sync()
    }

    /// The outcome, with the file's name.
    fn told(&self, outcome: &io::Result<()>) -> io::Result<()> {
        match outcome {
            Ok(()) => Ok(()),
            Err(problem) => {
                let what = format!("{} cannot be written: {problem}", self.path.display());
                Err(io::Error::new(problem.kind(), what))
            }
        }
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        // What lags may be lost, and whatever else failed has been told to those who asked for it.
        if let Err(problem) = self.settle() {
            warn!(file = %self.path.display(), %problem, "the store was closed without having settled");
        }
    }
}

impl Files {
    fn write(&mut self, changes: &[LedgerWrite]) -> io::Result<()> {
        if let Some(former) = &self.failed {
            return Err(io::Error::other(format!("an earlier write has failed: {former}")));
        }
        // For a panic on the way.
        self.failed = Some("it did not come to an end".to_owned());
        let outcome = self.ledger.write(changes).and_then(|()| self.seal.write(self.ledger.commits()));
        self.failed = outcome.as_ref().err().map(ToString::to_string);
        outcome
    }
}

#[async_trait]
impl LogStore for DurableStore {
    fn identity(&self) -> StoreIdentity {
        self.shared.identity
    }

    fn location(&self) -> String {
        self.shared.path.display().to_string()
    }

    fn repair_advice(&self) -> Option<&'static str> {
        Some(REPAIR_ADVICE)
    }

    async fn load(&self) -> io::Result<PersistentState> {
        let store = self.clone();
        spawn_blocking(move || store.persistent_state()).await.map_err(died)?
    }

    async fn save_vote(&self, vote: Vec<u8>) -> io::Result<()> {
        self.submit(LedgerWrite::Vote(vote)).await
    }

    async fn save_committed(&self, committed: Option<Vec<u8>>) -> io::Result<()> {
        lock(&self.shared.queue).committed = Some(committed);
        self.settle_soon();
        Ok(())
    }

    async fn append(&self, entries: Vec<(u64, Vec<u8>)>) -> io::Result<()> {
        self.submit(LedgerWrite::Append(entries)).await
    }

    async fn truncate(&self, index: u64) -> io::Result<()> {
        self.submit(LedgerWrite::Truncate(index)).await
    }

    async fn purge(&self, index: u64, last: Vec<u8>) -> io::Result<()> {
        self.submit(LedgerWrite::Purge(index, last)).await
    }

    async fn save_snapshot(&self, snapshot: Vec<u8>) -> io::Result<()> {
        self.submit(LedgerWrite::Snapshot(snapshot)).await
    }
}

#[async_trait]
impl CheckpointStore for DurableStore {
    async fn read(&self) -> io::Result<Option<Vec<u8>>> {
        let shared = Arc::clone(&self.shared);
        spawn_blocking(move || lock(&shared.files).ledger.checkpoint()).await.map_err(died)?
    }

    async fn write(&self, page: Option<Vec<u8>>) -> io::Result<()> {
        self.submit(LedgerWrite::Checkpoint(page)).await
    }
}
