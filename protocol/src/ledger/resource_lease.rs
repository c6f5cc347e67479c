//! Lease of a charger or a device, as the ledger stores it.

use crate::ids::{DeviceId, PlaceId, RobotId};
use crate::lease::Epoch;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Maximum encoded size of all leases in bytes: a thousand with names of usual length. Raised: a snapshot may be too large
/// for every replica.
pub(super) const RESOURCE_LEASES_BYTES_MAX: usize = 48 * 1024;

/// Maximum encoded size of a lease with its resource in bytes: the names take up to 256 and 64 bytes.
pub(super) const RESOURCE_LEASE_BYTES_MAX: usize = 384;

/// A charger or a device: a single robot at a time uses it.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Resource {
    /// The charger at a place. A robot has the lease of at most one.
    Charger(PlaceId),
    /// A door, a lift or another device of the building.
    Device(DeviceId),
}

impl Resource {
    /// Checks whether a robot has the lease of at most one resource of the kind of both.
    pub(super) fn excludes(&self, other: &Resource) -> bool {
        matches!((self, other), (Resource::Charger(_), Resource::Charger(_)))
    }
}

impl fmt::Display for Resource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Resource::Charger(place) => place.fmt(f),
            Resource::Device(device) => device.fmt(f),
        }
    }
}

/// Lease of a resource to a robot. It has no end of its own: the coordinator ends it when the robot is done, is lost or
/// does not come.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ResourceLease {
    /// The robot.
    pub robot: RobotId,
    /// Position of the grant in the log. Of two claims to a resource, that with the later lease prevails.
    pub epoch: Epoch,
    /// Time of the grant in milliseconds since 1970; 0 if it is unknown.
    pub since_ms: u64,
}
