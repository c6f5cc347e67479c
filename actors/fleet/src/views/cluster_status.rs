//! Cluster status: coordinator and voters as seen by a single node.

use consort_protocol::ids::NodeId;
use consort_protocol::view::{AutopilotView, Provenance};

/// View of the cluster at a single moment.
#[derive(Debug, Clone, Default)]
pub(super) struct ClusterStatus {
    /// The coordinator, if there is any.
    pub(super) coordinator: Option<NodeId>,
    /// Its term. Without a coordinator, the latest known term.
    pub(super) term: u64,
    /// Duration of its session in milliseconds.
    pub(super) since_ms: Option<u64>,
    /// Age of the last beacon in milliseconds; `None` if there never was any.
    pub(super) age_ms: Option<u64>,
    /// Voters of the ledger.
    pub(super) voters: Vec<NodeId>,
    /// Voters that are gone, or that came back with an empty store.
    pub(super) voters_lost: Vec<NodeId>,
    /// Learners of the ledger, which have no vote; known only to its voters.
    pub(super) learners: Vec<NodeId>,
    /// This node has an up-to-date copy of the ledger.
    pub(super) has_ledger: bool,
    /// Time since a majority last acknowledged this node, in milliseconds, if it is the
    /// coordinator.
    pub(super) quorum_age_ms: Option<u64>,
    /// Status of its autopilot, if this node is the coordinator.
    pub(super) autopilot: Option<AutopilotView>,
}

impl ClusterStatus {
    /// Returns the provenance of a reply at `at_ms` (milliseconds since 1970).
    pub(super) fn provenance(&self, node: &NodeId, at_ms: u64) -> Provenance {
        Provenance {
            seen_by: node.clone(),
            age_ms: self.age_ms,
            coordinator: self.coordinator.clone(),
            term: self.term,
            at_ms,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            ledger: None,
        }
    }
}
