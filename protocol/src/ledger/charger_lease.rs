//! Lease of a charger, as the ledger stores it.

use crate::ids::RobotId;
use crate::lease::Epoch;
use serde::{Deserialize, Serialize};

/// Maximum encoded size of all leases in bytes: a thousand with names of usual length. Raised: a snapshot may be too large
/// for every replica.
pub(super) const CHARGER_LEASES_BYTES_MAX: usize = 48 * 1024;

/// Maximum encoded size of a lease with its charger in bytes: the names take up to 256 and 64 bytes.
pub(super) const CHARGER_LEASE_BYTES_MAX: usize = 384;

/// Lease of a charger to a robot. It has no end of its own: the coordinator ends it when the robot is done, is lost or
/// does not come.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChargerLease {
    /// The robot.
    pub robot: RobotId,
    /// Position of the grant in the log. Of two claims to a charger, that with the later lease prevails.
    pub epoch: Epoch,
    /// Time of the grant in milliseconds since 1970; 0 if it is unknown.
    pub since_ms: u64,
}
