//! View of the audit trail.

use super::readable;
use crate::ledger::AuditEntry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The audit trail: the latest changes that people have requested.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AuditView {
    /// Entries in their order. The fleet keeps the latest 2000, and at most 256 KiB.
    #[serde(deserialize_with = "readable")]
    pub entries: Vec<AuditEntry>,
}
