//! Knowledge base: the records that a node has received.

use super::content::Knowledge;
use super::digest::{CLASSES_MAX, Digest, DigestScope, class, hash, mix};
use super::motion::{Motion, MotionUpdate};
use super::record::{Proof, Record, RecordStamp};
use crate::ids::NodeId;
use crate::units::NodeTime;
use crate::versions::{VersionEvidence, VersionRange};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

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
    /// Latest motion since this version, if this node has received any.
    motion: Option<KnownMotion>,
}

/// Motion since the version of a record.
#[derive(Debug, Clone, PartialEq)]
struct KnownMotion {
    /// Number of the update.
    number: u64,
    /// Latest motion.
    motion: Motion,
    /// Content of the record with this motion.
    knowledge: Box<Knowledge>,
}

impl KnownRecord {
    /// Returns the content of the record, with the latest motion that this node has received.
    pub fn knowledge(&self) -> &Knowledge {
        self.motion.as_ref().map_or(&self.record.knowledge, |motion| &motion.knowledge)
    }

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
                self.records.insert(record.owner.clone(), KnownRecord { record, last_contact: now, motion: None });
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

    /// Merges the motion of a robot since this version of its record, unless a later motion of the same version is known.
    /// Returns true if the known content changed. A heartbeat repeats the latest motion, which changes nothing.
    pub fn receive_motion(&mut self, owner: &NodeId, update: &MotionUpdate) -> bool {
        let MotionUpdate { stamp, number, motion: Some(motion) } = update else { return false };
        let Some(entry) = self.records.get_mut(owner).filter(|entry| entry.record.stamp == *stamp) else {
            return false;
        };
        if let Some(known) = &mut entry.motion
            && (known.number >= *number || known.motion == *motion)
        {
            known.number = known.number.max(*number);
            return false;
        }
        let mut knowledge = match entry.motion.take() {
            Some(known) => known.knowledge,
            None => Box::new(entry.record.knowledge.clone()),
        };
        if let Some(robot) = &mut knowledge.robot {
            motion.apply_to(robot);
        }
        entry.motion = Some(KnownMotion { number: *number, motion: motion.clone(), knowledge });
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

    /// Returns what the records of the nodes that may vote state of a wire version.
    pub fn wire_version_evidence(&self, version: u8) -> VersionEvidence {
        let voters = self.records.values().map(|known| &known.record.knowledge).filter(|known| known.may_vote);
        let (read, all) = voters.fold((0, 0), |(read, all), known| {
            (read + usize::from(known.supported_versions.contains(version)), all + 1)
        });
        match read {
            _ if 2 * read < all => VersionEvidence::Refuted,
            0 | 1 => VersionEvidence::Unknown,
            _ => VersionEvidence::Confirmed,
        }
    }

    /// Returns the wire versions that each node reads, according to its record.
    pub fn supported_versions(&self) -> impl Iterator<Item = (NodeId, VersionRange)> {
        self.records.iter().map(|(node, known)| (node.clone(), known.record.knowledge.supported_versions))
    }

    /// Removes the record of a node that has left; a later incarnation of it is accepted.
    pub fn remove(&mut self, node: &NodeId) -> Option<KnownRecord> {
        self.records.remove(node)
    }
}
