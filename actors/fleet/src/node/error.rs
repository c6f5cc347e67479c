//! Errors of starting and running a node.

use consort_bus::BusError;
use consort_raft::StartError;
use ractor::SpawnErr;

/// The node did not start. None of its parts runs.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// The bus is closed, or refused a key.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The local copy of the ledger could not be opened.
    #[error(transparent)]
    Ledger(#[from] StartError),
    /// An actor could not start.
    #[error("an actor could not start: {0}")]
    Actor(String),
}

impl From<SpawnErr> for NodeError {
    fn from(problem: SpawnErr) -> NodeError {
        NodeError::Actor(problem.to_string())
    }
}

/// The node has ended by itself, with the cause: an actor failed, or the copy of the ledger did.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct NodeEnded(pub String);
