//! A node's data directory: its lock, and how the files in it come into being.

use super::commit_marker::{CommitMarker, MarkerRecord};
use super::ledger_file::LedgerFile;
use super::open::OpenError;
use super::{COMMIT_MARKER_FILE, LEDGER_FILE, LOCK_FILE, StoreOwner};
use crate::raft::StoreIdentity;
use redb::backends::FileBackend;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

/// Keeps the directory for one process; given back when dropped, and by the system when the process ends.
#[derive(Debug)]
pub(super) struct DirectoryLock(#[expect(dead_code, reason = "it is held, not read")] File);

impl DirectoryLock {
    pub(super) fn acquire(folder: &Path) -> Result<DirectoryLock, OpenError> {
        let path = folder.join(LOCK_FILE);
        let opened = File::options().create(true).truncate(false).write(true).open(&path);
        let file = opened.map_err(|problem| OpenError::io(&path, problem))?;
        match file.try_lock() {
            Ok(()) => Ok(DirectoryLock(file)),
            Err(TryLockError::WouldBlock) => Err(OpenError::InUse { folder: folder.to_owned() }),
            Err(TryLockError::Error(problem)) => Err(OpenError::io(&path, problem)),
        }
    }
}

/// Makes an empty store. Whatever moment this is interrupted at, the next start makes it anew or finds it whole: the files
/// get their names when they are complete, the seal last.
pub(super) fn create(folder: &Path, owner: &StoreOwner, identity: StoreIdentity) -> Result<(), OpenError> {
    let ledger = folder.join(LEDGER_FILE);
    let unfinished = with_suffix(&ledger, "new");
    // Left by an interrupted creation; nothing was acknowledged on it.
    let _ = fs::remove_file(&unfinished);
    let created = backend(&unfinished, true).and_then(|file| LedgerFile::create(file, owner, identity)).map(drop);
    created.and_then(|()| name(&unfinished, &ledger)).map_err(|problem| OpenError::io(&ledger, problem))?;
    create_commit_marker(folder, MarkerRecord { identity, commits: 1 })
}

/// Makes the seal of a ledger's file.
pub(super) fn create_commit_marker(folder: &Path, claim: MarkerRecord) -> Result<(), OpenError> {
    let seal = folder.join(COMMIT_MARKER_FILE);
    let unfinished = with_suffix(&seal, "new");
    let _ = fs::remove_file(&unfinished); // see above
    let created = backend(&unfinished, true).and_then(|file| CommitMarker::create(Box::new(file), claim)).map(drop);
    created.and_then(|()| name(&unfinished, &seal)).map_err(|problem| OpenError::io(&seal, problem))
}

/// The same path with another ending.
pub(super) fn with_suffix(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(ending);
    PathBuf::from(name)
}

/// Copies a file to one that must not be there yet, for good, and says which that is.
pub(super) fn copy(from: &Path, to: &Path) -> io::Result<PathBuf> {
    let mut copy = File::options().write(true).create_new(true).open(to)?;
    io::copy(&mut File::open(from)?, &mut copy)?;
    copy.sync_all()?;
    sync_folder_of(to)?;
    Ok(to.to_owned())
}

/// Opens a file for reading and writing.
pub(super) fn backend(path: &Path, create: bool) -> io::Result<FileBackend> {
    let file = File::options().read(true).write(true).create_new(create).open(path)?;
    FileBackend::new(file).map_err(|problem| io::Error::other(problem.to_string()))
}

/// Gives a complete file its name, for good.
fn name(from: &Path, to: &Path) -> io::Result<()> {
    fs::rename(from, to)?;
    sync_folder_of(to)
}

/// Brings the name of a file to disk.
fn sync_folder_of(file: &Path) -> io::Result<()> {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    File::open(folder)?.sync_all()
}
