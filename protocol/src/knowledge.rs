//! What nodes know of one another: one versioned record per node, written by that node alone.
//!
//! A record is ordered by its owner's *incarnation* (grows with each start of the node) and *version* (grows with each
//! change); merging keeps the later one, so that merging is commutative, associative and idempotent, and knowledge may
//! reach a node by any way, in any order, any number of times (a state-based CRDT: Shapiro et al. 2011).

use crate::ids::{ClusterId, MissionId, NodeId, PlaceId, RoleId, TaskType};
use crate::pose::Pose;
use crate::units::{BatteryShare, MetresPerSecond, NodeTime, SharePerSecond};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// A node's account of itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Who wrote it.
    pub owner: NodeId,
    /// Which version of which life of the owner.
    pub stamp: Stamp,
    /// What it says.
    pub knowledge: Knowledge,
}

/// Position of a record in the history of its owner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct Stamp {
    /// Grows each time the owner starts.
    pub incarnation: u64,
    /// Grows each time the owner's knowledge changes.
    pub version: u64,
}

/// What a node says of itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Knowledge {
    /// Whether it may take part in electing the coordinator and keep the ledger.
    pub may_vote: bool,
    /// Whether it stays where it is.
    pub stationary: bool,
    /// Whether it lives on mains power.
    pub mains_powered: bool,
    /// Its member number in the ledger's consensus, where it keeps a copy.
    pub replica: Option<u64>,
    /// The cluster it belongs to: that of its ledger, else the first whose coordinator it has heard.
    pub cluster: Option<ClusterId>,
    /// Whether it is about to leave the fleet for good.
    pub leaving: bool,
    /// Its robot, if it is a robot's node.
    pub worker: Option<Worker>,
}

impl Knowledge {
    /// Whether it is a robot that could take a role now.
    pub fn is_free(&self) -> bool {
        self.worker.as_ref().is_some_and(|worker| worker.availability == Availability::Free)
    }
}

/// A robot, as the coordinator knows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Worker {
    /// What it can do.
    pub skills: BTreeSet<TaskType>,
    /// Where it is, or was last, on the map.
    pub place: PlaceId,
    /// Where it is on the floor.
    pub pose: Pose,
    /// Charge left.
    pub battery: BatteryShare,
    /// How fast work empties its battery.
    pub discharge: SharePerSecond,
    /// Below this charge it is of no further use.
    pub useful_charge: BatteryShare,
    /// Its average speed; `None` if it does not drive.
    pub speed: Option<MetresPerSecond>,
    /// Whether it could take a role now.
    pub availability: Availability,
    /// Version of its estimator: bids of different versions do not compare.
    pub estimator: String,
}

/// Whether a robot could take a role.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Availability {
    /// It could.
    Free,
    /// It has one.
    Holding {
        /// Of which mission.
        mission: MissionId,
        /// Which one.
        role: RoleId,
        /// Whether it is held up because its lease ran out.
        suspended: bool,
    },
    /// It could not carry one out.
    OutOfService {
        /// What is the matter.
        problem: String,
    },
}

/// What a node has of each other: enough to see what the other lacks.
pub type Digest = BTreeMap<NodeId, Stamp>;

/// All that a node has heard.
#[derive(Debug, Clone, Default)]
pub struct KnowledgeBase {
    heard: BTreeMap<NodeId, Heard>,
}

/// A record and when it reached this node.
#[derive(Debug, Clone, PartialEq)]
pub struct Heard {
    /// The record.
    pub record: Record,
    /// When, on this node's clock, this version was first heard or was last confirmed to be current.
    pub at: NodeTime,
}

impl Heard {
    /// How old this node's knowledge of the owner is.
    pub fn age(&self, now: NodeTime) -> Duration {
        now.since(self.at)
    }
}

impl KnowledgeBase {
    /// Takes in a record. True if it was news; what is not later than what is known changes nothing.
    pub fn merge(&mut self, record: Record, now: NodeTime) -> bool {
        match self.heard.get(&record.owner) {
            Some(known) if known.record.stamp >= record.stamp => false,
            _ => {
                self.heard.insert(record.owner.clone(), Heard { record, at: now });
                true
            }
        }
    }

    /// The owner itself said, at `now`, that this is still its latest version.
    pub fn confirm(&mut self, owner: &NodeId, stamp: Stamp, now: NodeTime) {
        if let Some(heard) = self.heard.get_mut(owner).filter(|heard| heard.record.stamp == stamp) {
            heard.at = heard.at.max(now);
        }
    }

    /// What this node has.
    pub fn digest(&self) -> Digest {
        self.heard.iter().map(|(owner, heard)| (owner.clone(), heard.record.stamp)).collect()
    }

    /// The records that a node with this digest lacks or has in an older version.
    pub fn missing_for(&self, digest: &Digest) -> Vec<&Record> {
        let newer = |record: &&Record| digest.get(&record.owner).is_none_or(|stamp| *stamp < record.stamp);
        self.heard.values().map(|heard| &heard.record).filter(newer).collect()
    }

    /// The owners of whom a node with this digest knows something later.
    pub fn behind(&self, digest: &Digest) -> BTreeSet<NodeId> {
        let later = |(owner, stamp): &(&NodeId, &Stamp)| {
            self.heard.get(*owner).is_none_or(|heard| heard.record.stamp < **stamp)
        };
        digest.iter().filter(later).map(|(owner, _)| owner.clone()).collect()
    }

    /// What is known of a node.
    pub fn get(&self, node: &NodeId) -> Option<&Heard> {
        self.heard.get(node)
    }

    /// Everything, in the order of the owners' names.
    pub fn iter(&self) -> impl Iterator<Item = (&NodeId, &Heard)> {
        self.heard.iter()
    }

    /// Forgets a node that has left; a later incarnation of it is welcome.
    pub fn forget(&mut self, node: &NodeId) -> Option<Heard> {
        self.heard.remove(node)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    pub(crate) fn record(owner: u8, incarnation: u64, version: u64) -> Record {
        Record {
            owner: NodeId::new(format!("node{owner}")).unwrap(),
            stamp: Stamp { incarnation, version },
            knowledge: Knowledge {
                may_vote: version.is_multiple_of(2),
                stationary: false,
                mains_powered: false,
                replica: Some(incarnation * 1000 + version),
                cluster: None,
                leaving: false,
                worker: None,
            },
        }
    }

    fn records() -> impl Strategy<Value = Vec<Record>> {
        prop::collection::vec((0u8..5, 0u64..3, 0u64..5).prop_map(|(o, i, v)| record(o, i, v)), 0..20)
    }

    fn base(records: &[Record]) -> KnowledgeBase {
        let mut base = KnowledgeBase::default();
        for record in records {
            base.merge(record.clone(), NodeTime::ZERO);
        }
        base
    }

    fn content(base: &KnowledgeBase) -> Vec<Record> {
        base.iter().map(|(_, heard)| heard.record.clone()).collect()
    }

    proptest! {
        #[test]
        fn order_and_repetition_do_not_matter((a, b) in records().prop_flat_map(|a| (Just(a.clone()), Just(a).prop_shuffle()))) {
            let mut twice = a.clone();
            twice.extend(b.clone());
            prop_assert_eq!(content(&base(&a)), content(&base(&b)));
            prop_assert_eq!(content(&base(&a)), content(&base(&twice)));
        }

        #[test]
        fn after_one_exchange_two_nodes_know_the_same(a in records(), b in records()) {
            let (mut ada, mut bob) = (base(&a), base(&b));
            let for_bob: Vec<Record> = ada.missing_for(&bob.digest()).into_iter().cloned().collect();
            let for_ada: Vec<Record> = bob.missing_for(&ada.digest()).into_iter().cloned().collect();
            let owners: BTreeSet<NodeId> = for_ada.iter().map(|record| record.owner.clone()).collect();
            prop_assert_eq!(ada.behind(&bob.digest()), owners);
            for record in for_bob { prop_assert!(bob.merge(record, NodeTime::ZERO)); }
            for record in for_ada { prop_assert!(ada.merge(record, NodeTime::ZERO)); }
            prop_assert_eq!(content(&ada), content(&bob));
            prop_assert!(ada.missing_for(&bob.digest()).is_empty());
        }
    }

    #[test]
    fn a_node_that_started_again_is_believed_over_its_former_life() {
        let mut base = base(&[record(1, 1, 9)]);
        assert!(base.merge(record(1, 2, 0), NodeTime::ZERO));
        assert!(!base.merge(record(1, 1, 10), NodeTime::ZERO));
    }
}
