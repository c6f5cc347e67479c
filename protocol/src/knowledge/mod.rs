//! Knowledge of nodes about each other: a versioned record per node, written by that node alone.
//!
//! Records are ordered by their owner's *incarnation* (grows with each start of the node) and
//! *version* (grows with each change). Merging keeps the later record, so merging is commutative,
//! associative and idempotent. Records may arrive over any path, in any order, any number of times
//! (a state-based CRDT: Shapiro et al. 2011).

mod attributes;
mod base;
mod content;
mod devices;
mod digest;
mod motion;
mod record;

pub use attributes::Attributes;
pub use base::{KnowledgeBase, KnownRecord};
pub use content::{AWAITED_MAX, Availability, ChargerClaim, Charging, DOMAINS_MAX, Knowledge, RobotKnowledge};
pub use devices::{DeviceClaim, DeviceClaims, DeviceKnowledge, DeviceReport, DeviceState};
pub use digest::{Digest, DigestScope};
pub use motion::{Motion, MotionUpdate};
pub use record::{Proof, Record, RecordStamp};

#[cfg(test)]
mod tests;
