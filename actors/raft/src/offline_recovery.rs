//! Offline recovery: inspects the log store of a stopped node, and turns it into the log store of a
//! cluster's only voter. This is the last resort when a majority of the voters is lost for good.
//!
//! Raft itself must not continue then, because the entries acknowledged by the lost voters are
//! unknown. This operation treats the content of a single log store as complete. It may lack
//! entries (stored only by the other voters), and it may contain entries that were never committed.
//! So an operator decides on it, not a node.

use super::log_store::{PersistentState, StoreIdentity};
use super::storage::{self, AppliedState, StoredSnapshot, encode_record, snapshot_id};
use super::types::{Epoch, LogId, Peer, RaftId, SnapshotMeta, StateMachine, StoredMembership, Vote, epoch_of};
use consort_protocol::ids::NodeId;
use openraft::{CommittedLeaderId, Membership};
use std::collections::{BTreeMap, BTreeSet};
use std::io;

/// Contents of a log store.
#[derive(Debug, Clone)]
pub struct LogStoreContents<S> {
    /// Newest term in which the node voted, or of which it received a message.
    pub term: u64,
    /// Last entry.
    pub last: Option<Epoch>,
    /// Last entry known to be committed; later entries may be committed as well.
    pub committed: Option<Epoch>,
    /// Voters, according to the last membership entry.
    pub voters: BTreeMap<RaftId, NodeId>,
    /// State after all entries are applied.
    pub state: S,
}

/// A loaded log store with every entry applied.
struct ReplayedLog<S> {
    vote: Option<Vote>,
    committed: Option<LogId>,
    machine: AppliedState<S>,
}

fn replay<S: StateMachine>(stored: PersistentState) -> io::Result<ReplayedLog<S>> {
    let (log, mut machine) = storage::load_state::<S>(stored)?;
    // The entries covered by the snapshot are committed, even if the stored committed position
    // lags.
    let committed = log.committed.max(machine.applied);
    for cached in log.entries.values() {
        if machine.applied < Some(cached.log_id) {
            machine.apply_entry(cached.to_entry()?);
        }
    }
    Ok(ReplayedLog { vote: log.vote, committed, machine })
}

/// Returns the contents of a log store, without changing it.
///
/// # Errors
/// The log store is damaged, or was written by another release.
pub fn inspect_log_store<S: StateMachine>(stored: PersistentState) -> io::Result<LogStoreContents<S>> {
    let ReplayedLog { vote, committed, machine } = replay::<S>(stored)?;
    let membership = machine.membership.membership();
    let name = |id: RaftId| membership.get_node(&id).map(|peer| (id, peer.name.clone()));
    Ok(LogStoreContents {
        term: vote.map_or(0, |vote| vote.leader_id().term),
        last: machine.applied.as_ref().map(epoch_of),
        committed: committed.as_ref().map(epoch_of),
        voters: membership.voter_ids().filter_map(name).collect(),
        state: machine.state,
    })
}

/// Converts the log store of `node` with the store identity `store` into that of the only voter.
/// All its entries count as committed and become a single snapshot, which `change` may change. The
/// vote is kept, so the term never falls.
///
/// # Errors
/// The log store is damaged, was written by another release, or is empty.
pub fn recover_as_only_voter<S: StateMachine>(
    stored: PersistentState,
    node: &NodeId,
    store: StoreIdentity,
    change: impl FnOnce(&mut S),
) -> io::Result<PersistentState> {
    let vote = stored.vote.clone();
    let ReplayedLog { mut machine, .. } = replay::<S>(stored)?;
    let Some(last) = machine.applied else {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "the log store is empty: there is nothing to recover"));
    };
    change(&mut machine.state);
    let origin = format!("recovered-{}", epoch_of(&last));
    as_snapshot(&machine.state, last, vote, node, store, &origin)
}

/// Creates the log store of `node`, with the store identity `store`, as that of the only voter. It
/// contains `state`, up to the entry `last`, and nothing else.
///
/// # Errors
/// The state cannot be encoded.
pub(super) fn restore_as_only_voter<S: StateMachine>(
    state: &S,
    last: Epoch,
    node: &NodeId,
    store: StoreIdentity,
) -> io::Result<PersistentState> {
    let id = RaftId::of(node, store);
    let origin = format!("restored-{last}");
    let last = LogId::new(CommittedLeaderId::new(last.term, id), last.index);
    // Its term is not below the term of the restored state.
    let vote = encode_record(&Vote::new(last.leader_id.term, id))?;
    as_snapshot(state, last, Some(vote), node, store, &origin)
}

fn as_snapshot<S: StateMachine>(
    state: &S,
    last: LogId,
    vote: Option<Vec<u8>>,
    node: &NodeId,
    store: StoreIdentity,
    origin: &str,
) -> io::Result<PersistentState> {
    let id = RaftId::of(node, store);
    let members = BTreeMap::from([(id, Peer { name: node.clone() })]);
    let membership = Membership::new(vec![BTreeSet::from([id])], members);
    let state = encode_record(state)?;
    let meta = SnapshotMeta {
        last_log_id: Some(last),
        last_membership: StoredMembership::new(Some(last), membership),
        snapshot_id: snapshot_id(origin, store, &state),
    };
    let stored_snapshot = StoredSnapshot { meta, state };
    let last = encode_record(&last)?;
    Ok(PersistentState {
        vote,
        committed: Some(last.clone()),
        purged: Some(last),
        entries: BTreeMap::new(),
        snapshot: Some(encode_record(&stored_snapshot)?),
    })
}
