//! View of the coordinator and the voters.

use crate::ids::{ClusterId, NodeId};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The coordinator and the voters of the ledger, as seen by the node that replies.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct CoordinatorView {
    /// The coordinator; null if there is none.
    pub node: Option<NodeId>,
    /// Duration of its session in milliseconds.
    pub since_ms: Option<u64>,
    /// Time since a majority last acknowledged the replying node, in milliseconds; null unless it
    /// leads.
    pub quorum_age_ms: Option<u64>,
    /// Voters of the ledger.
    pub voters: Vec<NodeId>,
    /// Voters that are gone, or that came back with an empty store.
    pub voters_lost: Vec<NodeId>,
    /// Learners of the ledger; known only to its voters.
    pub learners: Vec<NodeId>,
    /// Cluster of the node that replies; null if it belongs to none yet.
    pub cluster: Option<ClusterId>,
    /// Other clusters with the name of this fleet, each with a node of it.
    pub foreign: BTreeMap<ClusterId, NodeId>,
    /// Status of the autopilot; null unless the replying node is the coordinator.
    pub autopilot: Option<AutopilotView>,
}

/// Status of the autopilot.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct AutopilotView {
    /// Number of voters that it aims for.
    pub target_voters: usize,
    /// True if a change of the membership is under way.
    pub change_in_progress: bool,
    /// Its latest completed change; null if there was none in this session.
    pub latest_change: Option<VoterChange>,
}

/// A completed change of the ledger's membership.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct VoterChange {
    /// Reason, as text.
    pub reason: String,
    /// Time since the change, in milliseconds.
    pub age_ms: u64,
}
