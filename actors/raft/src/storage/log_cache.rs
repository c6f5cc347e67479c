//! The log, cached in memory.

use super::records::{Covered, encode_record, lock};
use crate::log_store::LogStore;
use crate::settings::APPEND_BYTES;
use crate::types::{LogId, StateMachine, StorageError, StorageIOError, TypeConfig, Vote};
use openraft::storage::{LogFlushed, RaftLogStorage};
use openraft::{AnyError, Entry, LogState, OptionalSend, RaftLogReader};
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::ops::RangeBounds;
use std::sync::{Arc, Mutex};
use tokio::sync::watch;

/// The log as openraft reads it; the log store holds the same data durably.
pub(crate) struct Log<S: StateMachine> {
    pub(crate) vote: Option<Vote>,
    pub(crate) committed: Option<LogId>,
    pub(crate) purged: Option<LogId>,
    pub(crate) entries: BTreeMap<u64, CachedEntry<S>>,
}

/// Log entry.
pub(crate) struct CachedEntry<S: StateMachine> {
    pub(crate) entry: Entry<TypeConfig<S>>,
    /// Encoded size in bytes.
    pub(super) bytes: usize,
}

/// Log and vote, cached in memory.
pub(crate) struct LogCache<S: StateMachine> {
    log_store: Arc<dyn LogStore>,
    log: Arc<Mutex<Log<S>>>,
    /// Number of appends so far.
    appended: Arc<watch::Sender<u64>>,
    /// Encoded size of the entries at the start and of all appended since, in bytes.
    appended_bytes: Arc<watch::Sender<u64>>,
    covered: watch::Receiver<Covered>,
}

impl<S: StateMachine> Clone for LogCache<S> {
    fn clone(&self) -> Self {
        LogCache {
            log_store: Arc::clone(&self.log_store),
            log: Arc::clone(&self.log),
            appended: Arc::clone(&self.appended),
            appended_bytes: Arc::clone(&self.appended_bytes),
            covered: self.covered.clone(),
        }
    }
}

impl<S: StateMachine> LogCache<S> {
    /// Creates the cache of a loaded log. `covered` is the last entry covered by the stored
    /// snapshot.
    pub(super) fn new(log_store: Arc<dyn LogStore>, log: Log<S>, covered: watch::Receiver<Covered>) -> LogCache<S> {
        let bytes = log.entries.values().map(|cached| cached.bytes as u64).sum();
        let appended_bytes = Arc::new(watch::Sender::new(bytes));
        LogCache { log_store, log: Arc::new(Mutex::new(log)), appended: Arc::default(), appended_bytes, covered }
    }

    /// Returns the last entry of the log, if it ever had an entry.
    pub(crate) fn last(&self) -> Option<LogId> {
        let log = lock(&self.log);
        log.entries.last_key_value().map(|(_, cached)| cached.entry.log_id).or(log.purged)
    }

    /// Returns a watch of the number of appends.
    pub(crate) fn appended(&self) -> watch::Receiver<u64> {
        self.appended.subscribe()
    }

    /// Returns a watch of the encoded size of the entries at the start and of all appended since, in bytes.
    pub(crate) fn appended_bytes(&self) -> watch::Receiver<u64> {
        self.appended_bytes.subscribe()
    }

    /// Waits until the stored snapshot covers all entries up to this entry.
    async fn wait_covered(&self, through: LogId) -> std::io::Result<()> {
        let reached = |covered: &Covered| covered.as_ref().map_or(true, |last| *last >= Some(through));
        let mut covered = self.covered.clone();
        let covered = covered.wait_for(reached).await.map_err(|_| std::io::Error::other("the replica has stopped"))?;
        let missing = |error| std::io::Error::other(format!("no snapshot covers the entries to purge: {error}"));
        covered.as_ref().map(drop).map_err(missing)
    }
}

fn writing_logs(error: std::io::Error) -> StorageError {
    StorageIOError::write_logs(AnyError::new(&error)).into()
}

fn writing_vote(error: std::io::Error) -> StorageError {
    StorageIOError::write_vote(AnyError::new(&error)).into()
}

impl<S: StateMachine> RaftLogReader<TypeConfig<S>> for LogCache<S> {
    async fn try_get_log_entries<R: RangeBounds<u64> + Clone + Debug + OptionalSend>(
        &mut self,
        range: R,
    ) -> Result<Vec<Entry<TypeConfig<S>>>, StorageError> {
        Ok(lock(&self.log).entries.range(range).map(|(_, cached)| cached.entry.clone()).collect())
    }

    /// Returns the entries from `start` and before `end` that fit in a single message: at least the
    /// first, and more while they fit.
    async fn limited_get_log_entries(
        &mut self,
        start: u64,
        end: u64,
    ) -> Result<Vec<Entry<TypeConfig<S>>>, StorageError> {
        let log = lock(&self.log);
        let mut bytes = 0;
        let fits = |cached: &&CachedEntry<S>| {
            let first = bytes == 0;
            bytes += cached.bytes;
            first || bytes <= APPEND_BYTES
        };
        Ok(log
            .entries
            .range(start..end)
            .map(|(_, cached)| cached)
            .take_while(fits)
            .map(|cached| cached.entry.clone())
            .collect())
    }
}

impl<S: StateMachine> RaftLogStorage<TypeConfig<S>> for LogCache<S> {
    type LogReader = Self;

    async fn get_log_state(&mut self) -> Result<LogState<TypeConfig<S>>, StorageError> {
        let purged = lock(&self.log).purged;
        Ok(LogState { last_purged_log_id: purged, last_log_id: self.last() })
    }

    async fn get_log_reader(&mut self) -> Self {
        self.clone()
    }

    async fn save_vote(&mut self, vote: &Vote) -> Result<(), StorageError> {
        let bytes = encode_record(vote).map_err(writing_vote)?;
        self.log_store.save_vote(bytes).await.map_err(writing_vote)?;
        lock(&self.log).vote = Some(*vote);
        Ok(())
    }

    async fn read_vote(&mut self) -> Result<Option<Vote>, StorageError> {
        Ok(lock(&self.log).vote)
    }

    async fn save_committed(&mut self, committed: Option<LogId>) -> Result<(), StorageError> {
        let bytes = committed.as_ref().map(encode_record).transpose().map_err(writing_logs)?;
        self.log_store.save_committed(bytes).await.map_err(writing_logs)?;
        lock(&self.log).committed = committed;
        Ok(())
    }

    async fn read_committed(&mut self) -> Result<Option<LogId>, StorageError> {
        Ok(lock(&self.log).committed)
    }

    async fn append<I>(&mut self, entries: I, callback: LogFlushed<TypeConfig<S>>) -> Result<(), StorageError>
    where
        I: IntoIterator<Item = Entry<TypeConfig<S>>> + OptionalSend,
        I::IntoIter: OptionalSend,
    {
        let entries: Vec<_> = entries.into_iter().collect();
        let records =
            entries.iter().map(|entry| Ok((entry.log_id.index, encode_record(entry)?))).collect::<Result<Vec<_>, _>>();
        let records = records.map_err(writing_logs)?;
        let sizes: Vec<usize> = records.iter().map(|(_, record)| record.len()).collect();
        self.log_store.append(records).await.map_err(writing_logs)?;
        let appended: u64 = sizes.iter().map(|bytes| *bytes as u64).sum();
        let cached =
            entries.into_iter().zip(sizes).map(|(entry, bytes)| (entry.log_id.index, CachedEntry { entry, bytes }));
        lock(&self.log).entries.extend(cached);
        self.appended.send_modify(|count| *count += 1);
        self.appended_bytes.send_modify(|bytes| *bytes += appended);
        callback.log_io_completed(Ok(()));
        Ok(())
    }

    async fn truncate(&mut self, from: LogId) -> Result<(), StorageError> {
        self.log_store.truncate(from.index).await.map_err(writing_logs)?;
        lock(&self.log).entries.split_off(&from.index);
        Ok(())
    }

    /// openraft calls this directly after it has passed a snapshot of the leader to a separate
    /// task, which installs it. If the power fails between the two writes, the removal of entries
    /// must not have been the first write.
    async fn purge(&mut self, through: LogId) -> Result<(), StorageError> {
        self.wait_covered(through).await.map_err(writing_logs)?;
        let last = encode_record(&through).map_err(writing_logs)?;
        self.log_store.purge(through.index, last).await.map_err(writing_logs)?;
        let mut log = lock(&self.log);
        log.entries = log.entries.split_off(&(through.index + 1));
        log.purged = Some(through);
        Ok(())
    }
}
