//! Data directory of a node: its lock, and the creation of its files.

use super::commit_marker::{CommitMarker, MarkerRecord};
use super::layout::{COMMIT_MARKER_FILE, LEDGER_FILE, LOCK_FILE, StoreOwner};
use super::ledger_file::LedgerFile;
use super::open_error::OpenError;
use crate::log_store::StoreIdentity;
use redb::backends::FileBackend;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

/// Lock of the directory for a single process; released when dropped, and by the system when the
/// process ends.
#[derive(Debug)]
pub(super) struct DirectoryLock(#[expect(dead_code, reason = "the lock is held, not read")] File);

impl DirectoryLock {
    pub(super) fn acquire(directory: &Path) -> Result<DirectoryLock, OpenError> {
        let path = directory.join(LOCK_FILE);
        let opened = File::options().create(true).truncate(false).write(true).open(&path);
        let file = opened.map_err(|error| OpenError::io(&path, error))?;
        match file.try_lock() {
            Ok(()) => Ok(DirectoryLock(file)),
            Err(TryLockError::WouldBlock) => Err(OpenError::InUse { folder: directory.to_owned() }),
            Err(TryLockError::Error(error)) => Err(OpenError::io(&path, error)),
        }
    }
}

/// Creates an empty store. If this is interrupted at any moment, the next start creates the store
/// again or finds it complete: the files get their names when they are complete, the commit marker
/// last.
pub(super) fn create(directory: &Path, owner: &StoreOwner, identity: StoreIdentity) -> Result<(), OpenError> {
    let ledger = directory.join(LEDGER_FILE);
    let unfinished = with_suffix(&ledger, "new");
    let created = create_ledger_file(&unfinished, owner, identity, None);
    created.and_then(|()| move_file(&unfinished, &ledger)).map_err(|error| OpenError::io(&ledger, error))?;
    create_commit_marker(directory, MarkerRecord { identity, commits: 1 })
}

/// Creates the ledger file of an empty store. A store that replaces a damaged store gets the last
/// incarnation of that store.
pub(super) fn create_ledger_file(
    path: &Path,
    owner: &StoreOwner,
    identity: StoreIdentity,
    replaced: Option<u64>,
) -> io::Result<()> {
    // Left by an interrupted creation; nothing was acknowledged on it.
    let _ = fs::remove_file(path);
    backend(path, true).and_then(|file| LedgerFile::create(file, owner, identity, replaced)).map(drop)
}

/// Creates the commit marker of a ledger file.
pub(super) fn create_commit_marker(directory: &Path, record: MarkerRecord) -> Result<(), OpenError> {
    let marker = directory.join(COMMIT_MARKER_FILE);
    let unfinished = with_suffix(&marker, "new");
    let _ = fs::remove_file(&unfinished); // see above
    let created = backend(&unfinished, true).and_then(|file| CommitMarker::create(Box::new(file), record)).map(drop);
    created.and_then(|()| move_file(&unfinished, &marker)).map_err(|error| OpenError::io(&marker, error))
}

/// Appends `.` and `suffix` to the file name of `path`.
pub(super) fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut file_name = path.as_os_str().to_owned();
    file_name.push(".");
    file_name.push(suffix);
    PathBuf::from(file_name)
}

/// Copies a file durably to a path that must not exist yet, and returns that path.
pub(super) fn copy(from: &Path, to: &Path) -> io::Result<PathBuf> {
    let mut copy = File::options().write(true).create_new(true).open(to)?;
    io::copy(&mut File::open(from)?, &mut copy)?;
    copy.sync_all()?;
    sync_directory_of(to)?;
    Ok(to.to_owned())
}

/// Opens a file for reading and writing.
pub(super) fn backend(path: &Path, create: bool) -> io::Result<FileBackend> {
    let file = File::options().read(true).write(true).create_new(create).open(path)?;
    FileBackend::new(file).map_err(|error| io::Error::other(error.to_string()))
}

/// Moves a complete file durably, within its file system.
pub(super) fn move_file(from: &Path, to: &Path) -> io::Result<()> {
    fs::rename(from, to)?;
    sync_directory_of(to)?;
    sync_directory_of(from)
}

/// Syncs the directory of a file, so that its name is on disk.
fn sync_directory_of(file: &Path) -> io::Result<()> {
    let directory = file.parent().filter(|directory| !directory.as_os_str().is_empty()).unwrap_or(Path::new("."));
    File::open(directory)?.sync_all()
}
