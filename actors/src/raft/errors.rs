//! Why a replica did not do what it was asked to do.

use super::settings::RaftSettingsError;
use super::types::{Peer, RaftId};
use crate::bus::BusError;
use consort_protocol::ids::NodeId;
use openraft::error::{ChangeMembershipError, ClientWriteError, Fatal, ForwardToLeader, RaftError};
use std::time::Duration;

/// Why a node could not take part. Nothing runs.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// Our own mistake, or that of the configuration.
    #[error(transparent)]
    Settings(#[from] RaftSettingsError),
    /// The journal cannot be read, is not whole, or is of another release.
    #[error("the journal in {location} cannot be taken up: {problem}")]
    LogStore {
        /// Where it is.
        location: String,
        /// What is wrong.
        problem: std::io::Error,
    },
    /// The bus is closed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// What openraft says of the stored state.
    #[error("the stored state cannot be taken up: {0}")]
    Raft(#[from] Fatal<RaftId>),
}

/// Why the fleet's first voters were not written down. Nothing was changed.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum BootstrapError {
    /// Ordinary: this was done before, or a leader has been here already.
    #[error("this node already belongs to a fleet")]
    AlreadyBootstrapped,
    /// Our own mistake.
    #[error("{0} is not among the first voters")]
    NotMember(RaftId),
    /// The replica has stopped.
    #[error("the replica has stopped")]
    Closed,
}

/// Why a command was not acknowledged. Only after [`ProposeError::TimedOut`] is it open what became of it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ProposeError {
    /// Ordinary. It was not proposed here, or was replaced by another leader's entry: it will not happen by this
    /// call.
    #[error("the leader is {}", leader.as_ref().map_or("unknown", NodeId::as_str))]
    NotLeader {
        /// Whom to ask instead, as far as this node knows.
        leader: Option<NodeId>,
    },
    /// This node was elected but hears no majority. It was not proposed.
    #[error("no quorum: {reachable} of {voters} voters reachable")]
    NoQuorum {
        /// Voters that answered something sent within the last two heartbeats, this one included.
        reachable: usize,
        /// All voters.
        voters: usize,
    },
    /// It was proposed and is not committed yet. **Its outcome is unknown**: it may yet be committed, now or by the
    /// next leader. Look for its effect in the ledger, or propose something that may happen twice.
    #[error("not committed within {limit:?}: whether it will be is unknown")]
    TimedOut {
        /// The time it was given.
        limit: Duration,
    },
    /// Our own mistake, or a mission of absurd size. It was not proposed.
    #[error("a command of {size} bytes exceeds the {max} that one message may carry")]
    TooLarge {
        /// Its encoded size.
        size: usize,
        /// The limit.
        max: usize,
    },
    /// It cannot be written down; our own mistake. It was not proposed.
    #[error("the command cannot be encoded: {0}")]
    Unencodable(String),
    /// The replica has stopped, on request or because its journal failed. After a failure the outcome is unknown.
    #[error("the replica has stopped")]
    Closed,
}

/// Why the membership was not changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MemberError {
    /// As for any other entry of the log; after [`ProposeError::TimedOut`] the change may yet happen.
    #[error(transparent)]
    Propose(#[from] ProposeError),
    /// An earlier change is not committed yet. Nothing was changed; try again later.
    #[error("another change of membership is under way")]
    InProgress,
    /// Our own mistake: a voter must be an observer first. Nothing was changed.
    #[error("{0} is no observer")]
    NotLearner(RaftId),
    /// Our own mistake: somebody must vote. Nothing was changed.
    #[error("no voters would be left")]
    NoVotersLeft,
}

/// Why a leader goes without a successor.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TransferError {
    /// Ordinary: there is nothing to hand over.
    #[error("this node does not lead")]
    NotLeader,
    /// When this node goes, so does the ledger, until it comes back.
    #[error("this node is the only voter: nobody can take over")]
    OnlyVoter,
    /// This node leads on. Ordinary where the others are dead already, or too far behind.
    #[error("none of the other {others} voters had the whole ledger within {limit:?}")]
    NoTargetReady {
        /// How many there are.
        others: usize,
        /// How long was waited for one.
        limit: Duration,
    },
    /// This node no longer leads; the others elect one of them when their patience ends.
    #[error("{target} was to take over and does not answer")]
    TargetSilent {
        /// Who should have.
        target: NodeId,
    },
    /// The replica has stopped.
    #[error("the replica has stopped")]
    Closed,
}

pub(super) fn not_leader(other: ForwardToLeader<RaftId, Peer>) -> ProposeError {
    ProposeError::NotLeader { leader: other.leader_node.map(|peer| peer.name) }
}

pub(super) fn member_error(error: RaftError<RaftId, ClientWriteError<RaftId, Peer>>) -> MemberError {
    match error {
        RaftError::APIError(ClientWriteError::ForwardToLeader(other)) => not_leader(other).into(),
        RaftError::APIError(ClientWriteError::ChangeMembershipError(error)) => match error {
            ChangeMembershipError::InProgress(_) => MemberError::InProgress,
            ChangeMembershipError::EmptyMembership(_) => MemberError::NoVotersLeft,
            ChangeMembershipError::LearnerNotFound(missing) => MemberError::NotLearner(missing.node_id),
        },
        RaftError::Fatal(_) => ProposeError::Closed.into(),
    }
}

impl ProposeError {
    /// Why an entry of commands was not committed.
    pub(super) fn from_write(error: ClientWriteError<RaftId, Peer>) -> ProposeError {
        match member_error(RaftError::APIError(error)) {
            MemberError::Propose(error) => error,
            MemberError::InProgress | MemberError::NotLearner(_) | MemberError::NoVotersLeft => {
                unreachable!("openraft answers so to a change of membership only")
            }
        }
    }
}
