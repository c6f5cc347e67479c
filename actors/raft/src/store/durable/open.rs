//! Opening of a store: its content is accepted as a whole, or not at all.

use super::commit_marker::{CommitMarker, MarkerRecord};
use super::directory::{self, DirectoryLock};
use super::durable_store::DurableStore;
use super::layout::{COMMIT_MARKER_FILE, LEDGER_FILE, StoreOwner};
use super::ledger_file::LedgerFile;
use super::open_error::OpenError;
use crate::log_store::StoreIdentity;
use redb::StorageBackend;
use std::fs;
use std::path::Path;

impl DurableStore {
    /// Opens the store of `owner` in `folder`. If it does not exist, it is created with the
    /// identity `fresh`, which must be drawn anew for each call.
    ///
    /// # Errors
    /// [`OpenError`]; a damaged store is not replaced by an empty store.
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
    /// identity `fresh`. For tests.
    ///
    /// # Errors
    /// [`OpenError`].
    #[cfg(feature = "test-util")]
    pub fn open_on(
        ledger: impl StorageBackend,
        marker: impl StorageBackend,
        owner: &StoreOwner,
        fresh: StoreIdentity,
    ) -> Result<DurableStore, OpenError> {
        let (ledger_path, marker_path) = (Path::new(LEDGER_FILE), Path::new(COMMIT_MARKER_FILE));
        let length = |path, file: &dyn StorageBackend| file.len().map_err(|error| OpenError::io(path, error));
        if length(ledger_path, &ledger)? == 0 && length(marker_path, &marker)? == 0 {
            return DurableStore::create_on(ledger, marker, owner, fresh, None);
        }
        let file = LedgerFile::open(ledger).map_err(|error| OpenError::of(ledger_path, error))?;
        let marker = open_marker(marker_path, marker)?;
        check_marker(&file, &marker, ledger_path)?;
        let store = DurableStore::new(file, marker, ledger_path, None);
        store.check_owner(owner)?;
        Ok(store)
    }

    /// Creates an empty store on another storage backend. If it replaces a damaged store, `replaced` is a
    /// bound of the incarnations of that store. For tests.
    ///
    /// # Errors
    /// [`OpenError`].
    #[cfg(feature = "test-util")]
    pub fn create_on(
        ledger: impl StorageBackend,
        marker: impl StorageBackend,
        owner: &StoreOwner,
        identity: StoreIdentity,
        replaced: Option<u64>,
    ) -> Result<DurableStore, OpenError> {
        let (ledger_path, marker_path) = (Path::new(LEDGER_FILE), Path::new(COMMIT_MARKER_FILE));
        let file = LedgerFile::create(ledger, owner, identity, replaced);
        let file = file.map_err(|error| OpenError::io(ledger_path, error))?;
        let marker = CommitMarker::create(Box::new(marker), MarkerRecord { identity, commits: file.commits() });
        let marker = marker.map_err(|error| OpenError::io(marker_path, error))?;
        Ok(DurableStore::new(file, marker, ledger_path, None))
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
