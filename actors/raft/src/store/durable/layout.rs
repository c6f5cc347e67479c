//! Files of a data directory, and the owner of the store in it.

use consort_protocol::ids::{FleetId, NodeId};
use std::fmt;

/// File name of the ledger in a data directory.
pub const LEDGER_FILE: &str = "ledger.redb";

/// File name of the ledger's commit marker, in the same directory.
pub const COMMIT_MARKER_FILE: &str = "ledger.seal";

/// File name of the lock, in the same directory.
pub(super) const LOCK_FILE: &str = "lock";

/// Owner of the store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoreOwner {
    /// Fleet.
    pub fleet: FleetId,
    /// Node of the fleet.
    pub node: NodeId,
}

impl fmt::Display for StoreOwner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "node {} of fleet {}", self.node, self.fleet)
    }
}
