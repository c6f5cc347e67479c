//! The store: a queue of writes, and the files that they are written to.

use super::commit_marker::CommitMarker;
use super::directory::{self, DirectoryLock};
use super::layout::{COMMIT_MARKER_FILE, StoreOwner};
use super::ledger_file::{LedgerFile, LedgerWrite};
use super::open_error::REPAIR_ADVICE;
use crate::log_store::{LogStore, PersistentState, StoreIdentity};
use crate::store::checkpoint_store::CheckpointStore;
use crate::store::node_store::NodeStore;
use async_trait::async_trait;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::task::spawn_blocking;
use tracing::warn;

/// Delay after the last write before lagging data is written to disk as well. A guess: long
/// compared with a write, short compared with an action of an operator.
const SETTLE_DELAY: Duration = Duration::from_millis(50);

/// Size of the pieces of a snapshot, in bytes. Entries of the log are written between two pieces, so that a commit does not wait
/// for a large snapshot. Raised: a snapshot is written faster, and commits wait longer meanwhile. A guess: a few milliseconds on
/// a memory card. `redb` stores a piece with its key in a page, whose size is a power of two: a piece of 64 KiB would need 128.
const SNAPSHOT_PIECE: usize = 60 * 1024;

/// Number of pieces that are written at once of a snapshot of the leader. The log of this node lags, so few writes wait: votes
/// and checkpoints. Raised: fewer syncs, and these wait longer. A guess: 4 MB, a second on a slow memory card.
const INSTALLED_PIECES: usize = 64;

/// Log store and checkpoint store on disk. Clones share the same store; the directory is unlocked
/// with the last of them.
#[derive(Debug, Clone)]
pub struct DurableStore {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    path: PathBuf,
    owner: StoreOwner,
    identity: StoreIdentity,
    replaces_damaged: bool,
    queue: Mutex<Queue>,
    files: Mutex<Files>,
    /// Number of writes so far. The settling task compares it to detect a pause.
    writes: AtomicU64,
    lagging_task_runs: AtomicBool,
    /// Released last.
    directory_lock: Option<DirectoryLock>,
}

/// Pending writes.
#[derive(Debug, Default)]
struct Queue {
    /// Changes in order.
    changes: Vec<LedgerWrite>,
    /// The callers, which wait for all these changes.
    callers: Vec<oneshot::Sender<io::Result<()>>>,
    /// Committed position that is not written yet: it is written together with the next write.
    committed: Option<Option<Vec<u8>>>,
}

#[derive(Debug)]
struct Files {
    ledger: LedgerFile,
    marker: CommitMarker,
    /// Error after which nothing more may be written.
    failed: Option<String>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl DurableStore {
    pub(super) fn new(
        ledger: LedgerFile,
        marker: CommitMarker,
        path: &Path,
        directory_lock: Option<DirectoryLock>,
    ) -> DurableStore {
        let shared = Shared {
            path: path.to_owned(),
            owner: ledger.owner().clone(),
            identity: ledger.identity(),
            replaces_damaged: ledger.replaces_damaged(),
            queue: Mutex::default(),
            files: Mutex::new(Files { ledger, marker, failed: None }),
            writes: AtomicU64::default(),
            lagging_task_runs: AtomicBool::default(),
            directory_lock,
        };
        DurableStore { shared: Arc::new(shared) }
    }

    /// Owner of the store.
    pub fn owner(&self) -> &StoreOwner {
        &self.shared.owner
    }

    /// Returns the path of the ledger file.
    pub fn path(&self) -> &Path {
        &self.shared.path
    }

    /// Returns a node's storage on this store.
    pub fn into_node_store(self) -> NodeStore {
        let store = Arc::new(self);
        NodeStore { log_store: Arc::clone(&store) as _, checkpoints: store }
    }

    /// Begins a new incarnation of the node and returns its number: `wall_ms`, the wall clock in
    /// milliseconds since 1970, or the last incarnation plus 1 if the clock was set back since.
    /// Blocks until it is on disk.
    ///
    /// # Errors
    /// The store cannot be written.
    pub fn begin_incarnation(&self, wall_ms: u64) -> io::Result<u64> {
        let last = lock(&self.shared.files).ledger.incarnation()?;
        let incarnation = wall_ms.max(last.saturating_add(1));
        self.shared.write(&[LedgerWrite::Incarnation(incarnation)])?;
        Ok(incarnation)
    }

    /// Reads the persistent state of the replica; blocks until it is read.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn persistent_state(&self) -> io::Result<PersistentState> {
        lock(&self.shared.files).ledger.persistent_state()
    }

    /// Replaces log, vote and snapshot by `state`, in a single write; blocks until it is on disk.
    ///
    /// # Errors
    /// The store cannot be written; its content is unchanged.
    pub fn replace(&self, state: PersistentState) -> io::Result<()> {
        self.shared.write(&[LedgerWrite::Replace(Box::new(state))])
    }

    /// Copies the ledger file and the commit marker to files in the same directory, with `suffix`
    /// added to their names; blocks until they are on disk.
    ///
    /// # Errors
    /// A file of that name exists already, or cannot be written.
    pub(crate) fn copy_files(&self, suffix: &str) -> io::Result<Vec<PathBuf>> {
        // Prevents writes meanwhile.
        let _files = lock(&self.shared.files);
        let marker = self.shared.path.with_file_name(COMMIT_MARKER_FILE);
        let copies =
            [&self.shared.path, &marker].map(|file| directory::copy(file, &directory::with_suffix(file, suffix)));
        copies.into_iter().collect()
    }

    async fn submit(&self, change: LedgerWrite) -> io::Result<()> {
        self.submit_all(vec![change]).await
    }

    /// Submits changes that are written in a single transaction.
    async fn submit_all(&self, changes: Vec<LedgerWrite>) -> io::Result<()> {
        let (sender, written) = oneshot::channel();
        {
            let mut queue = lock(&self.shared.queue);
            queue.changes.extend(changes);
            queue.callers.push(sender);
        }
        let shared = Arc::clone(&self.shared);
        // The first thread that gets the files writes all pending changes; the others then find
        // nothing to do.
        self.run(move || shared.write_queued()).await?;
        self.write_lagging_soon();
        written.await.map_err(|_| io::Error::other("the write was abandoned"))?
    }

    /// Replaces the snapshot, and writes this number of pieces at once. The former snapshot remains until the last write, which
    /// contains the rest of the pieces.
    async fn write_snapshot(&self, snapshot: Vec<u8>, at_once: usize) -> io::Result<()> {
        if snapshot.len() <= SNAPSHOT_PIECE {
            return self.submit(LedgerWrite::Snapshot(snapshot)).await;
        }
        let pieces = snapshot.chunks(SNAPSHOT_PIECE);
        let count = pieces.len() as u64;
        let mut changes = vec![];
        for (position, piece) in (0..count).zip(pieces) {
            changes.push(LedgerWrite::SnapshotPiece(position, piece.to_vec()));
            if changes.len() == at_once {
                self.submit_all(std::mem::take(&mut changes)).await?;
            }
        }
        changes.push(LedgerWrite::SnapshotOfPieces(count));
        self.submit_all(changes).await
    }

    /// Runs blocking work. Files are written on a thread for blocking work, and not on a thread of this
    /// store, since virtual time stands still meanwhile. Simulated files do not block; writing them
    /// at once keeps runs reproducible.
    async fn run<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> io::Result<T> {
        if self.shared.directory_lock.is_none() {
            return Ok(work());
        }
        spawn_blocking(work).await.map_err(|error| io::Error::other(format!("the writing thread failed: {error}")))
    }

    /// Starts a task that writes lagging data to disk when there was no write for a while.
    fn write_lagging_soon(&self) {
        if self.shared.lagging_task_runs.swap(true, Ordering::SeqCst) {
            return;
        }
        // The task must not keep the store open.
        let weak = Arc::downgrade(&self.shared);
        tokio::spawn(async move {
            let mut last_seen = None;
            loop {
                let Some(shared) = weak.upgrade() else { return };
                let writes = shared.writes.load(Ordering::SeqCst);
                if last_seen == Some(writes) {
                    shared.lagging_task_runs.store(false, Ordering::SeqCst);
                    let store = DurableStore { shared: Arc::clone(&shared) };
                    let result = store.run(move || shared.write_lagging()).await.flatten();
                    if let Err(error) = result {
                        warn!(%error, "lagging data of the store was not written");
                    }
                    return;
                }
                last_seen = Some(writes);
                drop(shared);
                tokio::time::sleep(SETTLE_DELAY).await;
            }
        });
    }
}

impl Shared {
    /// Writes all pending changes in a single transaction.
    fn write_queued(&self) {
        let mut files = lock(&self.files);
        let Queue { mut changes, callers, committed } = {
            let mut queue = lock(&self.queue);
            if queue.changes.is_empty() {
                return; // another thread has written it
            }
            std::mem::take(&mut *queue)
        };
        changes.extend(committed.map(LedgerWrite::Committed));
        let result = files.write(&changes);
        self.writes.fetch_add(1, Ordering::SeqCst);
        drop(files);
        for caller in callers {
            // It may have gone away.
            let _ = caller.send(self.with_path(&result));
        }
    }

    /// Writes `changes` before the pending changes; for use without concurrent writers.
    fn write(&self, changes: &[LedgerWrite]) -> io::Result<()> {
        let result = lock(&self.files).write(changes);
        self.with_path(&result)
    }

    /// Writes lagging data to disk.
    fn write_lagging(&self) -> io::Result<()> {
        let mut files = lock(&self.files);
        let committed = lock(&self.queue).committed.take();
        if let Some(committed) = committed {
            files.write(&[LedgerWrite::Committed(committed)])?;
        }
        files.marker.sync()
    }

    /// Adds the name of the file to an error.
    fn with_path(&self, result: &io::Result<()>) -> io::Result<()> {
        match result {
            Ok(()) => Ok(()),
            Err(error) => {
                let message = format!("{} cannot be written: {error}", self.path.display());
                Err(io::Error::new(error.kind(), message))
            }
        }
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        // Lagging data may be lost. All other errors were already returned to the callers.
        if let Err(error) = self.write_lagging() {
            warn!(file = %self.path.display(), %error, "store closed, but lagging data was not written");
        }
    }
}

impl Files {
    fn write(&mut self, changes: &[LedgerWrite]) -> io::Result<()> {
        if let Some(earlier) = &self.failed {
            return Err(io::Error::other(format!("an earlier write has failed: {earlier}")));
        }
        // Stays set after a panic in the write.
        self.failed = Some("it was not completed".to_owned());
        let result = self.ledger.write(changes).and_then(|()| self.marker.write(self.ledger.commits()));
        self.failed = result.as_ref().err().map(ToString::to_string);
        result
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

    fn replaces_damaged(&self) -> bool {
        self.shared.replaces_damaged
    }

    fn repair_advice(&self) -> Option<&'static str> {
        Some(REPAIR_ADVICE)
    }

    async fn load(&self) -> io::Result<PersistentState> {
        let store = self.clone();
        self.run(move || store.persistent_state()).await?
    }

    async fn save_vote(&self, vote: Vec<u8>) -> io::Result<()> {
        self.submit(LedgerWrite::Vote(vote)).await
    }

    async fn save_committed(&self, committed: Option<Vec<u8>>) -> io::Result<()> {
        lock(&self.shared.queue).committed = Some(committed);
        self.write_lagging_soon();
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
        self.write_snapshot(snapshot, 1).await
    }

    async fn install_snapshot(&self, snapshot: Vec<u8>) -> io::Result<()> {
        self.write_snapshot(snapshot, INSTALLED_PIECES).await
    }
}

#[async_trait]
impl CheckpointStore for DurableStore {
    async fn read(&self) -> io::Result<Option<Vec<u8>>> {
        let shared = Arc::clone(&self.shared);
        self.run(move || lock(&shared.files).ledger.checkpoint()).await?
    }

    async fn write(&self, checkpoint: Option<Vec<u8>>) -> io::Result<()> {
        self.submit(LedgerWrite::Checkpoint(checkpoint)).await
    }
}
