//! Provenance of views and replies.

use crate::ids::NodeId;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Provenance of a view or reply.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Provenance {
    /// The node that replies.
    pub seen_by: NodeId,
    /// Age of its last beacon from the coordinator in milliseconds; 0 if it is the coordinator,
    /// null if it never received a beacon.
    pub age_ms: Option<u64>,
    /// The coordinator, as seen by this node; null if there is none.
    pub coordinator: Option<NodeId>,
    /// Term of the coordinator. Without a coordinator, the latest known term.
    #[serde(default)]
    pub term: u64,
    /// Time by the node's clock, in milliseconds since 1970.
    #[serde(default)]
    pub at_ms: u64,
    /// Version of the program.
    #[serde(default)]
    pub version: String,
    /// The copy of the ledger that was read; absent if the content comes from elsewhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ledger: Option<LedgerCopy>,
}

/// Copy of the ledger from which a view or reply was computed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct LedgerCopy {
    /// Number of the last entry of the ledger that the copy contains. It grows with every change.
    pub revision: u64,
    /// Staleness in milliseconds: the copy contains everything that was acknowledged at least that
    /// long ago, except for the delay of a message. 0 if the read is linearizable, null if the
    /// node has had no contact with a leader since its start.
    pub age_ms: Option<u64>,
    /// The copy contained everything that was acknowledged before the request.
    pub linearizable: bool,
}

/// A view or reply with its provenance, in a single object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WithProvenance<T> {
    /// Provenance.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// Content of the view.
    #[serde(flatten)]
    pub content: T,
}
