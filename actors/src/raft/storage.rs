//! openraft's storage over a [`Journal`]: the log cached in memory, and the state machine with its snapshots.

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

/// Takes a lock that no code of ours holds while it can panic.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Is told of each entry that a copy of the state machine takes in, with its commands; none for those that are Raft's own.
/// It must not ask the replica for its state, which is locked meanwhile.
pub type ApplyObserver<S> = Arc<dyn Fn(Epoch, &[<S as StateMachine>::Command]) + Send + Sync>;

/// Opens what `journal` holds: the log, and the state machine as of the last snapshot. openraft applies the rest.
pub(super) async fn open<S: StateMachine>(
    journal: Arc<dyn LogStore>,
    observer: Option<ApplyObserver<S>>,
) -> Result<(LogCache<S>, StateMachineStore<S>), std::io::Error> {
    let (log, machine) = load_state::<S>(journal.load().await?)?;
    let applied = Arc::new(watch::Sender::new(machine.applied.as_ref().map(epoch_of).unwrap_or_default()));
    let cluster = Arc::new(watch::Sender::new(machine.state.cluster()));
    let (tell_covered, covered) = watch::channel(Ok(machine.applied));
    let (log, appended) = (Arc::new(Mutex::new(log)), Arc::default());
    let log = LogCache { journal: Arc::clone(&journal), log, appended, covered };
    let machine = Arc::new(Mutex::new(machine));
    let (covered, snapshots) = (Arc::new(tell_covered), Arc::default());
    Ok((log, StateMachineStore { journal, machine, applied, cluster, covered, observer, snapshots }))
}

/// Reads what a journal recorded: the log, and the state machine as of the last snapshot.
pub(super) fn load_state<S: StateMachine>(
    recorded: PersistentState,
) -> Result<(Log<S>, AppliedState<S>), std::io::Error> {
    let PersistentState { vote, committed, purged, entries, snapshot } = recorded;
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
        let kept: StoredSnapshot = decode_record(&bytes)?;
        machine.restore(decode_record(&kept.state)?, kept);
    }
    if log.purged > machine.applied {
        let (purged, held) = (shown(log.purged.as_ref()), shown(machine.applied.as_ref()));
        return Err(unsound(format!("its log begins after {purged}, and its snapshot ends with {held}")));
    }
    Ok((log, machine))
}

pub(super) fn decode_record<T: serde::de::DeserializeOwned>(bytes: &[u8]) -> std::io::Result<T> {
    codec::decode_record(bytes).map_err(|error| std::io::Error::new(std::io::ErrorKind::InvalidData, error.to_string()))
}

pub(super) fn encode_record<T: Serialize>(value: &T) -> std::io::Result<Vec<u8>> {
    codec::encode_record(value).map_err(|error| std::io::Error::new(std::io::ErrorKind::InvalidData, error.to_string()))
}

fn unsound(what: String) -> std::io::Error {
    std::io::Error::new(std::io::ErrorKind::InvalidData, what)
}

fn shown(log_id: Option<&LogId>) -> String {
    log_id.map_or_else(|| "nothing".to_owned(), |log_id| epoch_of(log_id).to_string())
}

/// Whether each entry stands where it says it does, right after the one before; the first, right after what was purged.
fn check_continuity<S: StateMachine>(log: &Log<S>) -> std::io::Result<()> {
    let mut last = log.purged;
    for (index, CachedEntry { entry, .. }) in &log.entries {
        // None after the last index of all.
        let expected = last.map_or(Some(0), |last| last.index.checked_add(1));
        if Some(*index) != expected || entry.log_id.index != *index || last >= Some(entry.log_id) {
            let (found, last) = (epoch_of(&entry.log_id), shown(last.as_ref()));
            return Err(unsound(format!("its log has entry {found} at place {index}, right after {last}")));
        }
        last = Some(entry.log_id);
    }
    Ok(())
}

/// The log as openraft reads it; the journal holds the same, durably.
pub(super) struct Log<S: StateMachine> {
    pub(super) vote: Option<Vote>,
    pub(super) committed: Option<LogId>,
    pub(super) purged: Option<LogId>,
    pub(super) entries: BTreeMap<u64, CachedEntry<S>>,
}

/// An entry of the log.
pub(super) struct CachedEntry<S: StateMachine> {
    pub(super) entry: Entry<TypeConfig<S>>,
    /// Its encoded size.
    bytes: usize,
}

/// The last entry that the journal's snapshot covers; or why a snapshot that was to be installed is not in the journal.
type Covered = Result<Option<LogId>, String>;

/// The log and the vote.
pub(super) struct LogCache<S: StateMachine> {
    journal: Arc<dyn LogStore>,
    log: Arc<Mutex<Log<S>>>,
    /// How often entries have been written.
    appended: Arc<watch::Sender<u64>>,
    covered: watch::Receiver<Covered>,
}

impl<S: StateMachine> Clone for LogCache<S> {
    fn clone(&self) -> Self {
        LogCache {
            journal: Arc::clone(&self.journal),
            log: Arc::clone(&self.log),
            appended: Arc::clone(&self.appended),
            covered: self.covered.clone(),
        }
    }
}

impl<S: StateMachine> LogCache<S> {
    /// The last entry of the log, if it ever had one.
    pub(super) fn last(&self) -> Option<LogId> {
        let log = lock(&self.log);
        log.entries.last_key_value().map(|(_, held)| held.entry.log_id).or(log.purged)
    }

    /// How often entries have been written, now and whenever it grows.
    pub(super) fn appended(&self) -> watch::Receiver<u64> {
        self.appended.subscribe()
    }

    /// Waits until the journal's snapshot covers all entries up to this one.
    async fn until_covered(&self, through: LogId) -> std::io::Result<()> {
        let reached = |covered: &Covered| covered.as_ref().map_or(true, |last| *last >= Some(through));
        let mut covered = self.covered.clone();
        let covered = covered.wait_for(reached).await.map_err(|_| std::io::Error::other("the replica has ended"))?;
        let missing = |problem| std::io::Error::other(format!("no snapshot covers what is to be purged: {problem}"));
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
        Ok(lock(&self.log).entries.range(range).map(|(_, held)| held.entry.clone()).collect())
    }

    /// The entries from `start` on, and before `end`, that go in one message: one at least, and more while they fit.
    async fn limited_get_log_entries(
        &mut self,
        start: u64,
        end: u64,
    ) -> Result<Vec<Entry<TypeConfig<S>>>, StorageError> {
        let log = lock(&self.log);
        let mut bytes = 0;
        let fits = |held: &&CachedEntry<S>| {
            let first = bytes == 0;
            bytes += held.bytes;
            first || bytes <= APPEND_BYTES
        };
        Ok(log
            .entries
            .range(start..end)
            .map(|(_, held)| held)
            .take_while(fits)
            .map(|held| held.entry.clone())
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
            let journal = Arc::clone(&self.journal);
            tokio::spawn(async move { journal.save_vote(bytes).await });
        } else if !mutants::is_active(Mutant::DoubleVote) {
            self.journal.save_vote(bytes).await.map_err(writing_vote)?;
        }
        lock(&self.log).vote = Some(*vote);
        Ok(())
    }

    async fn read_vote(&mut self) -> Result<Option<Vote>, StorageError> {
        Ok(lock(&self.log).vote)
    }

    async fn save_committed(&mut self, committed: Option<LogId>) -> Result<(), StorageError> {
        let bytes = committed.as_ref().map(encode_record).transpose().map_err(writing_logs)?;
        self.journal.save_committed(bytes).await.map_err(writing_logs)?;
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
            let journal = Arc::clone(&self.journal);
            tokio::spawn(async move { journal.append(records).await });
        } else {
            self.journal.append(records).await.map_err(writing_logs)?;
        }
        let held =
            entries.into_iter().zip(sizes).map(|(entry, bytes)| (entry.log_id.index, CachedEntry { entry, bytes }));
        lock(&self.log).entries.extend(held);
        self.appended.send_modify(|count| *count += 1);
        callback.log_io_completed(Ok(()));
        Ok(())
    }

    async fn truncate(&mut self, from: LogId) -> Result<(), StorageError> {
        self.journal.truncate(from.index).await.map_err(writing_logs)?;
        lock(&self.log).entries.split_off(&from.index);
        Ok(())
    }

    /// openraft asks for this right after it has handed a snapshot from the leader to a task of its own, which installs it.
    /// Should the power fail between the two writes, the one that removes entries must not have been the first.
    async fn purge(&mut self, through: LogId) -> Result<(), StorageError> {
        self.until_covered(through).await.map_err(writing_logs)?;
        let last = encode_record(&through).map_err(writing_logs)?;
        self.journal.purge(through.index, last).await.map_err(writing_logs)?;
        let mut log = lock(&self.log);
        log.entries = log.entries.split_off(&(through.index + 1));
        log.purged = Some(through);
        Ok(())
    }
}

/// A snapshot as the journal keeps it.
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
    fn restore(&mut self, state: S, kept: StoredSnapshot) {
        self.state = state;
        self.applied = kept.meta.last_log_id;
        self.membership = kept.meta.last_membership.clone();
        self.snapshot = Some(kept);
    }

    /// Carries out the next entry of the log.
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

/// The state machine, shared by openraft, which applies, and whoever reads.
pub(super) struct StateMachineStore<S: StateMachine> {
    journal: Arc<dyn LogStore>,
    machine: Arc<Mutex<AppliedState<S>>>,
    applied: Arc<watch::Sender<Epoch>>,
    cluster: Arc<watch::Sender<Option<ClusterId>>>,
    covered: Arc<watch::Sender<Covered>>,
    observer: Option<ApplyObserver<S>>,
    /// Held while a snapshot goes to the journal: openraft builds one while it installs another.
    snapshots: Arc<tokio::sync::Mutex<()>>,
}

impl<S: StateMachine> Clone for StateMachineStore<S> {
    fn clone(&self) -> Self {
        StateMachineStore {
            journal: Arc::clone(&self.journal),
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
    /// What `look` sees in the state as applied so far on this node.
    pub(super) fn read<R>(&self, look: impl FnOnce(&S) -> R) -> R {
        look(&lock(&self.machine).state)
    }

    /// The state as applied so far on this node, and the place of the last entry that is in it.
    pub(super) fn copy(&self) -> (Option<Epoch>, S)
    where
        S: Clone,
    {
        let machine = lock(&self.machine);
        (machine.applied.as_ref().map(epoch_of), machine.state.clone())
    }

    /// Which founding the state belongs to, once it says so.
    pub(super) fn cluster(&self) -> watch::Receiver<Option<ClusterId>> {
        self.cluster.subscribe()
    }

    fn tell_cluster(&self, cluster: Option<ClusterId>) {
        self.cluster.send_if_modified(|known| std::mem::replace(known, cluster) != cluster);
    }

    /// The place of the last applied entry, told anew after each batch.
    pub(super) fn applied(&self) -> watch::Receiver<Epoch> {
        self.applied.subscribe()
    }

    async fn install(&self, kept: StoredSnapshot) -> Result<(), StorageError> {
        let state: S = decode_record(&kept.state).map_err(reading_snapshot)?;
        let (cluster, last) = (state.cluster(), kept.meta.last_log_id);
        let record = encode_record(&kept).map_err(writing_snapshot)?;
        let _alone = self.snapshots.lock().await;
        self.journal.save_snapshot(record).await.map_err(writing_snapshot)?;
        lock(&self.machine).restore(state, kept);
        self.covered.send_modify(|covered| *covered = Ok(last));
        self.tell_cluster(cluster);
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
        self.tell_cluster(cluster);
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
                // Which store made it matters: two nodes' bytes of one state may differ.
                snapshot_id: format!("{last}@{:032x}", self.journal.identity().0),
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
        if let Err(problem) = &installed {
            // Whoever waits for it, to purge what it covers, would wait for ever.
            self.covered.send_modify(|covered| *covered = Err(problem.to_string()));
        }
        installed
    }

    async fn get_current_snapshot(&mut self) -> Result<Option<Snapshot<TypeConfig<S>>>, StorageError> {
        Ok(lock(&self.machine).snapshot.clone().map(to_snapshot))
    }
}

fn to_snapshot<S: StateMachine>(kept: StoredSnapshot) -> Snapshot<TypeConfig<S>> {
    Snapshot { meta: kept.meta, snapshot: Box::new(Cursor::new(kept.state)) }
}

/// Makes a snapshot of the state as it was when the builder was asked for.
pub(super) struct SnapshotBuilder<S: StateMachine> {
    store: StateMachineStore<S>,
    state: S,
    meta: SnapshotMeta,
}

impl<S: StateMachine> RaftSnapshotBuilder<TypeConfig<S>> for SnapshotBuilder<S> {
    async fn build_snapshot(&mut self) -> Result<Snapshot<TypeConfig<S>>, StorageError> {
        let kept =
            StoredSnapshot { meta: self.meta.clone(), state: encode_record(&self.state).map_err(writing_snapshot)? };
        let record = encode_record(&kept).map_err(writing_snapshot)?;
        let _alone = self.store.snapshots.lock().await;
        let newest = lock(&self.store.machine).snapshot.as_ref().and_then(|kept| kept.meta.last_log_id);
        // A newer one may have been installed from the leader in the meantime, and the log purged up to it.
        if newest <= kept.meta.last_log_id {
            self.store.journal.save_snapshot(record).await.map_err(writing_snapshot)?;
            lock(&self.store.machine).snapshot = Some(kept.clone());
            // An installation that has failed meanwhile stays failed.
            self.store
                .covered
                .send_if_modified(|covered| covered.as_mut().map(|last| *last = kept.meta.last_log_id).is_ok());
        }
        Ok(to_snapshot(kept))
    }
}
