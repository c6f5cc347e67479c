//! What nodes know of one another: one versioned record per node, written by that node alone.
//!
//! A record is ordered by its owner's *incarnation* (grows with each start of the node) and *version* (grows with each
//! change); merging keeps the later one, so that merging is commutative, associative and idempotent, and knowledge may
//! reach a node by any way, in any order, any number of times (a state-based CRDT: Shapiro et al. 2011).

use crate::codec;
use crate::ids::{ClusterId, FleetId, MissionId, NodeId, PlaceId, RoleId, TaskType};
use crate::pose::Pose;
use crate::trust::{Fingerprint, SIGNATURE_BYTES};
use crate::units::{BatteryShare, MetresPerSecond, NodeTime, SharePerSecond};
use crate::versions::VersionRange;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// A node's account of itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Who wrote it.
    pub owner: NodeId,
    /// Which version of which life of the owner.
    pub stamp: RecordStamp,
    /// What it says.
    pub knowledge: Knowledge,
    /// That its owner says so, for those who have it from others, if the fleet has certificates.
    pub proof: Option<Proof>,
}

impl Record {
    /// What its owner signs: what the signature is for, the fleet, and all of the record but the proof itself.
    pub fn signed_part(&self, fleet: &FleetId) -> Vec<u8> {
        let said = codec::encode_record(&(fleet, &self.owner, self.stamp, &self.knowledge));
        let said = said.expect("what fits a message fits a record");
        [b"consort record\0", &said[..]].concat()
    }
}

/// The signature of a record by its owner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Proof {
    by: Fingerprint,
    signature: [[u8; SIGNATURE_BYTES / 2]; 2],
}

impl Proof {
    /// A signature by the bearer of this certificate; `None` if it has not as many bytes as a signature has.
    pub fn new(by: Fingerprint, signature: &[u8]) -> Option<Proof> {
        let (first, second) = signature.split_first_chunk()?;
        Some(Proof { by, signature: [*first, second.try_into().ok()?] })
    }

    /// By the bearer of which certificate it claims to be.
    pub fn by(&self) -> Fingerprint {
        self.by
    }

    /// The bytes of the signature.
    pub fn signature(&self) -> Vec<u8> {
        self.signature.concat()
    }
}

/// Position of a record in the history of its owner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct RecordStamp {
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
    /// Which versions of the wire its program reads.
    pub supported_versions: VersionRange,
    /// Its robot, if it is a robot's node.
    pub robot: Option<RobotKnowledge>,
}

impl Knowledge {
    /// Whether it is a robot that could take a role now.
    pub fn is_free(&self) -> bool {
        self.robot.as_ref().is_some_and(|worker| worker.availability == Availability::Free)
    }
}

/// A robot, as the coordinator knows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RobotKnowledge {
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
pub type Digest = BTreeMap<NodeId, RecordStamp>;

/// Classes of owners at most.
pub const CLASSES_MAX: u8 = 16;

/// Some of all owners. Owners fall into classes by their names, the same on every node, so that two nodes which differ need
/// speak only of the classes in which they do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct DigestScope {
    /// How many classes there are.
    classes: u8,
    /// Which of them are within: a bit each.
    within: u16,
}

impl DigestScope {
    /// Everybody.
    pub const ALL: DigestScope = DigestScope { classes: 1, within: 1 };

    /// Nobody.
    pub const NONE: DigestScope = DigestScope { classes: 1, within: 0 };

    /// Those of whom two nodes know different things, by their sums; everybody if these cannot be compared.
    pub fn of_difference(ours: &[u64], theirs: &[u64]) -> DigestScope {
        let classes = u8::try_from(ours.len()).ok().filter(|classes| (1..=CLASSES_MAX).contains(classes));
        match classes {
            Some(classes) if ours.len() == theirs.len() => {
                let differ = ours.iter().zip(theirs).enumerate().filter(|(_, (our, their))| our != their);
                DigestScope { classes, within: differ.fold(0, |within, (class, _)| within | 1 << class) }
            }
            _ => DigestScope::ALL,
        }
    }

    /// Whether this owner is one of them.
    pub fn contains(&self, owner: &NodeId) -> bool {
        self.within.checked_shr(class(owner, self.classes) as u32).unwrap_or(0) & 1 == 1
    }
}

fn class(owner: &NodeId, classes: u8) -> usize {
    (mix(hash(owner)) % u64::from(classes.max(1))) as usize
}

/// FNV-1a: the same on every machine.
fn hash(owner: &NodeId) -> u64 {
    let step = |hash: u64, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
    owner.as_str().bytes().fold(0xcbf2_9ce4_8422_2325, step)
}

/// Spreads a number over all bits (the finaliser of SplitMix64: Steele, Lea, Flood 2014).
fn mix(number: u64) -> u64 {
    let number = (number ^ (number >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let number = (number ^ (number >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    number ^ (number >> 31)
}

/// All that a node has heard.
#[derive(Debug, Clone, Default)]
pub struct KnowledgeBase {
    heard: BTreeMap<NodeId, KnownRecord>,
}

/// A record and when it reached this node.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownRecord {
    /// The record.
    pub record: Record,
    /// When, on this node's clock, this version was first heard or was last confirmed to be current.
    pub last_contact: NodeTime,
}

impl KnownRecord {
    /// How old this node's knowledge of the owner is.
    pub fn age(&self, now: NodeTime) -> Duration {
        now.since(self.last_contact)
    }
}

impl KnowledgeBase {
    /// Takes in a record. True if it was news; what is not later than what is known changes nothing.
    pub fn merge(&mut self, record: Record, now: NodeTime) -> bool {
        match self.heard.get(&record.owner) {
            Some(known) if known.record.stamp >= record.stamp => false,
            _ => {
                self.heard.insert(record.owner.clone(), KnownRecord { record, last_contact: now });
                true
            }
        }
    }

    /// The owner itself said, at `now`, that this is still its latest version.
    pub fn confirm(&mut self, owner: &NodeId, stamp: RecordStamp, now: NodeTime) {
        if let Some(heard) = self.heard.get_mut(owner).filter(|heard| heard.record.stamp == stamp) {
            heard.last_contact = heard.last_contact.max(now);
        }
    }

    /// The owner itself said, at `now`, that it is at `stamp`, and has said the same since version `since` of that
    /// incarnation; `proof` is that of its record with that stamp. False if this node has not heard what that is.
    pub fn refresh(
        &mut self,
        owner: &NodeId,
        stamp: RecordStamp,
        since: u64,
        proof: Option<Proof>,
        now: NodeTime,
    ) -> bool {
        let Some(heard) = self.heard.get_mut(owner) else { return false };
        let known = heard.record.stamp;
        if known > stamp {
            return true; // it was overtaken by something later
        }
        if known.incarnation != stamp.incarnation || known.version < since {
            return false;
        }
        if known < stamp || proof.is_some() {
            heard.record.proof = proof;
        }
        heard.record.stamp = stamp;
        heard.last_contact = heard.last_contact.max(now);
        true
    }

    /// What this node has of those within a scope.
    pub fn digest(&self, scope: DigestScope) -> Digest {
        let told = self.heard.iter().filter(|(owner, _)| scope.contains(owner));
        told.map(|(owner, heard)| (owner.clone(), heard.record.stamp)).collect()
    }

    /// A number for each class of owners, as many as suit so many owners. Two nodes whose sums are equal have the same; that
    /// they differ and their sums do not happens once in 2⁶⁴ times.
    pub fn class_sums(&self) -> Vec<u64> {
        let classes = (self.heard.len() / 12).next_power_of_two();
        self.sums_of(u8::try_from(classes).unwrap_or(CLASSES_MAX).min(CLASSES_MAX))
    }

    /// The same for so many classes, to compare with another's; none if that are more than there may be.
    pub fn class_sums_like(&self, theirs: &[u64]) -> Vec<u64> {
        match u8::try_from(theirs.len()) {
            Ok(classes) if classes <= CLASSES_MAX => self.sums_of(classes),
            _ => vec![],
        }
    }

    fn sums_of(&self, classes: u8) -> Vec<u64> {
        let mut sums = vec![0u64; usize::from(classes)];
        for (owner, heard) in &self.heard {
            let RecordStamp { incarnation, version } = heard.record.stamp;
            let entry = mix(mix(hash(owner) ^ mix(incarnation)).wrapping_add(version));
            if let Some(sum) = sums.get_mut(class(owner, classes)) {
                *sum = sum.wrapping_add(entry);
            }
        }
        sums
    }

    /// The records that a node with this digest of those within a scope lacks or has in an older version.
    pub fn missing_for(&self, scope: DigestScope, digest: &Digest) -> Vec<&Record> {
        let newer = |record: &&Record| {
            scope.contains(&record.owner) && digest.get(&record.owner).is_none_or(|stamp| *stamp < record.stamp)
        };
        self.heard.values().map(|heard| &heard.record).filter(newer).collect()
    }

    /// The owners of whom a node with this digest knows something later.
    pub fn outdated_owners(&self, digest: &Digest) -> BTreeSet<NodeId> {
        let later = |(owner, stamp): &(&NodeId, &RecordStamp)| {
            self.heard.get(*owner).is_none_or(|heard| heard.record.stamp < **stamp)
        };
        digest.iter().filter(later).map(|(owner, _)| owner.clone()).collect()
    }

    /// What is known of a node.
    pub fn get(&self, node: &NodeId) -> Option<&KnownRecord> {
        self.heard.get(node)
    }

    /// Everything, in the order of the owners' names.
    pub fn iter(&self) -> impl Iterator<Item = (&NodeId, &KnownRecord)> {
        self.heard.iter()
    }

    /// Forgets all records but those of which this is true.
    pub fn retain(&mut self, mut keep: impl FnMut(&Record) -> bool) {
        self.heard.retain(|_, heard| keep(&heard.record));
    }

    /// Forgets a node that has left; a later incarnation of it is welcome.
    pub fn remove(&mut self, node: &NodeId) -> Option<KnownRecord> {
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
            stamp: RecordStamp { incarnation, version },
            knowledge: Knowledge {
                may_vote: version.is_multiple_of(2),
                stationary: false,
                mains_powered: false,
                replica: Some(incarnation * 1000 + version),
                cluster: None,
                leaving: false,
                supported_versions: VersionRange::OWN,
                robot: None,
            },
            proof: None,
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
            let scope = DigestScope::of_difference(&ada.class_sums(), &bob.class_sums_like(&ada.class_sums()));
            let for_bob: Vec<Record> = ada.missing_for(scope, &bob.digest(scope)).into_iter().cloned().collect();
            let for_ada: Vec<Record> = bob.missing_for(scope, &ada.digest(scope)).into_iter().cloned().collect();
            let owners: BTreeSet<NodeId> = for_ada.iter().map(|record| record.owner.clone()).collect();
            prop_assert_eq!(ada.outdated_owners(&bob.digest(scope)), owners);
            for record in for_bob { prop_assert!(bob.merge(record, NodeTime::ZERO)); }
            for record in for_ada { prop_assert!(ada.merge(record, NodeTime::ZERO)); }
            prop_assert_eq!(content(&ada), content(&bob));
            prop_assert!(ada.missing_for(DigestScope::ALL, &bob.digest(DigestScope::ALL)).is_empty());
            prop_assert_eq!(DigestScope::of_difference(&ada.class_sums(), &bob.class_sums_like(&ada.class_sums())).within, 0);
        }
    }

    proptest! {
        /// Whatever of an owner's statements is lost or overtaken, a version is never believed to say what it does not.
        #[test]
        fn to_hear_that_nothing_changed_is_as_good_as_to_hear_it_again(
            changes in prop::collection::vec(any::<bool>(), 1..12),
            heard in prop::collection::vec((0usize..12, any::<bool>()), 0..30),
        ) {
            let mut since = 0;
            let mut versions = vec![];
            for (version, changed) in changes.iter().enumerate() {
                let version = version as u64;
                since = if *changed { version } else { since };
                let said = Record { stamp: RecordStamp { incarnation: 1, version }, ..record(1, 1, since) };
                versions.push((said, since));
            }
            let mut base = KnowledgeBase::default();
            for (which, whole) in heard {
                let Some((said, since)) = versions.get(which) else { continue };
                let before = base.get(&said.owner).map(|heard| heard.record.stamp);
                if whole {
                    base.merge(said.clone(), NodeTime::ZERO);
                } else if !base.refresh(&said.owner, said.stamp, *since, None, NodeTime::ZERO) {
                    prop_assert!(before.is_none_or(|before| before.version < *since));
                    continue;
                }
                let now = base.get(&said.owner).unwrap();
                prop_assert_eq!(now.record.stamp, before.map_or(said.stamp, |before| before.max(said.stamp)));
                prop_assert_eq!(&now.record, &versions[now.record.stamp.version as usize].0);
            }
        }
    }

    #[test]
    fn an_earlier_life_says_nothing_about_a_later_one() {
        let mut base = base(&[record(1, 2, 5)]);
        let owner = record(1, 0, 0).owner;
        assert!(base.refresh(&owner, RecordStamp { incarnation: 1, version: 9 }, 0, None, NodeTime::ZERO));
        assert!(!base.refresh(&owner, RecordStamp { incarnation: 3, version: 9 }, 0, None, NodeTime::ZERO));
        assert!(!base.refresh(
            &record(2, 0, 0).owner,
            RecordStamp { incarnation: 1, version: 0 },
            0,
            None,
            NodeTime::ZERO
        ));
        assert_eq!(content(&base), [record(1, 2, 5)]);
    }

    #[test]
    fn sums_tell_where_large_bases_differ_and_strange_ones_tell_nothing() {
        let everybody: Vec<Record> = (0..=255).map(|owner| record(owner, 1, 1)).collect();
        let (mut ada, bob) = (base(&everybody), base(&everybody));
        ada.merge(record(77, 1, 2), NodeTime::ZERO);
        let scope = DigestScope::of_difference(&ada.class_sums(), &bob.class_sums_like(&ada.class_sums()));
        assert!(scope.contains(&record(77, 0, 0).owner));
        // One class of sixteen, more or less.
        assert!((1..=40).contains(&bob.digest(scope).len()), "{}", bob.digest(scope).len());
        let strange = vec![0; 300];
        assert_eq!(DigestScope::of_difference(&bob.class_sums_like(&strange), &strange), DigestScope::ALL);
        assert_eq!(bob.digest(DigestScope::ALL).len(), 256);
        assert!(bob.digest(DigestScope::NONE).is_empty());
        assert!(!DigestScope { classes: 0, within: 0 }.contains(&record(1, 0, 0).owner));
    }

    #[test]
    fn a_node_that_started_again_is_believed_over_its_former_life() {
        let mut base = base(&[record(1, 1, 9)]);
        assert!(base.merge(record(1, 2, 0), NodeTime::ZERO));
        assert!(!base.merge(record(1, 1, 10), NodeTime::ZERO));
    }
}
