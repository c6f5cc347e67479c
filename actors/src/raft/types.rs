//! What is replicated, and the names that replication needs.

use super::log_store::StoreIdentity;
use super::runtime::SeededRuntime;
use consort_protocol::ids::{ClusterId, NodeId};
pub use consort_protocol::lease::Epoch;
use openraft::RaftTypeConfig;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
use std::fmt::{self, Debug};
use std::io::Cursor;
use std::marker::PhantomData;

/// A pure state machine: the same commands in the same order give the same state and outcomes on every node.
pub trait StateMachine: Clone + Send + Sync + Default + Serialize + DeserializeOwned + 'static {
    /// What may be asked of it.
    type Command: Serialize + DeserializeOwned + Clone + Debug + Send + Sync + 'static;
    /// What it answers, a refusal included.
    type Outcome: Serialize + DeserializeOwned + Clone + Debug + Send + Sync + 'static;

    /// Carries out `command`, which stands in the log at `at`. Neither clock nor chance may be asked.
    ///
    /// Several commands may stand at one place, in order, of which one [grants an epoch](StateMachine::grants_epoch) at
    /// most.
    fn apply(&mut self, at: Epoch, command: Self::Command) -> Self::Outcome;

    /// Whether what `command` does is told apart from all else by its place in the log. Without an answer, every command's
    /// is, and each gets an entry of its own: slower with many clients, and always right.
    fn grants_epoch(_command: &Self::Command) -> bool {
        true
    }

    /// Which founding of the fleet's ledger this state belongs to, once it says so. Replicas of different ones refuse one
    /// another's questions.
    fn cluster(&self) -> Option<ClusterId> {
        None
    }
}

/// What one entry of the log asks for, in order.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Batch<C>(pub(super) Vec<C>);

/// Who leads, and since which term. Each term has one leader at most, so that the term alone tells reigns apart and orders
/// them: the later one is the greater.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct LeaderId {
    /// The term.
    pub term: u64,
    /// Its leader.
    pub leader: RaftId,
}

impl fmt::Display for LeaderId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.term, self.leader)
    }
}

/// A voter or observer as Raft counts it: a node *together with* its store.
///
/// A node that comes back with an empty store has forgotten its vote. Under its old id it could vote twice in one
/// term, so it comes back under another.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct RaftId(pub u64);

impl RaftId {
    /// The id of `node` when it writes to the store called `store`.
    ///
    /// FNV-1a over name, a zero byte and the identity's bytes (big-endian), then the finaliser of splitmix64. It is
    /// part of the stored format: changing it makes every node a stranger to its fleet.
    pub fn of(node: &NodeId, store: StoreIdentity) -> RaftId {
        let bytes = node.as_str().bytes().chain([0]).chain(store.0.to_be_bytes());
        let folded = bytes
            .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3));
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

/// What the membership says of a raft id besides its number.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Peer {
    /// The node's name, so that people see names.
    pub name: NodeId,
}

impl Default for Peer {
    /// openraft asks for one; it is never stored.
    fn default() -> Self {
        Peer { name: NodeId::new("nobody").expect("a plain word is a valid name") }
    }
}

/// openraft's choice of types, for a state machine `S`.
pub(super) struct TypeConfig<S>(PhantomData<fn() -> S>);

impl<S: StateMachine> RaftTypeConfig for TypeConfig<S> {
    type D = Batch<S::Command>;
    /// `None` for the entries that are Raft's own.
    type R = Option<Vec<S::Outcome>>;
    type NodeId = RaftId;
    type Node = Peer;
    type Entry = openraft::Entry<Self>;
    type SnapshotData = Cursor<Vec<u8>>;
    type AsyncRuntime = SeededRuntime;
    type Responder = openraft::impls::OneshotResponder<Self>;
}

// By hand, since a derive would ask the same of `S`; openraft asks it of a type that has no values to speak of.
impl<S> Debug for TypeConfig<S> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Types")
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
pub(super) type Raft<S> = openraft::Raft<TypeConfig<S>>;

/// The place of an entry as the state machine sees it.
pub(super) fn epoch_of(log_id: &LogId) -> Epoch {
    Epoch { term: log_id.leader_id.term, index: log_id.index }
}

/// The reign that a vote is for.
pub(super) fn leader_id_of(vote: &Vote) -> Option<LeaderId> {
    let leader = vote.leader_id();
    Some(LeaderId { term: leader.term, leader: leader.voted_for? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_raft_id_is_that_of_the_node_and_its_store_and_stays_the_same_over_releases() {
        let ada = NodeId::new("ada").unwrap();
        let bob = NodeId::new("bob").unwrap();
        assert_eq!(RaftId::of(&ada, StoreIdentity(7)).to_string(), "ea8433db0a5b1aaf");
        assert_ne!(RaftId::of(&ada, StoreIdentity(7)), RaftId::of(&ada, StoreIdentity(8)));
        assert_ne!(RaftId::of(&ada, StoreIdentity(7)), RaftId::of(&bob, StoreIdentity(7)));
    }

    #[test]
    fn epochs_and_reigns_are_ordered_by_term_first() {
        assert!(Epoch { term: 1, index: 9 } < Epoch { term: 2, index: 1 });
        assert!(LeaderId { term: 2, leader: RaftId(2) } < LeaderId { term: 3, leader: RaftId(1) });
    }
}
