//! Quarantine of a damaged store: its files are moved away, and an empty store takes their place. The
//! node then joins its fleet as a new member, and the leader sends it the ledger.
//!
//! The new store has another identity, and therefore another Raft id: the votes and acknowledgements of
//! the damaged store do not count for it. It never bootstraps a cluster, because the damaged ledger may
//! be the only one of its fleet. After an interruption between any two steps the directory contains
//! either a damaged store or a new store that replaces one.

use super::commit_marker::MarkerRecord;
use super::directory::{self, create_commit_marker, create_ledger_file, move_file, with_suffix};
use super::durable_store::DurableStore;
use super::layout::{COMMIT_MARKER_FILE, LEDGER_FILE, StoreOwner};
use super::ledger_file::LedgerFile;
use super::open_error::OpenError;
use crate::log_store::StoreIdentity;
use std::fs;
use std::path::{Path, PathBuf};

/// A damaged store that an empty store has replaced.
#[derive(Debug)]
pub struct Quarantine {
    /// Damaged file, as it was named then.
    pub file: PathBuf,
    /// Kind of damage.
    pub damage: String,
    /// Directory of the files now.
    pub moved_to: PathBuf,
}

impl DurableStore {
    /// Opens the store of `owner` in `folder` like [`DurableStore::open`]. If it is damaged, its files are
    /// moved to a directory `damaged-N` in `folder`, and an empty store that never bootstraps a
    /// cluster replaces it.
    ///
    /// # Errors
    /// [`OpenError`], other than damage.
    pub fn open_or_replace(
        folder: &Path,
        owner: &StoreOwner,
        fresh: StoreIdentity,
    ) -> Result<(DurableStore, Option<Quarantine>), OpenError> {
        match DurableStore::open(folder, owner, fresh) {
            Err(OpenError::Damaged { file, damage }) => {
                let moved_to = quarantine(folder, owner, fresh)?;
                let store = DurableStore::open(folder, owner, fresh)?;
                Ok((store, Some(Quarantine { file, damage, moved_to })))
            }
            opened => opened.map(|store| (store, None)),
        }
    }
}

fn quarantine(folder: &Path, owner: &StoreOwner, identity: StoreIdentity) -> Result<PathBuf, OpenError> {
    let _lock = directory::DirectoryLock::acquire(folder)?;
    let (ledger, marker) = (folder.join(LEDGER_FILE), folder.join(COMMIT_MARKER_FILE));
    let moved_to = new_directory(folder)?;
    // The checksums of a damaged file do not protect this number, and it may be unreadable: the wall clock
    // is then the only bound of the next incarnation.
    let last_incarnation = directory::backend(&ledger, false).map_or(0, LedgerFile::salvage_incarnation);
    let unfinished = with_suffix(&ledger, "new");
    create_ledger_file(&unfinished, owner, identity, Some(last_incarnation))
        .map_err(|error| OpenError::io(&unfinished, error))?;
    for (from, to) in [
        (&ledger, moved_to.join(LEDGER_FILE)),
        (&unfinished, ledger.clone()),
        (&marker, moved_to.join(COMMIT_MARKER_FILE)),
    ] {
        // The damage may be a missing file.
        if from.try_exists().map_err(|error| OpenError::io(from, error))? {
            move_file(from, &to).map_err(|error| OpenError::io(from, error))?;
        }
    }
    create_commit_marker(folder, MarkerRecord { identity, commits: 1 })?;
    Ok(moved_to)
}

/// Creates the directory for the files of a damaged store.
fn new_directory(folder: &Path) -> Result<PathBuf, OpenError> {
    let mut number = 1_u32;
    loop {
        let path = folder.join(format!("damaged-{number}"));
        match fs::create_dir(&path) {
            Ok(()) => return Ok(path),
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => number += 1,
            Err(error) => return Err(OpenError::io(&path, error)),
        }
    }
}
