//! The trait of the replicated state machine, and the identifiers used by replication.

use super::log_store::StoreIdentity;
use super::runtime::SeededRuntime;
use consort_protocol::fnv::fnv1a;
use consort_protocol::ids::{ClusterId, NodeId};
pub use consort_protocol::lease::Epoch;
use openraft::RaftTypeConfig;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
use std::fmt::{self, Debug};
use std::io::Cursor;
use std::marker::PhantomData;

/// Deterministic state machine: the same commands in the same order give the same state and
/// outcomes on every node.
pub trait StateMachine: Clone + Send + Sync + Default + Serialize + DeserializeOwned + 'static {
    /// Command to the state machine.
    type Command: Serialize + DeserializeOwned + Clone + Debug + Send + Sync + 'static;
    /// Result of a command, including a rejection.
    type Outcome: Serialize + DeserializeOwned + Clone + Debug + Send + Sync + 'static;

    /// Applies `command`, which has the log position `at`. The result must not depend on a clock or
    /// on randomness.
    ///
    /// Several commands may share a position, in order. At most one of them
    /// [grants an epoch](StateMachine::grants_epoch).
    fn apply(&mut self, at: Epoch, command: Self::Command) -> Self::Outcome;

    /// Checks whether the effect of `command` is identified by its log position alone. The default
    /// is `true` for every command, so each command gets an entry of its own: slower with many
    /// clients, and always correct.
    fn grants_epoch(_command: &Self::Command) -> bool {
        true
    }

    /// Returns the cluster (the bootstrap of the fleet's ledger) that this state belongs to, once
    /// it is recorded. Replicas of different clusters reject each other's requests.
    fn cluster(&self) -> Option<ClusterId> {
        None
    }
}

/// Commands of a single log entry, in order.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Batch<C>(pub(super) Vec<C>);

/// Leader of a term. Each term has at most one leader, so the term alone identifies the leadership
/// and orders it: the later term is the greater value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct LeaderId {
    /// The term.
    pub term: u64,
    /// Leader of the term.
    pub leader: RaftId,
}

impl fmt::Display for LeaderId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.term, self.leader)
    }
}

/// Id of a voter or learner in Raft: a node *together with* its store.
///
/// A node that comes back with an empty store has lost its vote. Under its old id it could vote
/// twice in the same term, so it comes back under another id.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct RaftId(pub u64);

impl RaftId {
    /// Returns the id of `node` with the store `store`.
    ///
    /// FNV-1a over the name, a zero byte and the bytes of the identity (big-endian), then the
    /// finalizer of splitmix64. This is part of the stored format: a change of it would make every
    /// node a stranger to its fleet.
    pub fn of(node: &NodeId, store: StoreIdentity) -> RaftId {
        let bytes = node.as_str().bytes().chain([0]).chain(store.0.to_be_bytes());
        let folded = fnv1a(bytes);
        let mixed = (folded ^ (folded >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        RaftId(mixed ^ (mixed >> 31))
    }
}

impl fmt::Display for RaftId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

impl Debug for RaftId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "RaftId({self})")
    }
}

/// Data of a member in the Raft membership, in addition to its id.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Peer {
    /// Name of the node, for display.
    pub name: NodeId,
}

impl Default for Peer {
    /// Required by openraft; never stored.
    fn default() -> Self {
        Peer { name: NodeId::new("unknown").expect("\"unknown\" is a valid name") }
    }
}

/// Type configuration of openraft for a state machine `S`.
pub(super) struct TypeConfig<S>(PhantomData<fn() -> S>);

impl<S: StateMachine> RaftTypeConfig for TypeConfig<S> {
    type D = Batch<S::Command>;
    /// Outcomes of an entry; `None` for entries of Raft itself (blank, membership).
    type R = Option<Vec<S::Outcome>>;
    type NodeId = RaftId;
    type Node = Peer;
    type Entry = openraft::Entry<Self>;
    type SnapshotData = Cursor<Vec<u8>>;
    type AsyncRuntime = SeededRuntime;
    type Responder = openraft::impls::OneshotResponder<Self>;
}

// Implemented by hand: a derive would require the same traits of `S`. openraft requires them of
// this type, which has no values.
impl<S> Debug for TypeConfig<S> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("TypeConfig")
    }
}
impl<S> Clone for TypeConfig<S> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<S> Copy for TypeConfig<S> {}
impl<S> Default for TypeConfig<S> {
    fn default() -> Self {
        TypeConfig(PhantomData)
    }
}
impl<S> PartialEq for TypeConfig<S> {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}
impl<S> Eq for TypeConfig<S> {}
impl<S> PartialOrd for TypeConfig<S> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl<S> Ord for TypeConfig<S> {
    fn cmp(&self, _: &Self) -> Ordering {
        Ordering::Equal
    }
}

pub(super) type LogId = openraft::LogId<RaftId>;
pub(super) type Vote = openraft::Vote<RaftId>;
pub(super) type StorageError = openraft::StorageError<RaftId>;
pub(super) type StorageIOError = openraft::StorageIOError<RaftId>;
pub(super) type StoredMembership = openraft::StoredMembership<RaftId, Peer>;
pub(super) type SnapshotMeta = openraft::SnapshotMeta<RaftId, Peer>;
pub(super) type Metrics = openraft::RaftMetrics<RaftId, Peer>;
pub(super) type Raft<S> = openraft::Raft<TypeConfig<S>>;

/// Returns the position of an entry in the form used by the state machine.
pub(super) fn epoch_of(log_id: &LogId) -> Epoch {
    Epoch { term: log_id.leader_id.term, index: log_id.index }
}

/// Returns the leader that a vote is for.
pub(super) fn leader_id_of(vote: &Vote) -> Option<LeaderId> {
    let leader = vote.leader_id();
    Some(LeaderId { term: leader.term, leader: leader.voted_for? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_raft_id_depends_on_node_and_store_only() {
        let ada = NodeId::new("ada").unwrap();
        let bob = NodeId::new("bob").unwrap();
        assert_eq!(RaftId::of(&ada, StoreIdentity(7)).to_string(), "ea8433db0a5b1aaf");
        assert_ne!(RaftId::of(&ada, StoreIdentity(7)), RaftId::of(&ada, StoreIdentity(8)));
        assert_ne!(RaftId::of(&ada, StoreIdentity(7)), RaftId::of(&bob, StoreIdentity(7)));
    }

    #[test]
    fn epochs_and_leader_ids_are_ordered_by_term_first() {
        assert!(Epoch { term: 1, index: 9 } < Epoch { term: 2, index: 1 });
        assert!(LeaderId { term: 2, leader: RaftId(2) } < LeaderId { term: 3, leader: RaftId(1) });
    }
}
