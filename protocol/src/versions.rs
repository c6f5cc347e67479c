//! Versions of the wire: which layouts of messages and commands a program reads and writes, and how a fleet goes from one
//! version to the next while it works.
//!
//! A program reads some neighbouring versions ([`Versions::OWN`]) and says so in its node's knowledge. What it *writes* is of the
//! fleet's version, which stands in the ledger and in every [`Beacon`](crate::message::Beacon): the oldest that it reads until it
//! has heard of a later one. The ledger's version is raised by one step, once, after every node that is known reads the next; so
//! nobody is ever sent what it cannot read, and up to that moment each node can go back to the program that it came from. A node
//! whose program does not read the fleet's version has no place in it, and ends.
//!
//! The first byte of a message is the version in which its layout came ([`codec`](crate::codec)): most are the same in all.

use crate::ids::NodeId;
use crate::knowledge::KnowledgeBase;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// Which versions of the wire a program reads: all from one to another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct VersionRange {
    /// The oldest.
    pub oldest: u8,
    /// The newest, which it would rather write.
    pub newest: u8,
}

impl VersionRange {
    /// Those of this program.
    pub const OWN: VersionRange = VersionRange { oldest: 1, newest: 2 };

    /// Whether this version is one of them.
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

/// How far a fleet is on its way to the next version.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum UpgradeStatus {
    /// The coordinator's program reads none later.
    Newest,
    /// Every node reads the next one.
    Ready {
        /// The next version.
        next: u8,
    },
    /// Some do not, or nothing is known of them.
    Blocked {
        /// The next version.
        next: u8,
        /// Who, and what they read as far as is known.
        behind: BTreeMap<NodeId, Option<VersionRange>>,
    },
}

impl UpgradeStatus {
    /// Whether a fleet that writes version `now` may go on to the next, as far as a coordinator whose program reads `own` knows.
    /// Everybody counts of whom something is known, be he down: he may come back. So does whoever is `needed`, known or not.
    pub fn of(
        now: u8,
        own: VersionRange,
        needed: impl IntoIterator<Item = NodeId>,
        base: &KnowledgeBase,
    ) -> UpgradeStatus {
        let next = now.saturating_add(1);
        if !own.contains(next) {
            return UpgradeStatus::Newest;
        }
        let known = base.iter().map(|(node, heard)| (node.clone(), Some(heard.record.knowledge.supported_versions)));
        let mut all: BTreeMap<NodeId, Option<VersionRange>> = needed.into_iter().map(|node| (node, None)).collect();
        all.extend(known);
        all.retain(|_, speaks| !speaks.is_some_and(|speaks| speaks.contains(next)));
        match all.is_empty() {
            true => UpgradeStatus::Ready { next },
            false => UpgradeStatus::Blocked { next, behind: all },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::knowledge::{Knowledge, Record, RecordStamp};
    use crate::units::NodeTime;

    fn node(name: &str) -> NodeId {
        NodeId::new(name).unwrap()
    }

    fn base(nodes: &[(&str, VersionRange)]) -> KnowledgeBase {
        let mut base = KnowledgeBase::default();
        for (name, speaks) in nodes {
            let knowledge = Knowledge {
                may_vote: true,
                stationary: true,
                mains_powered: true,
                replica: None,
                cluster: None,
                leaving: false,
                supported_versions: *speaks,
                robot: None,
            };
            base.merge(
                Record { owner: node(name), stamp: RecordStamp::default(), knowledge, proof: None },
                NodeTime::ZERO,
            );
        }
        base
    }

    const OLD: VersionRange = VersionRange { oldest: 1, newest: 1 };
    const NEW: VersionRange = VersionRange { oldest: 1, newest: 2 };

    #[test]
    fn a_fleet_goes_on_when_everybody_reads_the_next_version() {
        let of = |now, own, needed: &[&str], nodes: &[(&str, VersionRange)]| {
            UpgradeStatus::of(now, own, needed.iter().map(|name| node(name)), &base(nodes))
        };
        let waits = |behind: &[(&str, Option<VersionRange>)]| UpgradeStatus::Blocked {
            next: 2,
            behind: behind.iter().map(|(name, speaks)| (node(name), *speaks)).collect(),
        };
        assert_eq!(of(1, NEW, &["ada"], &[("ada", NEW), ("bob", NEW)]), UpgradeStatus::Ready { next: 2 });
        assert_eq!(of(1, NEW, &[], &[("ada", NEW), ("bob", OLD)]), waits(&[("bob", Some(OLD))]));
        assert_eq!(of(1, NEW, &["ada", "cyd"], &[("ada", NEW)]), waits(&[("cyd", None)]));
        // Two steps at once would leave some behind who read the next but not the one after it.
        let far = VersionRange { oldest: 2, newest: 3 };
        assert_eq!(of(1, far, &[], &[("ada", far)]), UpgradeStatus::Ready { next: 2 });
        assert_eq!(of(2, NEW, &[], &[("ada", NEW)]), UpgradeStatus::Newest);
        assert_eq!(of(1, OLD, &[], &[("ada", NEW)]), UpgradeStatus::Newest);
        assert_eq!(of(u8::MAX, NEW, &[], &[]), UpgradeStatus::Newest);
    }
}
