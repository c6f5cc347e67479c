//! The ledger file: the content of a store as tables of `redb`.
//!
//! Each call of [`LedgerFile::write`] is a transaction, numbered from 1 (the creation of the
//! store). When it returns, the whole transaction is on disk; after a crash it is there as a whole
//! or not at all. `redb` keeps a checksum of every page in the parent page; opening the file
//! verifies all of them.

use super::layout::StoreOwner;
use crate::log_store::{PersistentState, StoreIdentity};
use crate::storage::{SnapshotError, StoredSnapshot};
use consort_protocol::ids::{FleetId, NodeId};
use redb::{Database, ReadTransaction, ReadableDatabase, ReadableTable, StorageBackend, Table, TableDefinition};
use std::io;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Version of the table format. It is increased by a change that older programs cannot read.
const FORMAT: u64 = 1;

/// Format while the snapshot is in pieces. A program that reads format 1 only would find no snapshot, and report damage.
const FORMAT_OF_PIECES: u64 = 2;

/// Single values by name. The table name `values` is part of the stored format.
const VALUES: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("ones");

/// Log entries by index.
const LOG: TableDefinition<'_, u64, &[u8]> = TableDefinition::new("log");

/// Pieces of a large snapshot, by number.
const PIECES: TableDefinition<'_, u64, &[u8]> = TableDefinition::new("snapshot_pieces");

const FORMAT_KEY: &str = "format";
const FLEET_KEY: &str = "fleet";
const NODE_KEY: &str = "node";
const IDENTITY_KEY: &str = "identity";
const COMMITS_KEY: &str = "commits";
const INCARNATION_KEY: &str = "incarnation";
const VOTE_KEY: &str = "vote";
const COMMITTED_KEY: &str = "committed";
const PURGED_KEY: &str = "purged";
const SNAPSHOT_KEY: &str = "snapshot";
/// Numbers of the pieces of the snapshot: the first, and that after the last, of 8 bytes each. Absent if the snapshot is a
/// single value, or if there is none.
const SNAPSHOT_PIECES_KEY: &str = "snapshot_pieces";
const CHECKPOINT_KEY: &str = "page";
/// Present if the store replaces a damaged store.
const REPLACES_DAMAGED_KEY: &str = "replaces_damaged";

/// Page cache in bytes. The replica keeps the log in memory, so little is read.
const CACHE_BYTES: usize = 8 << 20;

/// A file smaller than this, in bytes, is not compacted.
const COMPACT_BYTES_MIN: u64 = 1 << 20;

/// A file is compacted when it is this many times larger than its stored content. A guess.
const COMPACT_RATIO: u64 = 4;

/// A change to the ledger file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum LedgerWrite {
    Vote(Vec<u8>),
    Committed(Option<Vec<u8>>),
    Append(Vec<(u64, Vec<u8>)>),
    /// Removes all entries from this index to the end.
    Truncate(u64),
    /// Removes all entries up to this index, and stores the id of the last of them.
    Purge(u64, Vec<u8>),
    Snapshot(Vec<u8>),
    /// A piece of the next snapshot, with its position among the pieces. The present snapshot remains.
    SnapshotPiece(u64, Vec<u8>),
    /// Replaces the snapshot by this number of the pieces written since.
    SnapshotOfPieces(u64),
    Checkpoint(Option<Vec<u8>>),
    Incarnation(u64),
    /// Replaces log, vote and snapshot.
    Replace(Box<PersistentState>),
}

/// The open ledger file.
#[derive(Debug)]
pub(super) struct LedgerFile {
    database: Database,
    owner: StoreOwner,
    identity: StoreIdentity,
    replaces_damaged: bool,
    commits: u64,
}

/// The file cannot be opened.
pub(super) enum LedgerFileError {
    /// The content differs from what was written.
    Damaged(String),
    /// The format belongs to another release.
    Format(u64),
    Io(io::Error),
}

impl From<io::Error> for LedgerFileError {
    fn from(error: io::Error) -> LedgerFileError {
        match error.kind() {
            io::ErrorKind::InvalidData | io::ErrorKind::UnexpectedEof => LedgerFileError::Damaged(error.to_string()),
            _ => LedgerFileError::Io(error),
        }
    }
}

/// Converts an error of `redb` to an I/O error.
fn io_error(error: impl Into<redb::Error>) -> io::Error {
    use redb::Error::{DatabaseAlreadyOpen, DatabaseClosed, Io, LockPoisoned, PreviousIo, ValueTooLarge};
    match error.into() {
        Io(error) => error,
        other @ (DatabaseAlreadyOpen | DatabaseClosed | LockPoisoned(_) | PreviousIo | ValueTooLarge(_)) => {
            io::Error::other(other.to_string())
        }
        // All other errors mean that the file was changed or damaged, including its format and its
        // tables.
        other => io::Error::new(io::ErrorKind::InvalidData, other.to_string()),
    }
}

fn malformed(name: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, format!("its value `{name}` cannot be decoded"))
}

impl LedgerFile {
    /// Creates a ledger file in an empty file, and syncs it to disk. If it replaces a damaged store,
    /// `replaced` is the last incarnation of that store.
    pub(super) fn create(
        file: impl StorageBackend,
        owner: &StoreOwner,
        identity: StoreIdentity,
        replaced: Option<u64>,
    ) -> io::Result<LedgerFile> {
        let mut builder = Database::builder();
        let database = builder.set_cache_size(CACHE_BYTES).create_with_backend(file).map_err(io_error)?;
        let mut ledger =
            LedgerFile { database, owner: owner.clone(), identity, replaces_damaged: replaced.is_some(), commits: 0 };
        ledger.transact(|Tables { values, .. }| {
            values.insert(FORMAT_KEY, &FORMAT.to_be_bytes()[..]).map_err(io_error)?;
            values.insert(FLEET_KEY, owner.fleet.as_str().as_bytes()).map_err(io_error)?;
            values.insert(NODE_KEY, owner.node.as_str().as_bytes()).map_err(io_error)?;
            values.insert(IDENTITY_KEY, &identity.0.to_be_bytes()[..]).map_err(io_error)?;
            if let Some(last_incarnation) = replaced {
                values.insert(INCARNATION_KEY, &last_incarnation.to_be_bytes()[..]).map_err(io_error)?;
                values.insert(REPLACES_DAMAGED_KEY, &[][..]).map_err(io_error)?;
            }
            Ok(())
        })?;
        Ok(ledger)
    }

    /// Opens a ledger file, verifies all checksums, and releases unused space.
    pub(super) fn open(file: impl StorageBackend) -> Result<LedgerFile, LedgerFileError> {
        // redb 4.4 panics over some damage to its header.
        let opened = catch_unwind(AssertUnwindSafe(|| LedgerFile::open_checked(file)));
        opened.unwrap_or_else(|_| Err(LedgerFileError::Damaged("redb cannot interpret its content".to_owned())))
    }

    fn open_checked(file: impl StorageBackend) -> Result<LedgerFile, LedgerFileError> {
        let bytes = file.len()?;
        if bytes == 0 {
            return Err(LedgerFileError::Damaged("it is empty".to_owned()));
        }
        // redb would treat a file without its first bytes as an interrupted creation. Files of this
        // store are created under another name.
        let mut first = [0; 4];
        if bytes < first.len() as u64 || file.read(0, &mut first).is_err() || first != *b"redb" {
            return Err(LedgerFileError::Damaged("it does not begin with the header of a ledger file".to_owned()));
        }
        let mut builder = Database::builder();
        let mut database = builder.set_cache_size(CACHE_BYTES).create_with_backend(file).map_err(io_error)?;
        // redb repairs a file by a rollback to the previous write. The commit marker shows whether
        // that is acceptable.
        database.check_integrity().map_err(io_error)?;
        let stored_bytes = {
            let write_transaction = database.begin_write().map_err(io_error)?;
            let stats = write_transaction.stats().map_err(io_error)?;
            write_transaction.abort().map_err(io_error)?;
            stats.stored_bytes() + stats.metadata_bytes()
        };
        if bytes > COMPACT_BYTES_MIN.max(stored_bytes * COMPACT_RATIO) {
            database.compact().map_err(io_error)?;
        }
        let read_transaction = database.begin_read().map_err(io_error)?;
        let values = read_transaction.open_table(VALUES).map_err(io_error)?;
        let value_of = |name: &str| -> io::Result<Vec<u8>> {
            let value = values.get(name).map_err(io_error)?;
            value.map(|value| value.value().to_vec()).ok_or_else(|| malformed(name))
        };
        let format = number(FORMAT_KEY, &value_of(FORMAT_KEY)?)?;
        if !(FORMAT..=FORMAT_OF_PIECES).contains(&format) {
            return Err(LedgerFileError::Format(format));
        }
        let text = |name: &str| value_of(name).and_then(|bytes| String::from_utf8(bytes).map_err(|_| malformed(name)));
        let owner = StoreOwner {
            fleet: FleetId::new(&text(FLEET_KEY)?).map_err(|_| malformed(FLEET_KEY))?,
            node: NodeId::new(&text(NODE_KEY)?).map_err(|_| malformed(NODE_KEY))?,
        };
        let identity = value_of(IDENTITY_KEY)?.try_into().map_err(|_| malformed(IDENTITY_KEY))?;
        let commits = number(COMMITS_KEY, &value_of(COMMITS_KEY)?)?;
        let replaces_damaged = values.get(REPLACES_DAMAGED_KEY).map_err(io_error)?.is_some();
        if let Some(snapshot) = read_snapshot(&read_transaction)? {
            check_snapshot(&snapshot)?;
        }
        drop((values, read_transaction));
        let identity = StoreIdentity(u128::from_be_bytes(identity));
        Ok(LedgerFile { database, owner, identity, replaces_damaged, commits })
    }

    /// Reads the last incarnation from a damaged file; 0 if it cannot be read.
    pub(super) fn salvage_incarnation(file: impl StorageBackend) -> u64 {
        let read = || -> io::Result<u64> {
            let database = Database::builder().create_with_backend(file).map_err(io_error)?;
            let read_transaction = database.begin_read().map_err(io_error)?;
            let values = read_transaction.open_table(VALUES).map_err(io_error)?;
            let value = values.get(INCARNATION_KEY).map_err(io_error)?;
            value.map_or(Ok(0), |bytes| number(INCARNATION_KEY, bytes.value()))
        };
        catch_unwind(AssertUnwindSafe(read)).ok().and_then(Result::ok).unwrap_or(0)
    }

    pub(super) fn owner(&self) -> &StoreOwner {
        &self.owner
    }

    pub(super) fn identity(&self) -> StoreIdentity {
        self.identity
    }

    /// Checks whether the store replaces a damaged store.
    pub(super) fn replaces_damaged(&self) -> bool {
        self.replaces_damaged
    }

    /// Returns the number of the last write.
    pub(super) fn commits(&self) -> u64 {
        self.commits
    }

    /// Reads the persistent state of the replica.
    pub(super) fn persistent_state(&self) -> io::Result<PersistentState> {
        let read_transaction = self.database.begin_read().map_err(io_error)?;
        let log = read_transaction.open_table(LOG).map_err(io_error)?;
        let entries = log.iter().map_err(io_error)?.map(|entry| {
            let (index, bytes) = entry.map_err(io_error)?;
            Ok((index.value(), bytes.value().to_vec()))
        });
        Ok(PersistentState {
            vote: self.value_of(VOTE_KEY)?,
            committed: self.value_of(COMMITTED_KEY)?,
            purged: self.value_of(PURGED_KEY)?,
            snapshot: read_snapshot(&read_transaction)?,
            entries: entries.collect::<io::Result<_>>()?,
        })
    }

    /// Reads the checkpoint of the robot.
    pub(super) fn checkpoint(&self) -> io::Result<Option<Vec<u8>>> {
        self.value_of(CHECKPOINT_KEY)
    }

    /// Reads the last incarnation; 0 before the first.
    pub(super) fn incarnation(&self) -> io::Result<u64> {
        self.value_of(INCARNATION_KEY)?.map_or(Ok(0), |bytes| number(INCARNATION_KEY, &bytes))
    }

    /// Applies all changes, in order, in a single transaction. When it returns `Ok`, they are on
    /// disk.
    pub(super) fn write(&mut self, changes: &[LedgerWrite]) -> io::Result<()> {
        self.transact(|tables| changes.iter().try_for_each(|change| apply(change, tables)))
    }

    fn value_of(&self, name: &str) -> io::Result<Option<Vec<u8>>> {
        let read_transaction = self.database.begin_read().map_err(io_error)?;
        let values = read_transaction.open_table(VALUES).map_err(io_error)?;
        let value = values.get(name).map_err(io_error)?;
        Ok(value.map(|value| value.value().to_vec()))
    }

    fn transact(&mut self, change: impl FnOnce(&mut Tables<'_>) -> io::Result<()>) -> io::Result<()> {
        let commits = self.commits + 1;
        // Durability is redb's default: `commit` returns after the file was synced.
        let write_transaction = self.database.begin_write().map_err(io_error)?;
        {
            let values = write_transaction.open_table(VALUES).map_err(io_error)?;
            let log = write_transaction.open_table(LOG).map_err(io_error)?;
            let pieces = write_transaction.open_table(PIECES).map_err(io_error)?;
            let mut tables = Tables { values, log, pieces };
            change(&mut tables)?;
            tables.values.insert(COMMITS_KEY, &commits.to_be_bytes()[..]).map_err(io_error)?;
        }
        write_transaction.commit().map_err(io_error)?;
        self.commits = commits;
        Ok(())
    }
}

/// The tables of a transaction.
struct Tables<'txn> {
    values: Table<'txn, &'static str, &'static [u8]>,
    log: Table<'txn, u64, &'static [u8]>,
    pieces: Table<'txn, u64, &'static [u8]>,
}

/// Returns the numbers of the pieces of the snapshot; none if it is a single value, or if there is none.
fn piece_numbers(values: &impl ReadableTable<&'static str, &'static [u8]>) -> io::Result<Range<u64>> {
    let Some(numbers) = values.get(SNAPSHOT_PIECES_KEY).map_err(io_error)? else { return Ok(0..0) };
    let (first, end) = numbers.value().split_at_checked(8).ok_or_else(|| malformed(SNAPSHOT_PIECES_KEY))?;
    Ok(number(SNAPSHOT_PIECES_KEY, first)?..number(SNAPSHOT_PIECES_KEY, end)?)
}

/// Reads the newest snapshot.
fn read_snapshot(read_transaction: &ReadTransaction) -> io::Result<Option<Vec<u8>>> {
    let values = read_transaction.open_table(VALUES).map_err(io_error)?;
    let numbers = piece_numbers(&values)?;
    if numbers.is_empty() {
        let snapshot = values.get(SNAPSHOT_KEY).map_err(io_error)?;
        return Ok(snapshot.map(|bytes| bytes.value().to_vec()));
    }
    let pieces = read_transaction.open_table(PIECES).map_err(io_error)?;
    let mut snapshot = vec![];
    for number in numbers {
        let piece = pieces.get(number).map_err(io_error)?.ok_or_else(|| malformed(SNAPSHOT_PIECES_KEY))?;
        snapshot.extend_from_slice(piece.value());
    }
    Ok(Some(snapshot))
}

/// Checks the checksum of the stored snapshot. A snapshot of another layout belongs to another release; the
/// replica reports it.
fn check_snapshot(bytes: &[u8]) -> io::Result<()> {
    match StoredSnapshot::decode(bytes) {
        Err(SnapshotError::Damaged(id)) => Err(SnapshotError::Damaged(id).into()),
        Ok(_) | Err(SnapshotError::Undecodable(_)) => Ok(()),
    }
}

fn number(name: &str, bytes: &[u8]) -> io::Result<u64> {
    bytes.try_into().map(u64::from_be_bytes).map_err(|_| malformed(name))
}

fn apply(change: &LedgerWrite, tables: &mut Tables<'_>) -> io::Result<()> {
    let Tables { values, log, pieces } = tables;
    match change {
        LedgerWrite::Vote(vote) => put(values, VOTE_KEY, Some(vote)),
        LedgerWrite::Committed(committed) => put(values, COMMITTED_KEY, committed.as_deref()),
        LedgerWrite::Append(entries) => append(log, entries.iter().map(|(index, entry)| (*index, &entry[..]))),
        LedgerWrite::Truncate(from) => log.retain_in(*from.., |_, _| false).map_err(io_error),
        LedgerWrite::Purge(through, last) => {
            log.retain_in(..=*through, |_, _| false).map_err(io_error)?;
            put(values, PURGED_KEY, Some(last))
        }
        LedgerWrite::Snapshot(snapshot) => {
            put(values, SNAPSHOT_KEY, Some(snapshot))?;
            remove_pieces(values, pieces)
        }
        LedgerWrite::SnapshotPiece(position, piece) => {
            // Replaces a piece of a snapshot that was not completed.
            let number = piece_numbers(&*values)?.end + position;
            pieces.insert(number, &piece[..]).map(drop).map_err(io_error)
        }
        LedgerWrite::SnapshotOfPieces(count) => {
            let first = piece_numbers(&*values)?.end;
            let numbers = first..first + count;
            pieces.retain(|number, _| numbers.contains(&number)).map_err(io_error)?;
            put(values, SNAPSHOT_KEY, None)?;
            put(values, FORMAT_KEY, Some(&FORMAT_OF_PIECES.to_be_bytes()))?;
            let numbers = [numbers.start.to_be_bytes(), numbers.end.to_be_bytes()].concat();
            put(values, SNAPSHOT_PIECES_KEY, Some(&numbers))
        }
        LedgerWrite::Checkpoint(checkpoint) => put(values, CHECKPOINT_KEY, checkpoint.as_deref()),
        LedgerWrite::Incarnation(incarnation) => put(values, INCARNATION_KEY, Some(&incarnation.to_be_bytes())),
        LedgerWrite::Replace(state) => {
            put(values, VOTE_KEY, state.vote.as_deref())?;
            put(values, COMMITTED_KEY, state.committed.as_deref())?;
            put(values, PURGED_KEY, state.purged.as_deref())?;
            put(values, SNAPSHOT_KEY, state.snapshot.as_deref())?;
            remove_pieces(values, pieces)?;
            log.retain_in(0.., |_, _| false).map_err(io_error)?;
            append(log, state.entries.iter().map(|(index, entry)| (*index, &entry[..])))
        }
    }
}

/// Removes the pieces of the former snapshot, once the snapshot is a single value.
fn remove_pieces(
    values: &mut Table<'_, &'static str, &'static [u8]>,
    pieces: &mut Table<'_, u64, &'static [u8]>,
) -> io::Result<()> {
    put(values, FORMAT_KEY, Some(&FORMAT.to_be_bytes()))?;
    put(values, SNAPSHOT_PIECES_KEY, None)?;
    pieces.retain(|_, _| false).map_err(io_error)
}

fn put(values: &mut Table<'_, &str, &[u8]>, name: &str, value: Option<&[u8]>) -> io::Result<()> {
    match value {
        Some(value) => values.insert(name, value).map(drop).map_err(io_error),
        None => values.remove(name).map(drop).map_err(io_error),
    }
}

fn append<'a>(log: &mut Table<'_, u64, &[u8]>, entries: impl Iterator<Item = (u64, &'a [u8])>) -> io::Result<()> {
    for (index, entry) in entries {
        log.insert(index, entry).map_err(io_error)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use redb::backends::InMemoryBackend;

    fn new_file() -> LedgerFile {
        let owner = StoreOwner { fleet: FleetId::new("ward").unwrap(), node: NodeId::new("ada").unwrap() };
        LedgerFile::create(InMemoryBackend::new(), &owner, StoreIdentity(7), None).unwrap()
    }

    #[test]
    fn pieces_of_an_interrupted_snapshot_are_replaced() {
        let mut ledger = new_file();
        let piece = |position, byte| LedgerWrite::SnapshotPiece(position, vec![byte]);
        for round in 0..3 {
            ledger.write(&[piece(0, 7), piece(1, 7), piece(2, 7)]).unwrap();
            let former = (round > 0).then(|| vec![round - 1, 9]);
            assert_eq!(ledger.persistent_state().unwrap().snapshot, former);
            ledger.write(&[piece(0, round), piece(1, 9), LedgerWrite::SnapshotOfPieces(2)]).unwrap();
            assert_eq!(ledger.persistent_state().unwrap().snapshot, Some(vec![round, 9]));
            let pieces = ledger.database.begin_read().unwrap().open_table(PIECES).unwrap();
            assert_eq!(pieces.iter().unwrap().count(), 2, "no piece is left behind");
        }
    }

    #[test]
    fn earlier_releases_refuse_a_file_only_while_its_snapshot_is_in_pieces() {
        let mut ledger = new_file();
        let pieces = [LedgerWrite::SnapshotPiece(0, vec![1, 2]), LedgerWrite::SnapshotPiece(1, vec![3])];
        let replaced = PersistentState { snapshot: Some(vec![4]), ..PersistentState::default() };
        let singles = [LedgerWrite::Snapshot(vec![4]), LedgerWrite::Replace(Box::new(replaced))];
        for single in singles {
            ledger.write(&pieces).unwrap();
            assert_eq!(ledger.value_of(FORMAT_KEY).unwrap(), Some(FORMAT.to_be_bytes().to_vec()));
            ledger.write(&[LedgerWrite::SnapshotOfPieces(2)]).unwrap();
            assert_eq!(ledger.value_of(FORMAT_KEY).unwrap(), Some(FORMAT_OF_PIECES.to_be_bytes().to_vec()));
            assert_eq!(ledger.persistent_state().unwrap().snapshot, Some(vec![1, 2, 3]));
            ledger.write(&[single]).unwrap();
            assert_eq!(ledger.value_of(FORMAT_KEY).unwrap(), Some(FORMAT.to_be_bytes().to_vec()));
            assert_eq!(ledger.persistent_state().unwrap().snapshot, Some(vec![4]));
        }
    }
}
