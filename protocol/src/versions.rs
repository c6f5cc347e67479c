//! Wire versions: the layouts of messages and commands that a program reads and writes, and the
//! upgrade of a running fleet to the next version.
//!
//! A program reads a range of versions ([`VersionRange::OWN`]) and publishes the range in its
//! node's record. It *writes* the version of the fleet, which is stored in the ledger and in every
//! [`Beacon`](crate::message::Beacon); until it receives a later version, it writes the oldest
//! version that it reads, and with certificates no version before 2, which has signed records. The
//! ledger's version is raised by a single step, once, after every known node reads the next version.
//! So no node ever receives a message that it cannot read, and up to that moment each node can return
//! to its previous program. A node with a program that does not read the fleet's version stops.
//!
//! The first byte of a message is the version in which its layout was introduced
//! ([`codec`](crate::codec)): most layouts are the same in all versions.

use crate::ids::NodeId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// What the records of the known voters state of a wire version.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VersionEvidence {
    /// At least 2 voters, and at least half of them, read it.
    Confirmed,
    /// Most voters cannot read it.
    Refuted,
    /// Fewer than 2 voters are known to read it.
    Unknown,
}

/// Range of wire versions that a node reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct VersionRange {
    /// Oldest version.
    pub oldest: u8,
    /// Newest version, which the program prefers to write.
    pub newest: u8,
}

impl VersionRange {
    /// Versions of this program.
    pub const OWN: VersionRange = VersionRange { oldest: 1, newest: 3 };

    /// Returns the range without the versions above `newest`, as an earlier release reads it.
    #[must_use]
    pub fn up_to(self, newest: u8) -> VersionRange {
        VersionRange { newest: self.newest.min(newest), ..self }
    }

    /// Checks whether the range contains this version.
    pub fn contains(self, version: u8) -> bool {
        (self.oldest..=self.newest).contains(&version)
    }
}

impl fmt::Display for VersionRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.oldest == self.newest {
            true => write!(f, "{}", self.newest),
            false => write!(f, "{} to {}", self.oldest, self.newest),
        }
    }
}

/// Status of an upgrade to the next version.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum UpgradeStatus {
    /// The coordinator's program reads no later version.
    Newest,
    /// Every node reads the next version.
    Ready {
        /// Next version.
        next: u8,
    },
    /// Some nodes do not read the next version, or have no record.
    Blocked {
        /// Next version.
        next: u8,
        /// These nodes, and the versions that they read if known.
        behind: BTreeMap<NodeId, Option<VersionRange>>,
    },
}

impl UpgradeStatus {
    /// Computes whether a fleet that writes version `now` may switch to the next version, according
    /// to a coordinator with a program that reads `own`. `known` are the versions that the nodes
    /// with a record read. All of them count, including nodes that are down, since they may return.
    /// All nodes in `required` count, with or without a record.
    pub fn of(
        now: u8,
        own: VersionRange,
        required: impl IntoIterator<Item = NodeId>,
        known: impl IntoIterator<Item = (NodeId, VersionRange)>,
    ) -> UpgradeStatus {
        let next = now.saturating_add(1);
        if !own.contains(next) {
            return UpgradeStatus::Newest;
        }
        let mut all: BTreeMap<NodeId, Option<VersionRange>> = required.into_iter().map(|node| (node, None)).collect();
        all.extend(known.into_iter().map(|(node, versions)| (node, Some(versions))));
        all.retain(|_, versions| !versions.is_some_and(|versions| versions.contains(next)));
        match all.is_empty() {
            true => UpgradeStatus::Ready { next },
            false => UpgradeStatus::Blocked { next, behind: all },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    fn node(name: &str) -> NodeId {
        NodeId::new(name).unwrap()
    }

    const OLD: VersionRange = VersionRange { oldest: 1, newest: 1 };
    const NEW: VersionRange = VersionRange { oldest: 1, newest: 2 };

    #[test]
    fn a_fleet_is_ready_when_every_node_reads_the_next_version() {
        let of = |now, own, required: &[&str], nodes: &[(&str, VersionRange)]| {
            let known = nodes.iter().map(|(name, versions)| (node(name), *versions));
            UpgradeStatus::of(now, own, required.iter().map(|name| node(name)), known)
        };
        let blocked = |behind: &[(&str, Option<VersionRange>)]| UpgradeStatus::Blocked {
            next: 2,
            behind: behind.iter().map(|(name, versions)| (node(name), *versions)).collect(),
        };
        assert_eq!(of(1, NEW, &["ada"], &[("ada", NEW), ("bob", NEW)]), UpgradeStatus::Ready { next: 2 });
        assert_eq!(of(1, NEW, &[], &[("ada", NEW), ("bob", OLD)]), blocked(&[("bob", Some(OLD))]));
        assert_eq!(of(1, NEW, &["ada", "cyd"], &[("ada", NEW)]), blocked(&[("cyd", None)]));
        // A jump of two versions would exclude nodes that read only the next version.
        let far = VersionRange { oldest: 2, newest: 3 };
        assert_eq!(of(1, far, &[], &[("ada", far)]), UpgradeStatus::Ready { next: 2 });
        assert_eq!(of(2, NEW, &[], &[("ada", NEW)]), UpgradeStatus::Newest);
        assert_eq!(of(1, OLD, &[], &[("ada", NEW)]), UpgradeStatus::Newest);
        assert_eq!(of(u8::MAX, NEW, &[], &[]), UpgradeStatus::Newest);
    }
}
