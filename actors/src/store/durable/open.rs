//! Opening a store: what is there is taken up whole, or not at all.

use super::commit_marker::{CommitMarker, MarkerRecord};
use super::directory::{self, DirectoryLock};
use super::ledger_file::{LedgerFile, LedgerFileError};
use super::{COMMIT_MARKER_FILE, DurableStore, LEDGER_FILE, StoreOwner};
use crate::raft::StoreIdentity;
use redb::StorageBackend;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// What may be done about a store that is not whole.
pub const REPAIR_ADVICE: &str = "as long as a majority of the other voters lives, move the data directory out of the way, and \
    the node joins anew, as an empty member; if no majority is left, run `consort recover --from DATA_DIR` on the data \
    directory of a node whose store is whole; a copy of this one may be put back only if it was made after the node had \
    run for the last time";

/// Why a store cannot be opened. What its files hold is as it was, save that `redb` may have mended what a crash left; space
/// that was no longer used may have been given back.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// Ordinary when a node is started twice, or recovered while it runs.
    #[error("{}: another process uses this data directory; each node needs one of its own", .folder.display())]
    InUse {
        /// The directory.
        folder: PathBuf,
    },
    /// There is none, where there must be one.
    #[error("{}: there is no ledger here; it would be the file {LEDGER_FILE}", .folder.display())]
    NotFound {
        /// The directory.
        folder: PathBuf,
    },
    /// A mistake in the configuration.
    #[error("{}: this is the store of {found}, not of {expected}; each node needs a data directory of its own", .file.display())]
    WrongOwner {
        /// The ledger's file.
        file: PathBuf,
        /// Whose it is.
        found: StoreOwner,
        /// Who asked.
        expected: StoreOwner,
    },
    /// Somebody or something has removed or damaged a file.
    #[error("{}: {what}; {REPAIR_ADVICE}", .file.display())]
    Damaged {
        /// Which file.
        file: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// Written by a later release.
    #[error("{}: its format is {found}, which this release cannot read; use the release that wrote it", .file.display())]
    Format {
        /// The ledger's file.
        file: PathBuf,
        /// Its format.
        found: u64,
    },
    /// The system's doing: permissions, a disk that is full or broken.
    #[error("{}: {problem}", .path.display())]
    Io {
        /// What was to be read or written.
        path: PathBuf,
        /// What the system says.
        problem: io::Error,
    },
}

impl OpenError {
    pub(super) fn io(path: &Path, problem: io::Error) -> OpenError {
        OpenError::Io { path: path.to_owned(), problem }
    }

    fn damaged(file: &Path, what: impl Into<String>) -> OpenError {
        OpenError::Damaged { file: file.to_owned(), what: what.into() }
    }

    fn of(file: &Path, trouble: LedgerFileError) -> OpenError {
        match trouble {
            LedgerFileError::Damaged(what) => OpenError::damaged(file, format!("it is damaged: {what}")),
            LedgerFileError::Format(found) => OpenError::Format { file: file.to_owned(), found },
            LedgerFileError::Io(problem) => OpenError::io(file, problem),
        }
    }
}

impl DurableStore {
    /// Opens the store of `owner` in `folder`. If there has never been one, it is created with the name `fresh`, which must
    /// be drawn anew for each call.
    ///
    /// # Errors
    /// [`OpenError`]; a store that is not whole is never replaced by an empty one.
    pub fn open(folder: &Path, owner: &StoreOwner, fresh: StoreIdentity) -> Result<DurableStore, OpenError> {
        fs::create_dir_all(folder).map_err(|problem| OpenError::io(folder, problem))?;
        let lock = DirectoryLock::acquire(folder)?;
        if !there(&folder.join(LEDGER_FILE))? && !there(&folder.join(COMMIT_MARKER_FILE))? {
            directory::create(folder, owner, fresh)?;
        }
        let store = DurableStore::open_locked(folder, lock)?;
        store.check_owner(owner)?;
        Ok(store)
    }

    /// Opens the store in `folder`, whoever's it is.
    ///
    /// # Errors
    /// [`OpenError`]; nothing is created.
    pub fn open_existing(folder: &Path) -> Result<DurableStore, OpenError> {
        if !there(&folder.join(LEDGER_FILE))? && !there(&folder.join(COMMIT_MARKER_FILE))? {
            return Err(OpenError::NotFound { folder: folder.to_owned() });
        }
        DurableStore::open_locked(folder, DirectoryLock::acquire(folder)?)
    }

    /// Opens the store of `owner` on a disk of another kind, as tests simulate them: one file for the ledger, one for its
    /// seal. Empty files become a new store with the name `fresh`.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn open_on(
        ledger: impl StorageBackend,
        seal: impl StorageBackend,
        owner: &StoreOwner,
        fresh: StoreIdentity,
    ) -> Result<DurableStore, OpenError> {
        let (ledger_path, seal_path) = (Path::new(LEDGER_FILE), Path::new(COMMIT_MARKER_FILE));
        let length = |path, file: &dyn StorageBackend| file.len().map_err(|problem| OpenError::io(path, problem));
        let is_new = length(ledger_path, &ledger)? == 0 && length(seal_path, &seal)? == 0;
        let (file, seal) = if is_new {
            let file = LedgerFile::create(ledger, owner, fresh);
            let file = file.map_err(|problem| OpenError::io(ledger_path, problem))?;
            let seal = CommitMarker::create(Box::new(seal), MarkerRecord { identity: fresh, commits: file.commits() });
            (file, seal.map_err(|problem| OpenError::io(seal_path, problem))?)
        } else {
            let file = LedgerFile::open(ledger).map_err(|trouble| OpenError::of(ledger_path, trouble))?;
            (file, open_seal(seal_path, seal)?)
        };
        check_seal(&file, &seal, ledger_path)?;
        let store = DurableStore::new(file, seal, ledger_path, None);
        store.check_owner(owner)?;
        Ok(store)
    }

    fn open_locked(folder: &Path, lock: DirectoryLock) -> Result<DurableStore, OpenError> {
        let (ledger_path, seal_path) = (folder.join(LEDGER_FILE), folder.join(COMMIT_MARKER_FILE));
        if !there(&ledger_path)? {
            let what = format!("it is gone, though {COMMIT_MARKER_FILE} beside it says that there was one");
            return Err(OpenError::damaged(&ledger_path, what));
        }
        let file = directory::backend(&ledger_path, false).map_err(|problem| OpenError::io(&ledger_path, problem))?;
        let file = LedgerFile::open(file).map_err(|trouble| OpenError::of(&ledger_path, trouble))?;
        if !there(&seal_path)? {
            // The creation was interrupted, or somebody has removed it.
            if file.commits() > 1 {
                return Err(OpenError::damaged(
                    &seal_path,
                    "it is gone, though the ledger beside it has been written to",
                ));
            }
            directory::create_commit_marker(folder, MarkerRecord { identity: file.identity(), commits: 1 })?;
        }
        let seal = directory::backend(&seal_path, false).map_err(|problem| OpenError::io(&seal_path, problem))?;
        let seal = open_seal(&seal_path, seal)?;
        check_seal(&file, &seal, &ledger_path)?;
        Ok(DurableStore::new(file, seal, &ledger_path, Some(lock)))
    }

    fn check_owner(&self, asked: &StoreOwner) -> Result<(), OpenError> {
        let found = self.owner();
        if found == asked {
            return Ok(());
        }
        let file = self.path().to_owned();
        Err(OpenError::WrongOwner { file, found: found.clone(), expected: asked.clone() })
    }
}

fn there(path: &Path) -> Result<bool, OpenError> {
    path.try_exists().map_err(|problem| OpenError::io(path, problem))
}

fn open_seal(path: &Path, file: impl StorageBackend) -> Result<CommitMarker, OpenError> {
    let seal = CommitMarker::open(Box::new(file)).map_err(|problem| OpenError::io(path, problem))?;
    seal.ok_or_else(|| OpenError::damaged(path, "it is damaged: neither of its two lines is whole"))
}

fn check_seal(file: &LedgerFile, seal: &CommitMarker, path: &Path) -> Result<(), OpenError> {
    let claim = seal.record();
    if claim.identity != file.identity() {
        let what = format!("it is of another store than {COMMIT_MARKER_FILE} beside it");
        return Err(OpenError::damaged(path, what));
    }
    if file.commits() < claim.commits {
        let (found, claimed) = (file.commits(), claim.commits);
        let what = format!(
            "it ends with write {found}, though {COMMIT_MARKER_FILE} beside it says that write {claimed} was acknowledged: it is \
             damaged, or is an older copy"
        );
        return Err(OpenError::damaged(path, what));
    }
    Ok(())
}
