//! Knowledge of nodes about each other: a versioned record per node, written by that node alone.
//!
//! Records are ordered by their owner's *incarnation* (grows with each start of the node) and
//! *version* (grows with each change). Merging keeps the later record, so merging is commutative,
//! associative and idempotent. Records may arrive over any path, in any order, any number of times
//! (a state-based CRDT: Shapiro et al. 2011).

use crate::codec;
use crate::ids::{ClusterId, FleetId, MissionId, NodeId, PlaceId, RoleId, TaskType};
use crate::pose::Pose;
use crate::trust::{Fingerprint, SIGNATURE_BYTES};
use crate::units::{BatteryShare, MetresPerSecond, NodeTime, SharePerSecond};
use crate::versions::VersionRange;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Record of a node about itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Node that wrote the record.
    pub owner: NodeId,
    /// Incarnation and version of the record.
    pub stamp: RecordStamp,
    /// Content of the record.
    pub knowledge: Knowledge,
    /// Signature of the owner, for nodes that receive the record from others; if the fleet has
    /// certificates.
    pub proof: Option<Proof>,
}

impl Record {
    /// Returns the bytes that the owner signs: the purpose of the signature, the fleet, and the
    /// record except its proof.
    pub fn signed_part(&self, fleet: &FleetId) -> Vec<u8> {
        let bytes = codec::encode_record(&(fleet, &self.owner, self.stamp, &self.knowledge));
        let bytes = bytes.expect("a record that fits a message fits storage");
        [b"consort record\0", &bytes[..]].concat()
    }
}

/// Signature of a record by its owner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Proof {
    by: Fingerprint,
    signature: [[u8; SIGNATURE_BYTES / 2]; 2],
}

impl Proof {
    /// Creates a proof from a signature by the principal with this certificate; `None` if the
    /// signature has the wrong length.
    pub fn new(by: Fingerprint, signature: &[u8]) -> Option<Proof> {
        let (first, second) = signature.split_first_chunk()?;
        Some(Proof { by, signature: [*first, second.try_into().ok()?] })
    }

    /// Returns the certificate of the claimed author.
    pub fn by(&self) -> Fingerprint {
        self.by
    }

    /// Returns the bytes of the signature.
    pub fn signature(&self) -> Vec<u8> {
        self.signature.concat()
    }
}

/// Position of a record in the history of its owner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct RecordStamp {
    /// Grows with each start of the owner.
    pub incarnation: u64,
    /// Grows with each change of the record.
    pub version: u64,
}

/// Content of a node's record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Knowledge {
    /// True if the node may vote for the coordinator and be a voter of the ledger.
    pub may_vote: bool,
    /// True if the node does not move.
    pub stationary: bool,
    /// True if the node runs on mains power.
    pub mains_powered: bool,
    /// Member number in the ledger's consensus, if the node has a replica.
    pub replica: Option<u64>,
    /// Cluster of the node: that of its ledger, otherwise that of the first coordinator that it
    /// received a beacon from.
    pub cluster: Option<ClusterId>,
    /// True if the node is about to leave the fleet permanently.
    pub leaving: bool,
    /// Wire versions that its program reads.
    pub supported_versions: VersionRange,
    /// Robot of the node, if it is a robot's node.
    pub robot: Option<RobotKnowledge>,
}

impl Knowledge {
    /// Checks whether the node is a robot that can take a role now.
    pub fn is_free(&self) -> bool {
        self.robot.as_ref().is_some_and(|worker| worker.availability == Availability::Free)
    }
}

/// State and abilities of a robot, as published in its record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RobotKnowledge {
    /// Skills of the robot.
    pub skills: BTreeSet<TaskType>,
    /// Current or last place on the map.
    pub place: PlaceId,
    /// Pose on the map.
    pub pose: Pose,
    /// Charge left.
    pub battery: BatteryShare,
    /// Discharge rate during work.
    pub discharge: SharePerSecond,
    /// Charge below which the robot is no longer useful.
    pub useful_charge: BatteryShare,
    /// Average speed; `None` if the robot does not drive.
    pub speed: Option<MetresPerSecond>,
    /// Availability for a role.
    pub availability: Availability,
    /// Version of its estimator: bids of different versions are not comparable.
    pub estimator: String,
}

/// Availability of a robot for a role.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Availability {
    /// The robot can take a role.
    Free,
    /// The robot holds a role.
    Holding {
        /// Mission of the role.
        mission: MissionId,
        /// Role that it holds.
        role: RoleId,
        /// True if the robot is suspended since its lease ran out.
        suspended: bool,
    },
    /// The robot cannot execute a role.
    OutOfService {
        /// Description of the problem.
        problem: String,
    },
}

/// Versions of the records at a node; sufficient to find the records that another node lacks.
pub type Digest = BTreeMap<NodeId, RecordStamp>;

/// Maximum number of classes of owners.
pub const CLASSES_MAX: u8 = 16;

/// Subset of all owners. Owners are divided into classes by a hash of their names, identical on
/// every node. So two nodes with different records need to exchange only the classes that differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct DigestScope {
    /// Number of classes.
    classes: u8,
    /// Classes in the subset, a bit for each class.
    within: u16,
}

impl DigestScope {
    /// All owners.
    pub const ALL: DigestScope = DigestScope { classes: 1, within: 1 };

    /// No owner.
    pub const NONE: DigestScope = DigestScope { classes: 1, within: 0 };

    /// Returns the owners for which two nodes have different records, according to their sums; all
    /// owners if the sums cannot be compared.
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

    /// Checks whether the owner is in the subset.
    pub fn contains(&self, owner: &NodeId) -> bool {
        self.within.checked_shr(class(owner, self.classes) as u32).unwrap_or(0) & 1 == 1
    }
}

fn class(owner: &NodeId, classes: u8) -> usize {
    (mix(hash(owner)) % u64::from(classes.max(1))) as usize
}

/// Hashes a name with FNV-1a: identical on every machine.
fn hash(owner: &NodeId) -> u64 {
    let step = |hash: u64, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
    owner.as_str().bytes().fold(0xcbf2_9ce4_8422_2325, step)
}

/// Mixes the bits of a number (the finaliser of SplitMix64: Steele, Lea, Flood 2014).
fn mix(number: u64) -> u64 {
    let number = (number ^ (number >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let number = (number ^ (number >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    number ^ (number >> 31)
}

/// Records that a node has received.
#[derive(Debug, Clone, Default)]
pub struct KnowledgeBase {
    records: BTreeMap<NodeId, KnownRecord>,
}

/// Record with the time of the last contact with its owner.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownRecord {
    /// The record.
    pub record: Record,
    /// Time, on this node's clock, at which this version was received or last confirmed as current.
    pub last_contact: NodeTime,
}

impl KnownRecord {
    /// Returns the age of the record at this node.
    pub fn age(&self, now: NodeTime) -> Duration {
        now.since(self.last_contact)
    }
}

impl KnowledgeBase {
    /// Merges a record. Returns true if it was later than the known record; otherwise nothing
    /// changes.
    pub fn merge(&mut self, record: Record, now: NodeTime) -> bool {
        match self.records.get(&record.owner) {
            Some(known) if known.record.stamp >= record.stamp => false,
            _ => {
                self.records.insert(record.owner.clone(), KnownRecord { record, last_contact: now });
                true
            }
        }
    }

    /// Records that the owner confirmed, at `now`, that this is still its latest version.
    pub fn confirm(&mut self, owner: &NodeId, stamp: RecordStamp, now: NodeTime) {
        if let Some(entry) = self.records.get_mut(owner).filter(|entry| entry.record.stamp == stamp) {
            entry.last_contact = entry.last_contact.max(now);
        }
    }

    /// Records that the owner is at `stamp` at `now`, with content unchanged since version `since`
    /// of that incarnation. `proof` is the proof of its record with that stamp. Returns false if
    /// this node does not have that content.
    pub fn refresh(
        &mut self,
        owner: &NodeId,
        stamp: RecordStamp,
        since: u64,
        proof: Option<Proof>,
        now: NodeTime,
    ) -> bool {
        let Some(entry) = self.records.get_mut(owner) else { return false };
        let known = entry.record.stamp;
        if known > stamp {
            return true; // a later version has arrived before
        }
        if known.incarnation != stamp.incarnation || known.version < since {
            return false;
        }
        if known < stamp || proof.is_some() {
            entry.record.proof = proof;
        }
        entry.record.stamp = stamp;
        entry.last_contact = entry.last_contact.max(now);
        true
    }

    /// Returns the versions of this node's records of the owners in a scope.
    pub fn digest(&self, scope: DigestScope) -> Digest {
        let entries = self.records.iter().filter(|(owner, _)| scope.contains(owner));
        entries.map(|(owner, entry)| (owner.clone(), entry.record.stamp)).collect()
    }

    /// Returns a sum for each class of owners; the number of classes depends on the number of
    /// owners. Two nodes with equal sums have the same records, except with a probability of 2⁻⁶⁴.
    pub fn class_sums(&self) -> Vec<u64> {
        let classes = (self.records.len() / 12).next_power_of_two();
        self.sums_of(u8::try_from(classes).unwrap_or(CLASSES_MAX).min(CLASSES_MAX))
    }

    /// Returns the sums for the same number of classes as `theirs`, for comparison; empty if there
    /// are more classes than allowed.
    pub fn class_sums_like(&self, theirs: &[u64]) -> Vec<u64> {
        match u8::try_from(theirs.len()) {
            Ok(classes) if classes <= CLASSES_MAX => self.sums_of(classes),
            _ => vec![],
        }
    }

    fn sums_of(&self, classes: u8) -> Vec<u64> {
        let mut sums = vec![0u64; usize::from(classes)];
        for (owner, entry) in &self.records {
            let RecordStamp { incarnation, version } = entry.record.stamp;
            let entry = mix(mix(hash(owner) ^ mix(incarnation)).wrapping_add(version));
            if let Some(sum) = sums.get_mut(class(owner, classes)) {
                *sum = sum.wrapping_add(entry);
            }
        }
        sums
    }

    /// Returns the records of owners in the scope that a node with this digest lacks or has in an
    /// older version.
    pub fn missing_for(&self, scope: DigestScope, digest: &Digest) -> Vec<&Record> {
        let newer = |record: &&Record| {
            scope.contains(&record.owner) && digest.get(&record.owner).is_none_or(|stamp| *stamp < record.stamp)
        };
        self.records.values().map(|entry| &entry.record).filter(newer).collect()
    }

    /// Returns the owners for which a node with this digest has a later record.
    pub fn outdated_owners(&self, digest: &Digest) -> BTreeSet<NodeId> {
        let later = |(owner, stamp): &(&NodeId, &RecordStamp)| {
            self.records.get(*owner).is_none_or(|entry| entry.record.stamp < **stamp)
        };
        digest.iter().filter(later).map(|(owner, _)| owner.clone()).collect()
    }

    /// Returns the record of a node.
    pub fn get(&self, node: &NodeId) -> Option<&KnownRecord> {
        self.records.get(node)
    }

    /// Returns all records, in the order of the owners' names.
    pub fn iter(&self) -> impl Iterator<Item = (&NodeId, &KnownRecord)> {
        self.records.iter()
    }

    /// Keeps only the records for which the predicate is true.
    pub fn retain(&mut self, mut keep: impl FnMut(&Record) -> bool) {
        self.records.retain(|_, entry| keep(&entry.record));
    }

    /// Removes the record of a node that has left; a later incarnation of it is accepted.
    pub fn remove(&mut self, node: &NodeId) -> Option<KnownRecord> {
        self.records.remove(node)
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
        base.iter().map(|(_, entry)| entry.record.clone()).collect()
    }

    proptest! {
        #[test]
        fn merging_ignores_order_and_repetition((a, b) in records().prop_flat_map(|a| (Just(a.clone()), Just(a).prop_shuffle()))) {
            let mut twice = a.clone();
            twice.extend(b.clone());
            prop_assert_eq!(content(&base(&a)), content(&base(&b)));
            prop_assert_eq!(content(&base(&a)), content(&base(&twice)));
        }

        #[test]
        fn two_nodes_have_the_same_records_after_an_exchange(a in records(), b in records()) {
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
        /// Updates of an owner may be lost or overtaken; a version never gets content that it does
        /// not have.
        #[test]
        fn a_refresh_is_equivalent_to_the_unchanged_record(
            changes in prop::collection::vec(any::<bool>(), 1..12),
            received in prop::collection::vec((0usize..12, any::<bool>()), 0..30),
        ) {
            let mut since = 0;
            let mut versions = vec![];
            for (version, changed) in changes.iter().enumerate() {
                let version = version as u64;
                since = if *changed { version } else { since };
                let record_sent = Record { stamp: RecordStamp { incarnation: 1, version }, ..record(1, 1, since) };
                versions.push((record_sent, since));
            }
            let mut base = KnowledgeBase::default();
            for (which, whole) in received {
                let Some((record_sent, since)) = versions.get(which) else { continue };
                let before = base.get(&record_sent.owner).map(|entry| entry.record.stamp);
                if whole {
                    base.merge(record_sent.clone(), NodeTime::ZERO);
                } else if !base.refresh(&record_sent.owner, record_sent.stamp, *since, None, NodeTime::ZERO) {
                    prop_assert!(before.is_none_or(|before| before.version < *since));
                    continue;
                }
                let now = base.get(&record_sent.owner).unwrap();
                prop_assert_eq!(now.record.stamp, before.map_or(record_sent.stamp, |before| before.max(record_sent.stamp)));
                prop_assert_eq!(&now.record, &versions[now.record.stamp.version as usize].0);
            }
        }
    }

    #[test]
    fn an_earlier_incarnation_does_not_refresh_a_later_incarnation() {
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
    fn sums_show_the_classes_in_which_large_bases_differ() {
        let all_records: Vec<Record> = (0..=255).map(|owner| record(owner, 1, 1)).collect();
        let (mut ada, bob) = (base(&all_records), base(&all_records));
        ada.merge(record(77, 1, 2), NodeTime::ZERO);
        let scope = DigestScope::of_difference(&ada.class_sums(), &bob.class_sums_like(&ada.class_sums()));
        assert!(scope.contains(&record(77, 0, 0).owner));
        // About one class of sixteen.
        assert!((1..=40).contains(&bob.digest(scope).len()), "{}", bob.digest(scope).len());
        let strange = vec![0; 300];
        assert_eq!(DigestScope::of_difference(&bob.class_sums_like(&strange), &strange), DigestScope::ALL);
        assert_eq!(bob.digest(DigestScope::ALL).len(), 256);
        assert!(bob.digest(DigestScope::NONE).is_empty());
        assert!(!DigestScope { classes: 0, within: 0 }.contains(&record(1, 0, 0).owner));
    }

    #[test]
    fn the_record_of_a_later_incarnation_replaces_an_earlier_record() {
        let mut base = base(&[record(1, 1, 9)]);
        assert!(base.merge(record(1, 2, 0), NodeTime::ZERO));
        assert!(!base.merge(record(1, 1, 10), NodeTime::ZERO));
    }
}
