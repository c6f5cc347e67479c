//! A journal looked at from outside, and made that of a fleet's only voter: what is left to do when a majority of the
//! voters is gone for good.
//!
//! Raft itself can do nothing then, and must not: nobody knows what the others had acknowledged. Whoever does this takes
//! what this one journal holds for the whole truth. That may be too little (entries that only the others held) and too
//! much (entries that were never committed), so people decide it, not nodes.

use super::log_store::{PersistentState, StoreIdentity};
use super::storage::{self, AppliedState, CachedEntry, StoredSnapshot, encode_record};
use super::types::{Epoch, LogId, Peer, RaftId, SnapshotMeta, StateMachine, StoredMembership, Vote, epoch_of};
use consort_protocol::ids::NodeId;
use openraft::{CommittedLeaderId, Membership};
use std::collections::{BTreeMap, BTreeSet};
use std::io;

/// What a journal holds.
#[derive(Debug, Clone)]
pub struct LogStoreContents<S> {
    /// The newest term that the node voted in or heard of.
    pub term: u64,
    /// The last entry.
    pub last: Option<Epoch>,
    /// The last entry that is known to be committed; later ones may be as well.
    pub committed: Option<Epoch>,
    /// Who votes, by the last entry.
    pub voters: BTreeMap<RaftId, NodeId>,
    /// The state, all entries carried out.
    pub state: S,
}

/// A journal as it was read, every entry carried out.
struct Unfolded<S> {
    vote: Option<Vote>,
    committed: Option<LogId>,
    machine: AppliedState<S>,
}

fn unfold<S: StateMachine>(recorded: PersistentState) -> io::Result<Unfolded<S>> {
    let (log, mut machine) = storage::load_state::<S>(recorded)?;
    // What the snapshot holds is committed, whatever was noted since.
    let committed = log.committed.max(machine.applied);
    for (_, CachedEntry { entry, .. }) in log.entries {
        if machine.applied < Some(entry.log_id) {
            machine.apply_entry(entry);
        }
    }
    Ok(Unfolded { vote: log.vote, committed, machine })
}

/// What a journal holds, looked at and left as it is.
///
/// # Errors
/// The journal is not whole, or of another release.
pub fn inspect_log_store<S: StateMachine>(recorded: PersistentState) -> io::Result<LogStoreContents<S>> {
    let Unfolded { vote, committed, machine } = unfold::<S>(recorded)?;
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

/// The journal of `node`, whose store is called `store`, as that of the only voter: all that it holds counts as committed,
/// as one snapshot, which `renew` may change. Its vote stays: its term never falls.
///
/// # Errors
/// The journal is not whole, of another release, or holds nothing at all.
pub fn recover_as_only_voter<S: StateMachine>(
    recorded: PersistentState,
    node: &NodeId,
    store: StoreIdentity,
    renew: impl FnOnce(&mut S),
) -> io::Result<PersistentState> {
    let vote = recorded.vote.clone();
    let Unfolded { mut machine, .. } = unfold::<S>(recorded)?;
    let Some(last) = machine.applied else {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "it holds no entry: there is nothing to recover"));
    };
    renew(&mut machine.state);
    let snapshot = format!("recovered-{}@{:032x}", epoch_of(&last), store.0);
    as_snapshot(&machine.state, last, vote, RaftId::of(node, store), node, snapshot)
}

/// The journal of `node`, whose store is called `store`, which holds `state` up to the entry `last` and nothing else, as that of
/// the only voter.
///
/// # Errors
/// The state cannot be written.
pub fn restore_as_only_voter<S: StateMachine>(
    state: &S,
    last: Epoch,
    node: &NodeId,
    store: StoreIdentity,
) -> io::Result<PersistentState> {
    let id = RaftId::of(node, store);
    let snapshot = format!("restored-{last}@{:032x}", store.0);
    let last = LogId::new(CommittedLeaderId::new(last.term, id), last.index);
    // Its term does not fall behind that of what it holds.
    let vote = encode_record(&Vote::new(last.leader_id.term, id))?;
    as_snapshot(state, last, Some(vote), id, node, snapshot)
}

fn as_snapshot<S: StateMachine>(
    state: &S,
    last: LogId,
    vote: Option<Vec<u8>>,
    id: RaftId,
    node: &NodeId,
    snapshot_id: String,
) -> io::Result<PersistentState> {
    let members = BTreeMap::from([(id, Peer { name: node.clone() })]);
    let membership = Membership::new(vec![BTreeSet::from([id])], members);
    let meta = SnapshotMeta {
        last_log_id: Some(last),
        last_membership: StoredMembership::new(Some(last), membership),
        snapshot_id,
    };
    let kept = StoredSnapshot { meta, state: encode_record(state)? };
    let last = encode_record(&last)?;
    Ok(PersistentState {
        vote,
        committed: Some(last.clone()),
        purged: Some(last),
        entries: BTreeMap::new(),
        snapshot: Some(encode_record(&kept)?),
    })
}
