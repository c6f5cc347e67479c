//! Opening of a store: its content is accepted as a whole, or not at all.

use super::commit_marker::{CommitMarker, MarkerRecord};
use super::directory::{self, DirectoryLock};
use super::ledger_file::{LedgerFile, LedgerFileError};
use super::{COMMIT_MARKER_FILE, DurableStore, LEDGER_FILE, StoreOwner};
use crate::StoreIdentity;
use redb::StorageBackend;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Advice for the operator of a damaged store.
pub const REPAIR_ADVICE: &str = "while a majority of the other voters is alive, move the data directory away, and the \
    node joins again as an empty member; if no majority is left, run `consort recover --from DATA_DIR` on the data \
    directory of a node with an undamaged store; restore a copy of this data directory only if it was made after the \
    last run of the node";

/// The store cannot be opened. The content of its files is unchanged, except that `redb` may have
/// repaired the effects of a crash and may have released unused space.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// Expected when a node is started twice, or recovered while it runs.
    #[error("{}: another process uses this data directory; each node needs one of its own", .folder.display())]
    InUse {
        /// Data directory.
        folder: PathBuf,
    },
    /// There is no store, and none may be created.
    #[error("{}: there is no ledger in this directory (file {LEDGER_FILE})", .folder.display())]
    NotFound {
        /// Data directory.
        folder: PathBuf,
    },
    /// The store belongs to another node. A mistake in the configuration.
    #[error("{}: this is the store of {found}, not of {expected}; each node needs a data directory of its own", .file.display())]
    WrongOwner {
        /// The ledger's file.
        file: PathBuf,
        /// Owner of the store.
        found: StoreOwner,
        /// Node that tried to open it.
        expected: StoreOwner,
    },
    /// A file was removed or damaged.
    #[error("{}: {damage}; {REPAIR_ADVICE}", .file.display())]
    Damaged {
        /// Affected file.
        file: PathBuf,
        /// Kind of damage.
        damage: String,
    },
    /// The store was written by a later release.
    #[error("{}: its format is {found}, which this release cannot read; use the release that wrote it", .file.display())]
    Format {
        /// The ledger's file.
        file: PathBuf,
        /// Format of the file.
        found: u64,
    },
    /// Error of the operating system: permissions, a disk that is full or broken.
    #[error("{}: {error}", .path.display())]
    Io {
        /// File or directory that was to be read or written.
        path: PathBuf,
        /// Error of the operating system.
        error: io::Error,
    },
}

impl OpenError {
    pub(super) fn io(path: &Path, error: io::Error) -> OpenError {
        OpenError::Io { path: path.to_owned(), error }
    }

    fn damaged(file: &Path, damage: impl Into<String>) -> OpenError {
        OpenError::Damaged { file: file.to_owned(), damage: damage.into() }
    }

    fn of(file: &Path, error: LedgerFileError) -> OpenError {
        match error {
            LedgerFileError::Damaged(damage) => OpenError::damaged(file, format!("it is damaged: {damage}")),
            LedgerFileError::Format(found) => OpenError::Format { file: file.to_owned(), found },
            LedgerFileError::Io(error) => OpenError::io(file, error),
        }
    }
}

impl DurableStore {
    /// Opens the store of `owner` in `folder`. If it does not exist, it is created with the
    /// identity `fresh`, which must be drawn anew for each call.
    ///
    /// # Errors
    /// [`OpenError`]; a damaged store is never replaced by an empty store.
    pub fn open(folder: &Path, owner: &StoreOwner, fresh: StoreIdentity) -> Result<DurableStore, OpenError> {
        fs::create_dir_all(folder).map_err(|error| OpenError::io(folder, error))?;
        let lock = DirectoryLock::acquire(folder)?;
        if !file_exists(&folder.join(LEDGER_FILE))? && !file_exists(&folder.join(COMMIT_MARKER_FILE))? {
            directory::create(folder, owner, fresh)?;
        }
        let store = DurableStore::open_locked(folder, lock)?;
        store.check_owner(owner)?;
        Ok(store)
    }

    /// Opens the existing store in `folder`, for any owner.
    ///
    /// # Errors
    /// [`OpenError`]; nothing is created.
    pub fn open_existing(folder: &Path) -> Result<DurableStore, OpenError> {
        if !file_exists(&folder.join(LEDGER_FILE))? && !file_exists(&folder.join(COMMIT_MARKER_FILE))? {
            return Err(OpenError::NotFound { folder: folder.to_owned() });
        }
        DurableStore::open_locked(folder, DirectoryLock::acquire(folder)?)
    }

    /// Opens the store of `owner` on another storage backend, such as a simulated disk: a file for
    /// the ledger, and a file for its commit marker. Empty files become a new store with the
    /// identity `fresh`.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn open_on(
        ledger: impl StorageBackend,
        marker: impl StorageBackend,
        owner: &StoreOwner,
        fresh: StoreIdentity,
    ) -> Result<DurableStore, OpenError> {
        let (ledger_path, marker_path) = (Path::new(LEDGER_FILE), Path::new(COMMIT_MARKER_FILE));
        let length = |path, file: &dyn StorageBackend| file.len().map_err(|error| OpenError::io(path, error));
        let is_new = length(ledger_path, &ledger)? == 0 && length(marker_path, &marker)? == 0;
        let (file, marker) = if is_new {
            let file = LedgerFile::create(ledger, owner, fresh);
            let file = file.map_err(|error| OpenError::io(ledger_path, error))?;
            let marker =
                CommitMarker::create(Box::new(marker), MarkerRecord { identity: fresh, commits: file.commits() });
            (file, marker.map_err(|error| OpenError::io(marker_path, error))?)
        } else {
            let file = LedgerFile::open(ledger).map_err(|error| OpenError::of(ledger_path, error))?;
            (file, open_marker(marker_path, marker)?)
        };
        check_marker(&file, &marker, ledger_path)?;
        let store = DurableStore::new(file, marker, ledger_path, None);
        store.check_owner(owner)?;
        Ok(store)
    }

    fn open_locked(folder: &Path, lock: DirectoryLock) -> Result<DurableStore, OpenError> {
        let (ledger_path, marker_path) = (folder.join(LEDGER_FILE), folder.join(COMMIT_MARKER_FILE));
        if !file_exists(&ledger_path)? {
            let damage = format!("the file is missing, but {COMMIT_MARKER_FILE} shows that it existed");
            return Err(OpenError::damaged(&ledger_path, damage));
        }
        let file = directory::backend(&ledger_path, false).map_err(|error| OpenError::io(&ledger_path, error))?;
        let file = LedgerFile::open(file).map_err(|error| OpenError::of(&ledger_path, error))?;
        if !file_exists(&marker_path)? {
            // Either the creation was interrupted, or the file was removed.
            if file.commits() > 1 {
                return Err(OpenError::damaged(
                    &marker_path,
                    "the file is missing, but the ledger has been written to",
                ));
            }
            directory::create_commit_marker(folder, MarkerRecord { identity: file.identity(), commits: 1 })?;
        }
        let marker = directory::backend(&marker_path, false).map_err(|error| OpenError::io(&marker_path, error))?;
        let marker = open_marker(&marker_path, marker)?;
        check_marker(&file, &marker, &ledger_path)?;
        Ok(DurableStore::new(file, marker, &ledger_path, Some(lock)))
    }

    fn check_owner(&self, expected: &StoreOwner) -> Result<(), OpenError> {
        let found = self.owner();
        if found == expected {
            return Ok(());
        }
        let file = self.path().to_owned();
        Err(OpenError::WrongOwner { file, found: found.clone(), expected: expected.clone() })
    }
}

fn file_exists(path: &Path) -> Result<bool, OpenError> {
    path.try_exists().map_err(|error| OpenError::io(path, error))
}

fn open_marker(path: &Path, file: impl StorageBackend) -> Result<CommitMarker, OpenError> {
    let marker = CommitMarker::open(Box::new(file)).map_err(|error| OpenError::io(path, error))?;
    marker.ok_or_else(|| OpenError::damaged(path, "it is damaged: neither of its two slots is complete"))
}

fn check_marker(file: &LedgerFile, marker: &CommitMarker, path: &Path) -> Result<(), OpenError> {
    let record = marker.record();
    if record.identity != file.identity() {
        let damage = format!("it belongs to another store than {COMMIT_MARKER_FILE}");
        return Err(OpenError::damaged(path, damage));
    }
    if file.commits() < record.commits {
        let (found, acknowledged) = (file.commits(), record.commits);
        let damage = format!(
            "it ends with write {found}, but {COMMIT_MARKER_FILE} records that write {acknowledged} was acknowledged: it is \
             damaged, or an older copy"
        );
        return Err(OpenError::damaged(path, damage));
    }
    Ok(())
}
