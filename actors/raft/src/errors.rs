//! Errors of a replica.

use super::settings::RaftSettingsError;
use super::types::{Peer, RaftId};
use consort_bus::BusError;
use consort_protocol::ids::NodeId;
use openraft::error::{ChangeMembershipError, ClientWriteError, Fatal, ForwardToLeader, RaftError};
use std::time::Duration;

/// The replica was not started. Nothing runs.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// A bug, or a mistake in the configuration.
    #[error(transparent)]
    Settings(#[from] RaftSettingsError),
    /// The log store cannot be read, is damaged, or was written by another release.
    #[error("the log store in {location} cannot be opened: {problem}")]
    LogStore {
        /// Location of the log store.
        location: String,
        /// Cause.
        problem: std::io::Error,
    },
    /// The bus is closed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// openraft rejected the stored state.
    #[error("the stored state cannot be loaded: {0}")]
    Raft(#[from] Fatal<RaftId>),
}

/// The cluster was not bootstrapped. Nothing was changed.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum BootstrapError {
    /// Expected: the cluster was bootstrapped before, or a leader has contacted this node already.
    #[error("this node is already a member of a cluster")]
    AlreadyBootstrapped,
    /// A bug in the caller.
    #[error("{0} is not among the first voters")]
    NotMember(RaftId),
    /// The replica has stopped.
    #[error("the replica has stopped")]
    Closed,
}

/// The command was not acknowledged. Only after [`ProposeError::TimedOut`] its outcome is unknown.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ProposeError {
    /// Expected. The command was not proposed here, or its entry was replaced by the entry of
    /// another leader: this call will not take effect.
    #[error("the leader is {}", leader.as_ref().map_or("unknown", NodeId::as_str))]
    NotLeader {
        /// The leader, as far as this node knows.
        leader: Option<NodeId>,
    },
    /// This node is the elected leader, but no majority replies. The command was not proposed.
    #[error("no quorum: {reachable} of {voters} voters reachable")]
    NoQuorum {
        /// Voters that replied to a message sent within the last two heartbeat intervals, including
        /// this node.
        reachable: usize,
        /// Total number of voters.
        voters: usize,
    },
    /// The command was proposed and is not committed yet. **Its outcome is unknown**: it may still
    /// be committed, by this leader or the next. Look for its effect in the ledger, or propose a
    /// command that may be applied twice.
    #[error("not committed within {limit:?}: the outcome is unknown")]
    TimedOut {
        /// Time limit of the call.
        limit: Duration,
    },
    /// A bug in the caller, or an absurdly large mission. The command was not proposed.
    #[error("a command of {size} bytes exceeds the limit of {max} bytes per message")]
    TooLarge {
        /// Encoded size of the command, in bytes.
        size: usize,
        /// Limit, in bytes.
        max: usize,
    },
    /// The command cannot be encoded; a bug. It was not proposed.
    #[error("the command cannot be encoded: {0}")]
    Unencodable(String),
    /// The replica has stopped, on request or because its log store failed. After a failure the
    /// outcome is unknown.
    #[error("the replica has stopped")]
    Closed,
}

/// The membership was not changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MemberError {
    /// The same errors as for any other entry of the log. After [`ProposeError::TimedOut`] the
    /// change may still happen.
    #[error(transparent)]
    Propose(#[from] ProposeError),
    /// An earlier change is not committed yet. Nothing was changed; try again later.
    #[error("another membership change is in progress")]
    InProgress,
    /// A bug in the caller: a voter must be a learner first. Nothing was changed.
    #[error("{0} is not a learner")]
    NotLearner(RaftId),
    /// A bug in the caller: there must be a voter. Nothing was changed.
    #[error("no voters would be left")]
    NoVotersLeft,
}

/// The leadership was not transferred.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TransferError {
    /// Expected: there is nothing to transfer.
    #[error("this node is not the leader")]
    NotLeader,
    /// The ledger is unavailable while this node is stopped.
    #[error("this node is the only voter: there is no other voter to become leader")]
    OnlyVoter,
    /// This node stays the leader. Expected when the other voters are dead, or too far behind.
    #[error("none of the other {others} voters had the whole ledger within {limit:?}")]
    NoTargetReady {
        /// Number of other voters.
        others: usize,
        /// Time that was waited.
        limit: Duration,
    },
    /// This node no longer leads; the other voters elect a leader after their election timeouts.
    #[error("leadership was transferred to {target}, which does not reply")]
    TargetSilent {
        /// Voter that was to take over.
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
    /// Converts the error of an entry of commands.
    pub(super) fn from_write(error: ClientWriteError<RaftId, Peer>) -> ProposeError {
        match member_error(RaftError::APIError(error)) {
            MemberError::Propose(error) => error,
            MemberError::InProgress | MemberError::NotLearner(_) | MemberError::NoVotersLeft => {
                unreachable!("openraft returns these errors for membership changes only")
            }
        }
    }
}
