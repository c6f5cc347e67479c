//! The log, cached in memory.
//!
//! A decoded entry is several times as large as an encoded one, so only the latest entries are kept decoded: those that
//! are being replicated and applied. The others are decoded when a follower that lags needs them.

use super::records::{Covered, decode_record, encode_record, lock};
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

/// Number of entries, at the end of the log, that are kept decoded. Raised: a follower that lags costs less computing time, and
/// the log takes more memory. A guess: more entries than are committed within a round trip.
const DECODED_MAX: u64 = 128;

/// The log as openraft reads it; the log store holds the same data durably.
pub(crate) struct Log<S: StateMachine> {
    pub(crate) vote: Option<Vote>,
    pub(crate) committed: Option<LogId>,
    pub(crate) purged: Option<LogId>,
    pub(crate) entries: BTreeMap<u64, CachedEntry<S>>,
}

impl<S: StateMachine> Log<S> {
    /// Adds entries, and keeps only the latest entries decoded.
    fn append(&mut self, entries: Vec<CachedEntry<S>>) {
        for cached in entries {
            let index = cached.log_id.index;
            self.entries.insert(index, cached);
            let earlier = index.checked_sub(DECODED_MAX).and_then(|earlier| self.entries.get_mut(&earlier));
            if let Some(earlier) = earlier {
                earlier.decoded = None;
            }
        }
    }
}

/// Log entry. Copies share its content.
#[derive(Clone)]
pub(crate) struct CachedEntry<S: StateMachine> {
    pub(crate) log_id: LogId,
    bytes: Arc<[u8]>,
    /// The same entry, if it is among the latest.
    decoded: Option<Arc<Entry<TypeConfig<S>>>>,
}

impl<S: StateMachine> CachedEntry<S> {
    /// Creates an entry that is stored encoded.
    pub(super) fn stored(bytes: &[u8]) -> std::io::Result<CachedEntry<S>> {
        let entry: Entry<TypeConfig<S>> = decode_record(bytes)?;
        Ok(CachedEntry { log_id: entry.log_id, bytes: bytes.into(), decoded: None })
    }

    fn appended(entry: Entry<TypeConfig<S>>, bytes: &[u8]) -> CachedEntry<S> {
        CachedEntry { log_id: entry.log_id, bytes: bytes.into(), decoded: Some(Arc::new(entry)) }
    }

    /// Returns the entry for openraft.
    pub(crate) fn to_entry(&self) -> std::io::Result<Entry<TypeConfig<S>>> {
        match &self.decoded {
            Some(entry) => Ok(Entry::clone(entry)),
            None => decode_record(&self.bytes),
        }
    }
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
        let bytes = log.entries.values().map(|cached| cached.bytes.len() as u64).sum();
        let appended_bytes = Arc::new(watch::Sender::new(bytes));
        LogCache { log_store, log: Arc::new(Mutex::new(log)), appended: Arc::default(), appended_bytes, covered }
    }

    /// Returns the last entry of the log, if it ever had an entry.
    pub(crate) fn last(&self) -> Option<LogId> {
        let log = lock(&self.log);
        log.entries.last_key_value().map(|(_, cached)| cached.log_id).or(log.purged)
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

fn reading_logs(error: std::io::Error) -> StorageError {
    StorageIOError::read_logs(AnyError::new(&error)).into()
}

/// Decodes entries outside of the lock.
fn decoded<S: StateMachine>(cached: &[CachedEntry<S>]) -> std::io::Result<Vec<Entry<TypeConfig<S>>>> {
    cached.iter().map(CachedEntry::to_entry).collect()
}

fn writing_vote(error: std::io::Error) -> StorageError {
    StorageIOError::write_vote(AnyError::new(&error)).into()
}

impl<S: StateMachine> RaftLogReader<TypeConfig<S>> for LogCache<S> {
    async fn try_get_log_entries<R: RangeBounds<u64> + Clone + Debug + OptionalSend>(
        &mut self,
        range: R,
    ) -> Result<Vec<Entry<TypeConfig<S>>>, StorageError> {
        let cached: Vec<_> = lock(&self.log).entries.range(range).map(|(_, cached)| cached.clone()).collect();
        decoded(&cached).map_err(reading_logs)
    }

    /// Returns the entries from `start` and before `end` that fit in a single message: at least the
    /// first, and more while they fit.
    async fn limited_get_log_entries(
        &mut self,
        start: u64,
        end: u64,
    ) -> Result<Vec<Entry<TypeConfig<S>>>, StorageError> {
        let mut bytes = 0;
        let fits = |cached: &&CachedEntry<S>| {
            let first = bytes == 0;
            bytes += cached.bytes.len();
            first || bytes <= APPEND_BYTES
        };
        let cached: Vec<CachedEntry<S>> = {
            let log = lock(&self.log);
            let range = log.entries.range(start..end).map(|(_, cached)| cached);
            range.take_while(fits).cloned().collect()
        };
        decoded(&cached).map_err(reading_logs)
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
        let appended: u64 = records.iter().map(|(_, record)| record.len() as u64).sum();
        let cached = entries.into_iter().zip(&records).map(|(entry, (_, record))| CachedEntry::appended(entry, record));
        let cached: Vec<CachedEntry<S>> = cached.collect();
        self.log_store.append(records).await.map_err(writing_logs)?;
        lock(&self.log).append(cached);
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
        let kept = log.entries.split_off(&(through.index + 1));
        let purged = std::mem::replace(&mut log.entries, kept);
        log.purged = Some(through);
        drop(log);
        drop(purged); // thousands of entries, outside of the lock
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log_store::MemoryLogStore;
    use crate::types::{Batch, RaftId};
    use consort_protocol::ids::ClusterId;
    use consort_protocol::ledger::{Command, Ledger};
    use openraft::{CommittedLeaderId, EntryPayload};

    fn entry(index: u64) -> Entry<TypeConfig<Ledger>> {
        let command = Command::Bootstrap { cluster: ClusterId(index) };
        let log_id = LogId::new(CommittedLeaderId::new(1, RaftId(7)), index);
        Entry { log_id, payload: EntryPayload::Normal(Batch(vec![command])) }
    }

    #[tokio::test]
    async fn only_the_latest_entries_are_kept_decoded_and_all_can_be_read() {
        let mut log = Log::<Ledger> { vote: None, committed: None, purged: None, entries: BTreeMap::new() };
        let entries: Vec<_> = (0..1000).map(entry).collect();
        for some in entries.chunks(10) {
            let append = |entry: &Entry<TypeConfig<Ledger>>| {
                CachedEntry::appended(entry.clone(), &encode_record(entry).unwrap())
            };
            log.append(some.iter().map(append).collect());
            let decoded = log.entries.values().filter(|cached| cached.decoded.is_some()).count();
            assert!(decoded as u64 <= DECODED_MAX, "{decoded}");
        }
        let (_covered, receiver) = watch::channel(Ok(None));
        let mut cache = LogCache::new(Arc::new(MemoryLogStore::new(1)), log, receiver);
        assert_eq!(cache.last(), Some(entries[999].log_id));
        let encoded = |entries: &[Entry<TypeConfig<Ledger>>]| -> Vec<Vec<u8>> {
            entries.iter().map(|entry| encode_record(entry).unwrap()).collect()
        };
        let read = cache.try_get_log_entries(0..1000).await.unwrap();
        assert_eq!(encoded(&read), encoded(&entries));
        let read = cache.limited_get_log_entries(400, 900).await.unwrap();
        assert_eq!(encoded(&read), encoded(&entries[400..900]));
    }
}
