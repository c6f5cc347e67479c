//! Who coordinates and who keeps the ledger, as one node believes.

use crate::api_types::Provenance;
use consort_protocol::ids::NodeId;
use serde_json::Value;

/// What a coordinator knows of its own reign.
#[derive(Debug, Clone)]
pub struct CoordinatorStatus {
    /// Its term.
    pub term: u64,
    /// How long it has coordinated, in milliseconds.
    pub since_ms: u64,
    /// What its autopilot is about.
    pub autopilot: Value,
}

/// What a node believes, at one moment.
#[derive(Debug, Clone, Default)]
pub(super) struct ClusterStatus {
    /// Who coordinates, if anybody does.
    pub(super) coordinator: Option<NodeId>,
    /// In which term; if nobody does, the latest that was heard of.
    pub(super) term: u64,
    /// For how long, in milliseconds.
    pub(super) since_ms: Option<u64>,
    /// How long ago there was word from a coordinator, in milliseconds; `None` for never.
    pub(super) age_ms: Option<u64>,
    /// Who keeps the ledger.
    pub(super) voters: Vec<NodeId>,
    /// Those of them that are not there any more, or came back with an empty store.
    pub(super) voters_lost: Vec<NodeId>,
    /// Who follows the ledger without a vote; known to its keepers alone.
    pub(super) observers: Vec<NodeId>,
    /// Whether this node has the ledger.
    pub(super) has_ledger: bool,
    /// How long ago a majority last acknowledged this node, in milliseconds, if it coordinates.
    pub(super) quorum_age_ms: Option<u64>,
    /// What its autopilot is about, if it coordinates.
    pub(super) autopilot: Option<Value>,
}

impl ClusterStatus {
    /// What an answer is marked with, at a time since 1970.
    pub(super) fn provenance(&self, node: &NodeId, at_ms: u64) -> Provenance {
        Provenance {
            seen_by: node.to_string(),
            age_ms: self.age_ms,
            coordinator: self.coordinator.as_ref().map(NodeId::to_string),
            term: self.term,
            at_ms,
            version: env!("CARGO_PKG_VERSION").to_owned(),
        }
    }
}
