//! The state machine and its snapshots.
//!
//! Entries are applied and states are read under a lock. A snapshot needs it only to copy the state, so copies should
//! share their parts. The copy is encoded, and snapshots are copied for others, outside of the lock.

use super::blocks::OwnBlocks;
use super::records::{Covered, SnapshotNotStored, StoredSnapshot, decode_record, encode_record, lock};
use super::snapshot_id::snapshot_id;
use crate::log_store::LogStore;
use crate::types::{
    Batch, Epoch, LogId, SnapshotMeta, StateMachine, StorageError, StorageIOError, StoredMembership, TypeConfig,
    epoch_of,
};
use consort_protocol::ids::ClusterId;
use openraft::storage::RaftStateMachine;
use openraft::{AnyError, Entry, EntryPayload, OptionalSend, RaftSnapshotBuilder, Snapshot};
use std::io::Cursor;
use std::sync::{Arc, Mutex};
use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::sync::watch;
use tokio::task::{JoinError, block_in_place};

/// Callback for each entry that a replica applies, with its commands; without commands for Raft's
/// own entries. It must not read the state of the replica, which is locked meanwhile.
pub type ApplyObserver<S> = Arc<dyn Fn(Epoch, &[<S as StateMachine>::Command]) + Send + Sync>;

pub(crate) struct AppliedState<S> {
    pub(crate) state: S,
    pub(crate) applied: Option<LogId>,
    pub(crate) membership: StoredMembership,
    pub(super) snapshot: Option<Arc<StoredSnapshot>>,
}

impl<S: StateMachine> AppliedState<S> {
    pub(super) fn restore(&mut self, state: S, stored: StoredSnapshot) {
        self.state = state;
        self.applied = stored.meta.last_log_id;
        self.membership = stored.meta.last_membership.clone();
        self.snapshot = Some(Arc::new(stored));
    }

    /// Applies the next entry of the log.
    pub(crate) fn apply_entry(&mut self, Entry { log_id, payload }: Entry<TypeConfig<S>>) -> Option<Vec<S::Outcome>> {
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
pub(crate) struct StateMachineStore<S: StateMachine> {
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
    /// Creates the store of a loaded state machine.
    pub(super) fn new(
        log_store: Arc<dyn LogStore>,
        machine: AppliedState<S>,
        covered: watch::Sender<Covered>,
        observer: Option<ApplyObserver<S>>,
    ) -> StateMachineStore<S> {
        let applied = Arc::new(watch::Sender::new(machine.applied.as_ref().map(epoch_of).unwrap_or_default()));
        let cluster = Arc::new(watch::Sender::new(machine.state.cluster()));
        let (machine, covered) = (Arc::new(Mutex::new(machine)), Arc::new(covered));
        StateMachineStore { log_store, machine, applied, cluster, covered, observer, snapshots: Arc::default() }
    }

    /// Calls `inspect` with the state as applied so far on this node.
    pub(crate) fn read<R>(&self, inspect: impl FnOnce(&S) -> R) -> R {
        inspect(&lock(&self.machine).state)
    }

    /// Calls `inspect` with the position of the last applied entry, and the state after it.
    pub(crate) fn read_with_position<R>(&self, inspect: impl FnOnce(Epoch, &S) -> R) -> R {
        let machine = lock(&self.machine);
        inspect(machine.applied.as_ref().map(epoch_of).unwrap_or_default(), &machine.state)
    }

    /// Returns the size of the latest snapshot in bytes; 0 without one.
    pub(crate) fn snapshot_bytes(&self) -> u64 {
        lock(&self.machine).snapshot.as_ref().map_or(0, |stored| stored.state.len() as u64)
    }

    /// Returns the blocks of the latest snapshot; none without one.
    pub(crate) async fn own_blocks(&self) -> OwnBlocks {
        let Some(snapshot) = lock(&self.machine).snapshot.clone() else { return OwnBlocks::default() };
        compute_apart(|| OwnBlocks::of(snapshot)).await.unwrap_or_default()
    }

    /// Returns the state as applied so far on this node, and the position of its last entry.
    pub(crate) fn copy(&self) -> (Option<Epoch>, S)
    where
        S: Clone,
    {
        let machine = lock(&self.machine);
        (machine.applied.as_ref().map(epoch_of), machine.state.clone())
    }

    /// Returns a watch of the cluster of the state; `None` until the state records it.
    pub(crate) fn cluster(&self) -> watch::Receiver<Option<ClusterId>> {
        self.cluster.subscribe()
    }

    fn publish_cluster(&self, cluster: Option<ClusterId>) {
        self.cluster.send_if_modified(|known| std::mem::replace(known, cluster) != cluster);
    }

    /// Returns a watch of the position of the last applied entry, updated after each batch.
    pub(crate) fn applied(&self) -> watch::Receiver<Epoch> {
        self.applied.subscribe()
    }

    async fn install(&self, stored: StoredSnapshot) -> Result<(), StorageError> {
        let state: S = compute(|| decode_record(&stored.state)).map_err(reading_snapshot)?;
        let (cluster, last) = (state.cluster(), stored.meta.last_log_id);
        let record = compute(|| encode_record(&stored)).map_err(writing_snapshot)?;
        let _exclusive = self.snapshots.lock().await;
        self.log_store.install_snapshot(record).await.map_err(writing_snapshot)?;
        let former = {
            let mut machine = lock(&self.machine);
            let former = std::mem::take(&mut machine.state);
            machine.restore(state, stored);
            former
        };
        drop(former); // a large one, outside of the lock
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
        SnapshotBuilder {
            store: self.clone(),
            state: machine.state.clone(),
            last_log_id: machine.applied,
            last_membership: machine.membership.clone(),
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
            self.covered.send_modify(|covered| *covered = Err(SnapshotNotStored(error.to_string())));
        }
        installed
    }

    async fn get_current_snapshot(&mut self) -> Result<Option<Snapshot<TypeConfig<S>>>, StorageError> {
        let stored = lock(&self.machine).snapshot.clone();
        Ok(stored.map(|stored| to_snapshot(StoredSnapshot::clone(&stored))))
    }
}

/// Computes for some milliseconds. Meanwhile the other tasks of this thread run on another, if the runtime has several.
pub(crate) fn compute<T>(work: impl FnOnce() -> T) -> T {
    match Handle::current().runtime_flavor() {
        RuntimeFlavor::MultiThread => block_in_place(work),
        _ => work(),
    }
}

/// Computes like [`compute`], in a task of its own, so that the task of the caller can do other work.
///
/// # Errors
/// The runtime ends, or `work` has panicked.
pub(crate) async fn compute_apart<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, JoinError> {
    tokio::spawn(async move { compute(work) }).await
}

fn to_snapshot<S: StateMachine>(stored: StoredSnapshot) -> Snapshot<TypeConfig<S>> {
    Snapshot { meta: stored.meta, snapshot: Box::new(Cursor::new(stored.state)) }
}

/// Builds a snapshot of the state as of the creation of the builder.
pub(crate) struct SnapshotBuilder<S: StateMachine> {
    store: StateMachineStore<S>,
    state: S,
    last_log_id: Option<LogId>,
    last_membership: StoredMembership,
}

impl<S: StateMachine> RaftSnapshotBuilder<TypeConfig<S>> for SnapshotBuilder<S> {
    async fn build_snapshot(&mut self) -> Result<Snapshot<TypeConfig<S>>, StorageError> {
        let state = compute(|| encode_record(&self.state)).map_err(writing_snapshot)?;
        let (last_log_id, last_membership) = (self.last_log_id, self.last_membership.clone());
        let last = last_log_id.as_ref().map_or("start".to_owned(), ToString::to_string);
        let snapshot_id = compute(|| snapshot_id(&last, self.store.log_store.identity(), &state));
        let stored = StoredSnapshot { meta: SnapshotMeta { last_log_id, last_membership, snapshot_id }, state };
        let record = compute(|| encode_record(&stored)).map_err(writing_snapshot)?;
        let stored = Arc::new(stored);
        let _exclusive = self.store.snapshots.lock().await;
        let newest = lock(&self.store.machine).snapshot.as_ref().and_then(|stored| stored.meta.last_log_id);
        // A newer snapshot of the leader may have been installed in the meantime, and the log
        // purged up to it.
        if newest <= stored.meta.last_log_id {
            self.store.log_store.save_snapshot(record).await.map_err(writing_snapshot)?;
            let former = lock(&self.store.machine).snapshot.replace(Arc::clone(&stored));
            drop(former); // a large one, outside of the lock
            // A failed installation stays failed.
            self.store
                .covered
                .send_if_modified(|covered| covered.as_mut().map(|last| *last = stored.meta.last_log_id).is_ok());
        }
        Ok(to_snapshot(StoredSnapshot::clone(&stored)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[tokio::test]
    async fn the_caller_of_a_computation_apart_does_other_work_before_it() {
        let done = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&done);
        let computed = compute_apart(move || counted.load(Ordering::Relaxed));
        let other = async { done.fetch_add(1, Ordering::Relaxed) };
        let (computed, _) = tokio::join!(computed, other);
        assert_eq!(computed.unwrap(), 1);
    }
}
