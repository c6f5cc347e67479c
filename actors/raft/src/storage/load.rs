//! Start from the contents of a log store.

use super::log_cache::{CachedEntry, Log, LogCache};
use super::records::{StoredSnapshot, decode_record};
use super::state_machine::{AppliedState, ApplyObserver, StateMachineStore};
use crate::log_store::{LogStore, PersistentState};
use crate::types::{LogId, StateMachine, StoredMembership, epoch_of};
use std::sync::Arc;
use tokio::sync::watch;

/// Opens the state in `log_store`: the log, and the state machine as of the last snapshot. openraft
/// applies the rest.
pub(crate) async fn open<S: StateMachine>(
    log_store: Arc<dyn LogStore>,
    observer: Option<ApplyObserver<S>>,
) -> Result<(LogCache<S>, StateMachineStore<S>), std::io::Error> {
    let (log, machine) = load_state::<S>(log_store.load().await?)?;
    let (covered_sender, covered) = watch::channel(Ok(machine.applied));
    let log = LogCache::new(Arc::clone(&log_store), log, covered);
    Ok((log, StateMachineStore::new(log_store, machine, covered_sender, observer)))
}

/// Decodes the contents of a log store: the log, and the state machine as of the last snapshot.
pub(crate) fn load_state<S: StateMachine>(
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
            .map(|(index, bytes)| Ok((*index, CachedEntry::stored(bytes)?)))
            .collect::<Result<_, std::io::Error>>()?,
    };
    check_continuity(&log)?;
    let mut machine =
        AppliedState { state: S::default(), applied: None, membership: StoredMembership::default(), snapshot: None };
    if let Some(bytes) = snapshot {
        let stored = StoredSnapshot::decode(&bytes)?;
        machine.restore(decode_record(&stored.state)?, stored);
    }
    if log.purged > machine.applied {
        let (purged, snapshot_end) = (position_text(log.purged.as_ref()), position_text(machine.applied.as_ref()));
        return Err(invalid_data(format!("the log begins after {purged}, but the snapshot ends with {snapshot_end}")));
    }
    Ok((log, machine))
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
    for (index, CachedEntry { log_id, .. }) in &log.entries {
        // `None` after the greatest possible index.
        let expected = last.map_or(Some(0), |last| last.index.checked_add(1));
        if Some(*index) != expected || log_id.index != *index || last >= Some(*log_id) {
            let (found, last) = (epoch_of(log_id), position_text(last.as_ref()));
            return Err(invalid_data(format!("the log has entry {found} at index {index}, directly after {last}")));
        }
        last = Some(*log_id);
    }
    Ok(())
}
