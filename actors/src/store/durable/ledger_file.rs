//! The ledger's file: what a store holds as tables of `redb`.
//!
//! Each call of [`LedgerFile::write`] is one transaction, numbered from 1 (the store's creation). When it returns, the
//! whole of it is on disk; after a crash it is there as a whole or not at all. `redb` keeps a checksum of every page in
//! the page above it; opening compares them all.

use super::StoreOwner;
use crate::raft::{PersistentState, StoreIdentity};
use consort_protocol::ids::{FleetId, NodeId};
use redb::{Database, ReadableDatabase, ReadableTable, StorageBackend, Table, TableDefinition};
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// The form of the tables. A change that an older program cannot read raises it.
const FORMAT: u64 = 1;

/// What there is one of.
const ONES: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("ones");

/// The log's entries by index.
const LOG: TableDefinition<'_, u64, &[u8]> = TableDefinition::new("log");

const IS_FORMAT: &str = "format";
const IS_FLEET: &str = "fleet";
const IS_NODE: &str = "node";
const IS_IDENTITY: &str = "identity";
const IS_COMMITS: &str = "commits";
const IS_INCARNATION: &str = "incarnation";
const IS_VOTE: &str = "vote";
const IS_COMMITTED: &str = "committed";
const IS_PURGED: &str = "purged";
const IS_SNAPSHOT: &str = "snapshot";
const IS_PAGE: &str = "page";

/// Memory for pages that were read or written lately. The log is kept in memory by the replica, so little is read.
const CACHE_BYTES: usize = 8 << 20;

/// A file below this size is not worth compacting.
const COMPACT_BYTES_MIN: u64 = 1 << 20;

/// A file is compacted when it is so many times larger than what is stored in it. A guess.
const COMPACT_RATIO: u64 = 4;

/// Something to be written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum LedgerWrite {
    Vote(Vec<u8>),
    Committed(Option<Vec<u8>>),
    Append(Vec<(u64, Vec<u8>)>),
    /// Removes all entries from this index on.
    Truncate(u64),
    /// Removes all entries up to this index, and remembers the last of them.
    Purge(u64, Vec<u8>),
    Snapshot(Vec<u8>),
    Checkpoint(Option<Vec<u8>>),
    Incarnation(u64),
    /// Puts all this in the place of the log, vote and snapshot.
    Replace(Box<PersistentState>),
}

/// The open file.
#[derive(Debug)]
pub(super) struct LedgerFile {
    database: Database,
    owner: StoreOwner,
    identity: StoreIdentity,
    commits: u64,
}

/// Why the file cannot be opened.
pub(super) enum LedgerFileError {
    /// It does not hold what it once held.
    Damaged(String),
    /// It is of another release.
    Format(u64),
    Io(io::Error),
}

impl From<io::Error> for LedgerFileError {
    fn from(problem: io::Error) -> LedgerFileError {
        match problem.kind() {
            io::ErrorKind::InvalidData | io::ErrorKind::UnexpectedEof => LedgerFileError::Damaged(problem.to_string()),
            _ => LedgerFileError::Io(problem),
        }
    }
}

/// What `redb` says, as an error of input or output.
fn failed(problem: impl Into<redb::Error>) -> io::Error {
    use redb::Error::{DatabaseAlreadyOpen, DatabaseClosed, Io, LockPoisoned, PreviousIo, ValueTooLarge};
    match problem.into() {
        Io(problem) => problem,
        other @ (DatabaseAlreadyOpen | DatabaseClosed | LockPoisoned(_) | PreviousIo | ValueTooLarge(_)) => {
            io::Error::other(other.to_string())
        }
        // All others say that the file is not as it was left: not even its form, or its tables.
        other => io::Error::new(io::ErrorKind::InvalidData, other.to_string()),
    }
}

fn malformed(what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, format!("its {what} cannot be read"))
}

impl LedgerFile {
    /// Makes one in an empty file, and brings it to disk.
    pub(super) fn create(
        file: impl StorageBackend,
        owner: &StoreOwner,
        identity: StoreIdentity,
    ) -> io::Result<LedgerFile> {
        let mut builder = Database::builder();
        let database = builder.set_cache_size(CACHE_BYTES).create_with_backend(file).map_err(failed)?;
        let mut ledger = LedgerFile { database, owner: owner.clone(), identity, commits: 0 };
        ledger.transact(|ones, _| {
            ones.insert(IS_FORMAT, &FORMAT.to_be_bytes()[..]).map_err(failed)?;
            ones.insert(IS_FLEET, owner.fleet.as_str().as_bytes()).map_err(failed)?;
            ones.insert(IS_NODE, owner.node.as_str().as_bytes()).map_err(failed)?;
            ones.insert(IS_IDENTITY, &identity.0.to_be_bytes()[..]).map_err(failed)?;
            Ok(())
        })?;
        Ok(ledger)
    }

    /// Opens one, compares all checksums, and gives back space that is no longer used.
    pub(super) fn open(file: impl StorageBackend) -> Result<LedgerFile, LedgerFileError> {
        // redb 4.4 panics over some damage to its header.
        let opened = catch_unwind(AssertUnwindSafe(|| LedgerFile::open_sound(file)));
        opened.unwrap_or_else(|_| {
            Err(LedgerFileError::Damaged("it makes no sense to the program that reads it".to_owned()))
        })
    }

    fn open_sound(file: impl StorageBackend) -> Result<LedgerFile, LedgerFileError> {
        let bytes = file.len()?;
        if bytes == 0 {
            return Err(LedgerFileError::Damaged("it is empty".to_owned()));
        }
        // redb would take a file without its first bytes for one whose creation was interrupted. Ours are created under
        // another name.
        let mut first = [0; 4];
        if bytes < first.len() as u64 || file.read(0, &mut first).is_err() || first != *b"redb" {
            return Err(LedgerFileError::Damaged("it does not begin as a ledger does".to_owned()));
        }
        let mut builder = Database::builder();
        let mut database = builder.set_cache_size(CACHE_BYTES).create_with_backend(file).map_err(failed)?;
        // What redb could mend it has rolled back to the write before; whether that may be, the seal tells.
        database.check_integrity().map_err(failed)?;
        let stored = {
            let writing = database.begin_write().map_err(failed)?;
            let stats = writing.stats().map_err(failed)?;
            writing.abort().map_err(failed)?;
            stats.stored_bytes() + stats.metadata_bytes()
        };
        if bytes > COMPACT_BYTES_MIN.max(stored * COMPACT_RATIO) {
            database.compact().map_err(failed)?;
        }
        let reading = database.begin_read().map_err(failed)?;
        let ones = reading.open_table(ONES).map_err(failed)?;
        let one = |name: &str| -> io::Result<Vec<u8>> {
            let value = ones.get(name).map_err(failed)?;
            value.map(|value| value.value().to_vec()).ok_or_else(|| malformed(name))
        };
        let format = number(IS_FORMAT, &one(IS_FORMAT)?)?;
        if format != FORMAT {
            return Err(LedgerFileError::Format(format));
        }
        let text = |name: &str| one(name).and_then(|bytes| String::from_utf8(bytes).map_err(|_| malformed(name)));
        let owner = StoreOwner {
            fleet: FleetId::new(&text(IS_FLEET)?).map_err(|_| malformed(IS_FLEET))?,
            node: NodeId::new(&text(IS_NODE)?).map_err(|_| malformed(IS_NODE))?,
        };
        let identity = one(IS_IDENTITY)?.try_into().map_err(|_| malformed(IS_IDENTITY))?;
        let commits = number(IS_COMMITS, &one(IS_COMMITS)?)?;
        drop((ones, reading));
        Ok(LedgerFile { database, owner, identity: StoreIdentity(u128::from_be_bytes(identity)), commits })
    }

    pub(super) fn owner(&self) -> &StoreOwner {
        &self.owner
    }

    pub(super) fn identity(&self) -> StoreIdentity {
        self.identity
    }

    /// The number of the last write.
    pub(super) fn commits(&self) -> u64 {
        self.commits
    }

    /// All that the journal recorded.
    pub(super) fn persistent_state(&self) -> io::Result<PersistentState> {
        let reading = self.database.begin_read().map_err(failed)?;
        let log = reading.open_table(LOG).map_err(failed)?;
        let entries = log.iter().map_err(failed)?.map(|entry| {
            let (index, bytes) = entry.map_err(failed)?;
            Ok((index.value(), bytes.value().to_vec()))
        });
        Ok(PersistentState {
            vote: self.one(IS_VOTE)?,
            committed: self.one(IS_COMMITTED)?,
            purged: self.one(IS_PURGED)?,
            snapshot: self.one(IS_SNAPSHOT)?,
            entries: entries.collect::<io::Result<_>>()?,
        })
    }

    /// The notebook's page.
    pub(super) fn checkpoint(&self) -> io::Result<Option<Vec<u8>>> {
        self.one(IS_PAGE)
    }

    /// The last life that was begun; 0 before the first.
    pub(super) fn incarnation(&self) -> io::Result<u64> {
        self.one(IS_INCARNATION)?.map_or(Ok(0), |bytes| number(IS_INCARNATION, &bytes))
    }

    /// Carries out all changes, in order, in one transaction. When it returns `Ok`, they are on disk.
    pub(super) fn write(&mut self, changes: &[LedgerWrite]) -> io::Result<()> {
        self.transact(|ones, log| changes.iter().try_for_each(|change| apply(change, ones, log)))
    }

    fn one(&self, name: &str) -> io::Result<Option<Vec<u8>>> {
        let reading = self.database.begin_read().map_err(failed)?;
        let ones = reading.open_table(ONES).map_err(failed)?;
        let value = ones.get(name).map_err(failed)?;
        Ok(value.map(|value| value.value().to_vec()))
    }

    fn transact(
        &mut self,
        change: impl FnOnce(&mut Table<'_, &str, &[u8]>, &mut Table<'_, u64, &[u8]>) -> io::Result<()>,
    ) -> io::Result<()> {
        let commits = self.commits + 1;
        // Durability is redb's default: `commit` returns after the file was synced.
        let writing = self.database.begin_write().map_err(failed)?;
        {
            let mut ones = writing.open_table(ONES).map_err(failed)?;
            let mut log = writing.open_table(LOG).map_err(failed)?;
            change(&mut ones, &mut log)?;
            ones.insert(IS_COMMITS, &commits.to_be_bytes()[..]).map_err(failed)?;
        }
        writing.commit().map_err(failed)?;
        self.commits = commits;
        Ok(())
    }
}

fn number(name: &str, bytes: &[u8]) -> io::Result<u64> {
    bytes.try_into().map(u64::from_be_bytes).map_err(|_| malformed(name))
}

fn apply(change: &LedgerWrite, ones: &mut Table<'_, &str, &[u8]>, log: &mut Table<'_, u64, &[u8]>) -> io::Result<()> {
    match change {
        LedgerWrite::Vote(vote) => put(ones, IS_VOTE, Some(vote)),
        LedgerWrite::Committed(committed) => put(ones, IS_COMMITTED, committed.as_deref()),
        LedgerWrite::Append(entries) => append(log, entries.iter().map(|(index, entry)| (*index, &entry[..]))),
        LedgerWrite::Truncate(from) => log.retain_in(*from.., |_, _| false).map_err(failed),
        LedgerWrite::Purge(through, last) => {
            log.retain_in(..=*through, |_, _| false).map_err(failed)?;
            put(ones, IS_PURGED, Some(last))
        }
        LedgerWrite::Snapshot(snapshot) => put(ones, IS_SNAPSHOT, Some(snapshot)),
        LedgerWrite::Checkpoint(page) => put(ones, IS_PAGE, page.as_deref()),
        LedgerWrite::Incarnation(incarnation) => put(ones, IS_INCARNATION, Some(&incarnation.to_be_bytes())),
        LedgerWrite::Replace(recorded) => {
            put(ones, IS_VOTE, recorded.vote.as_deref())?;
            put(ones, IS_COMMITTED, recorded.committed.as_deref())?;
            put(ones, IS_PURGED, recorded.purged.as_deref())?;
            put(ones, IS_SNAPSHOT, recorded.snapshot.as_deref())?;
            log.retain_in(0.., |_, _| false).map_err(failed)?;
            append(log, recorded.entries.iter().map(|(index, entry)| (*index, &entry[..])))
        }
    }
}

fn put(ones: &mut Table<'_, &str, &[u8]>, name: &str, value: Option<&[u8]>) -> io::Result<()> {
    match value {
        Some(value) => ones.insert(name, value).map(drop).map_err(failed),
        None => ones.remove(name).map(drop).map_err(failed),
    }
}

fn append<'a>(log: &mut Table<'_, u64, &[u8]>, entries: impl Iterator<Item = (u64, &'a [u8])>) -> io::Result<()> {
    for (index, entry) in entries {
        log.insert(index, entry).map_err(failed)?;
    }
    Ok(())
}
