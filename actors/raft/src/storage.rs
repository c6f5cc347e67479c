//! Storage of openraft over a [`LogStore`]: the log, cached in memory, and the state machine with
//! its snapshots.

use super::log_store::{LogStore, PersistentState};
use super::network::APPEND_BYTES;
use super::types::{
    Batch, Epoch, LogId, SnapshotMeta, StateMachine, StorageError, StorageIOError, StoredMembership, TypeConfig, Vote,
    epoch_of,
};
use consort_protocol::codec;
use consort_protocol::ids::ClusterId;
use consort_protocol::mutants::{self, Mutant};
use openraft::storage::{LogFlushed, RaftLogStorage, RaftStateMachine};
use openraft::{AnyError, Entry, EntryPayload, LogState, OptionalSend, RaftLogReader, RaftSnapshotBuilder, Snapshot};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::io::Cursor;
use std::ops::RangeBounds;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;

/// Locks a mutex. No code in this file panics while it holds a lock.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Callback for each entry that a replica applies, with its commands; without commands for Raft's
/// own entries. It must not read the state of the replica, which is locked meanwhile.
pub type ApplyObserver<S> = Arc<dyn Fn(Epoch, &[<S as StateMachine>::Command]) + Send + Sync>;

/// Opens the state in `log_store`: the log, and the state machine as of the last snapshot. openraft
/// applies the rest.
pub(super) async fn open<S: StateMachine>(
    log_store: Arc<dyn LogStore>,
    observer: Option<ApplyObserver<S>>,
) -> Result<(LogCache<S>, StateMachineStore<S>), std::io::Error> {
    let (log, machine) = load_state::<S>(log_store.load().await?)?;
    let applied = Arc::new(watch::Sender::new(machine.applied.as_ref().map(epoch_of).unwrap_or_default()));
    let cluster = Arc::new(watch::Sender::new(machine.state.cluster()));
    let (covered_sender, covered) = watch::channel(Ok(machine.applied));
    let (log, appended) = (Arc::new(Mutex::new(log)), Arc::default());
    let log = LogCache { log_store: Arc::clone(&log_store), log, appended, covered };
    let machine = Arc::new(Mutex::new(machine));
    let (covered, snapshots) = (Arc::new(covered_sender), Arc::default());
    Ok((log, StateMachineStore { log_store, machine, applied, cluster, covered, observer, snapshots }))
}

/// Decodes the contents of a log store: the log, and the state machine as of the last snapshot.
pub(super) fn load_state<S: StateMachine>(
    stored: PersistentState,
) -> Result<(Log<S>, AppliedState<S>), std::io::Error> {
    let PersistentState { vote, committed, purged, entries, snapshot } = stored;
    let read = |bytes: Option<Vec<u8>>| bytes.as_deref().map(decode_record).transpose();
    let log = Log {
        vote: vote.as_deref().map(decode_record).transpose()?,
        committed: read(committed)?,
        purged: read(purged)?,
        entries: entries
            .iter()
            .map(|(index, bytes)| Ok((*index, CachedEntry { entry: decode_record(bytes)?, bytes: bytes.len() })))
            .collect::<Result<_, std::io::Error>>()?,
    };
    check_continuity(&log)?;
    let mut machine =
        AppliedState { state: S::default(), applied: None, membership: StoredMembership::default(), snapshot: None };
    if let Some(bytes) = snapshot {
        let stored: StoredSnapshot = decode_record(&bytes)?;
        machine.restore(decode_record(&stored.state)?, stored);
    }
    if log.purged > machine.applied {
        let (purged, snapshot_end) = (position_text(log.purged.as_ref()), position_text(machine.applied.as_ref()));
        return Err(invalid_data(format!("the log begins after {purged}, but the snapshot ends with {snapshot_end}")));
    }
    Ok((log, machine))
}

pub(super) fn decode_record<T: serde::de::DeserializeOwned>(bytes: &[u8]) -> std::io::Result<T> {
    codec::decode_record(bytes).map_err(|error| std::io::Error::new(std::io::ErrorKind::InvalidData, error.to_string()))
}

pub(super) fn encode_record<T: Serialize>(value: &T) -> std::io::Result<Vec<u8>> {
    codec::encode_record(value).map_err(|error| std::io::Error::new(std::io::ErrorKind::InvalidData, error.to_string()))
}

fn invalid_data(message: String) -> std::io::Error {
    std::io::Error::new(std::io::ErrorKind::InvalidData, message)
}

fn position_text(log_id: Option<&LogId>) -> String {
    log_id.map_or_else(|| "nothing".to_owned(), |log_id| epoch_of(log_id).to_string())
}

/// Checks that each entry is stored under its own index, directly after the previous entry; the
/// first, directly after the purged part.
fn check_continuity<S: StateMachine>(log: &Log<S>) -> std::io::Result<()> {
    let mut last = log.purged;
    for (index, CachedEntry { entry, .. }) in &log.entries {
        // `None` after the greatest possible index.
        let expected = last.map_or(Some(0), |last| last.index.checked_add(1));
        if Some(*index) != expected || entry.log_id.index != *index || last >= Some(entry.log_id) {
            let (found, last) = (epoch_of(&entry.log_id), position_text(last.as_ref()));
            return Err(invalid_data(format!("the log has entry {found} at index {index}, directly after {last}")));
        }
        last = Some(entry.log_id);
    }
    Ok(())
}

/// The log as openraft reads it; the log store holds the same data durably.
pub(super) struct Log<S: StateMachine> {
    pub(super) vote: Option<Vote>,
    pub(super) committed: Option<LogId>,
    pub(super) purged: Option<LogId>,
    pub(super) entries: BTreeMap<u64, CachedEntry<S>>,
}

/// Log entry.
pub(super) struct CachedEntry<S: StateMachine> {
    pub(super) entry: Entry<TypeConfig<S>>,
    /// Encoded size in bytes.
    bytes: usize,
}

/// Last entry covered by the stored snapshot, or the reason why a received snapshot was not stored.
type Covered = Result<Option<LogId>, String>;

/// Log and vote, cached in memory.
pub(super) struct LogCache<S: StateMachine> {
    log_store: Arc<dyn LogStore>,
    log: Arc<Mutex<Log<S>>>,
    /// Number of appends so far.
    appended: Arc<watch::Sender<u64>>,
    covered: watch::Receiver<Covered>,
}

impl<S: StateMachine> Clone for LogCache<S> {
    fn clone(&self) -> Self {
        LogCache {
            log_store: Arc::clone(&self.log_store),
            log: Arc::clone(&self.log),
            appended: Arc::clone(&self.appended),
            covered: self.covered.clone(),
        }
    }
}

impl<S: StateMachine> LogCache<S> {
    /// Returns the last entry of the log, if it ever had an entry.
    pub(super) fn last(&self) -> Option<LogId> {
        let log = lock(&self.log);
        log.entries.last_key_value().map(|(_, cached)| cached.entry.log_id).or(log.purged)
    }

    /// Returns a watch of the number of appends.
    pub(super) fn appended(&self) -> watch::Receiver<u64> {
        self.appended.subscribe()
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
        if mutants::is_active(Mutant::SkipFsync) {
            let log_store = Arc::clone(&self.log_store);
            tokio::spawn(async move { log_store.save_vote(bytes).await });
        } else if !mutants::is_active(Mutant::DoubleVote) {
            self.log_store.save_vote(bytes).await.map_err(writing_vote)?;
        }
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
        if mutants::is_active(Mutant::SkipFsync) {
            let log_store = Arc::clone(&self.log_store);
            tokio::spawn(async move { log_store.append(records).await });
        } else {
            self.log_store.append(records).await.map_err(writing_logs)?;
        }
        let cached =
            entries.into_iter().zip(sizes).map(|(entry, bytes)| (entry.log_id.index, CachedEntry { entry, bytes }));
        lock(&self.log).entries.extend(cached);
        self.appended.send_modify(|count| *count += 1);
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

/// Snapshot as stored in the log store.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct StoredSnapshot {
    pub(super) meta: SnapshotMeta,
    pub(super) state: Vec<u8>,
}

pub(super) struct AppliedState<S> {
    pub(super) state: S,
    pub(super) applied: Option<LogId>,
    pub(super) membership: StoredMembership,
    snapshot: Option<StoredSnapshot>,
}

impl<S: StateMachine> AppliedState<S> {
    fn restore(&mut self, state: S, stored: StoredSnapshot) {
        self.state = state;
        self.applied = stored.meta.last_log_id;
        self.membership = stored.meta.last_membership.clone();
        self.snapshot = Some(stored);
    }

    /// Applies the next entry of the log.
    pub(super) fn apply_entry(&mut self, Entry { log_id, payload }: Entry<TypeConfig<S>>) -> Option<Vec<S::Outcome>> {
        self.applied = Some(log_id);
        match payload {
            EntryPayload::Blank => None,
            EntryPayload::Normal(Batch(commands)) => {
                let at = epoch_of(&log_id);
                Some(commands.into_iter().map(|command| self.state.apply(at, command)).collect())
            }
            EntryPayload::Membership(membership) => {
                self.membership = StoredMembership::new(Some(log_id), membership);
                None
            }
        }
    }
}

/// The state machine, shared by openraft, which applies entries, and the readers.
pub(super) struct StateMachineStore<S: StateMachine> {
    log_store: Arc<dyn LogStore>,
    machine: Arc<Mutex<AppliedState<S>>>,
    applied: Arc<watch::Sender<Epoch>>,
    cluster: Arc<watch::Sender<Option<ClusterId>>>,
    covered: Arc<watch::Sender<Covered>>,
    observer: Option<ApplyObserver<S>>,
    /// Held while a snapshot is written to the log store: openraft builds a snapshot while it
    /// installs another.
    snapshots: Arc<tokio::sync::Mutex<()>>,
}

impl<S: StateMachine> Clone for StateMachineStore<S> {
    fn clone(&self) -> Self {
        StateMachineStore {
            log_store: Arc::clone(&self.log_store),
            machine: Arc::clone(&self.machine),
            applied: Arc::clone(&self.applied),
            cluster: Arc::clone(&self.cluster),
            covered: Arc::clone(&self.covered),
            observer: self.observer.clone(),
            snapshots: Arc::clone(&self.snapshots),
        }
    }
}

impl<S: StateMachine> StateMachineStore<S> {
    /// Calls `inspect` with the state as applied so far on this node.
    pub(super) fn read<R>(&self, inspect: impl FnOnce(&S) -> R) -> R {
        inspect(&lock(&self.machine).state)
    }

    /// Returns the state as applied so far on this node, and the position of its last entry.
    pub(super) fn copy(&self) -> (Option<Epoch>, S)
    where
        S: Clone,
    {
        let machine = lock(&self.machine);
        (machine.applied.as_ref().map(epoch_of), machine.state.clone())
    }

    /// Returns a watch of the cluster of the state; `None` until the state records it.
    pub(super) fn cluster(&self) -> watch::Receiver<Option<ClusterId>> {
        self.cluster.subscribe()
    }

    fn publish_cluster(&self, cluster: Option<ClusterId>) {
        self.cluster.send_if_modified(|known| std::mem::replace(known, cluster) != cluster);
    }

    /// Returns a watch of the position of the last applied entry, updated after each batch.
    pub(super) fn applied(&self) -> watch::Receiver<Epoch> {
        self.applied.subscribe()
    }

    async fn install(&self, stored: StoredSnapshot) -> Result<(), StorageError> {
        let state: S = decode_record(&stored.state).map_err(reading_snapshot)?;
        let (cluster, last) = (state.cluster(), stored.meta.last_log_id);
        let record = encode_record(&stored).map_err(writing_snapshot)?;
        let _exclusive = self.snapshots.lock().await;
        self.log_store.save_snapshot(record).await.map_err(writing_snapshot)?;
        lock(&self.machine).restore(state, stored);
        self.covered.send_modify(|covered| *covered = Ok(last));
        self.publish_cluster(cluster);
        self.applied.send_replace(last.as_ref().map(epoch_of).unwrap_or_default());
        Ok(())
    }
}

fn reading_snapshot(error: std::io::Error) -> StorageError {
    StorageIOError::read_snapshot(None, AnyError::new(&error)).into()
}

fn writing_snapshot(error: std::io::Error) -> StorageError {
    StorageIOError::write_snapshot(None, AnyError::new(&error)).into()
}

impl<S: StateMachine> RaftStateMachine<TypeConfig<S>> for StateMachineStore<S> {
    type SnapshotBuilder = SnapshotBuilder<S>;

    async fn applied_state(&mut self) -> Result<(Option<LogId>, StoredMembership), StorageError> {
        let machine = lock(&self.machine);
        Ok((machine.applied, machine.membership.clone()))
    }

    async fn apply<I>(&mut self, entries: I) -> Result<Vec<Option<Vec<S::Outcome>>>, StorageError>
    where
        I: IntoIterator<Item = Entry<TypeConfig<S>>> + OptionalSend,
        I::IntoIter: OptionalSend,
    {
        let mut outcomes = Vec::new();
        let mut machine = lock(&self.machine);
        for entry in entries {
            if let Some(observer) = &self.observer {
                let commands =
                    if let EntryPayload::Normal(Batch(commands)) = &entry.payload { &commands[..] } else { &[] };
                observer(epoch_of(&entry.log_id), commands);
            }
            outcomes.push(machine.apply_entry(entry));
        }
        let applied = machine.applied.as_ref().map(epoch_of).unwrap_or_default();
        let cluster = machine.state.cluster();
        drop(machine);
        self.publish_cluster(cluster);
        self.applied.send_replace(applied);
        Ok(outcomes)
    }

    async fn get_snapshot_builder(&mut self) -> SnapshotBuilder<S> {
        let machine = lock(&self.machine);
        let last = machine.applied.as_ref().map_or("start".to_owned(), ToString::to_string);
        SnapshotBuilder {
            store: self.clone(),
            state: machine.state.clone(),
            meta: SnapshotMeta {
                last_log_id: machine.applied,
                last_membership: machine.membership.clone(),
                // The id includes the store: two nodes may encode the same state differently.
                snapshot_id: format!("{last}@{:032x}", self.log_store.identity().0),
            },
        }
    }

    async fn begin_receiving_snapshot(&mut self) -> Result<Box<Cursor<Vec<u8>>>, StorageError> {
        Ok(Box::default())
    }

    async fn install_snapshot(
        &mut self,
        meta: &SnapshotMeta,
        snapshot: Box<Cursor<Vec<u8>>>,
    ) -> Result<(), StorageError> {
        let installed = self.install(StoredSnapshot { meta: meta.clone(), state: snapshot.into_inner() }).await;
        if let Err(error) = &installed {
            // A purge of the covered entries would otherwise wait without end.
            self.covered.send_modify(|covered| *covered = Err(error.to_string()));
        }
        installed
    }

    async fn get_current_snapshot(&mut self) -> Result<Option<Snapshot<TypeConfig<S>>>, StorageError> {
        Ok(lock(&self.machine).snapshot.clone().map(to_snapshot))
    }
}

fn to_snapshot<S: StateMachine>(stored: StoredSnapshot) -> Snapshot<TypeConfig<S>> {
    Snapshot { meta: stored.meta, snapshot: Box::new(Cursor::new(stored.state)) }
}

/// Builds a snapshot of the state as of the creation of the builder.
pub(super) struct SnapshotBuilder<S: StateMachine> {
    store: StateMachineStore<S>,
    state: S,
    meta: SnapshotMeta,
}

impl<S: StateMachine> RaftSnapshotBuilder<TypeConfig<S>> for SnapshotBuilder<S> {
    async fn build_snapshot(&mut self) -> Result<Snapshot<TypeConfig<S>>, StorageError> {
        let stored =
            StoredSnapshot { meta: self.meta.clone(), state: encode_record(&self.state).map_err(writing_snapshot)? };
        let record = encode_record(&stored).map_err(writing_snapshot)?;
        let _exclusive = self.store.snapshots.lock().await;
        let newest = lock(&self.store.machine).snapshot.as_ref().and_then(|stored| stored.meta.last_log_id);
        // A newer snapshot of the leader may have been installed in the meantime, and the log
        // purged up to it.
        if newest <= stored.meta.last_log_id {
            self.store.log_store.save_snapshot(record).await.map_err(writing_snapshot)?;
            lock(&self.store.machine).snapshot = Some(stored.clone());
            // A failed installation stays failed.
            self.store
                .covered
                .send_if_modified(|covered| covered.as_mut().map(|last| *last = stored.meta.last_log_id).is_ok());
        }
        Ok(to_snapshot(stored))
    }
}
