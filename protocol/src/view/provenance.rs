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
