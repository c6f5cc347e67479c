//! The own record, and which records of others are kept.
//!
//! A node that has not been alive for `forget_after` is forgotten. What remains of it is the stamp of its last record, so
//! that nobody brings the same record back; a later one is welcome, and so is the same one once its owner is alive.

use super::exchange::{RECORD_MAX, encoded_size};
use super::record_signer::SharedRecordSigner;
use super::shared::GossipState;
use consort_protocol::ids::NodeId;
use consort_protocol::knowledge::{Digest, DigestScope, Knowledge, Proof, Record, RecordStamp};
use consort_protocol::message::RecordUpdate;
use consort_protocol::mutants::{self, Mutant};
use consort_protocol::units::NodeTime;
use std::collections::BTreeMap;
use std::time::Duration;

/// How long a stamp is remembered. By then every node has forgotten the record, since none hands over what belongs to
/// a node that is not alive.
const STAMP_KEPT: Duration = Duration::from_secs(3600);

/// What became of a record that was heard.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum MergeOutcome {
    /// Nothing: it was known, is older than what is known, or belongs to somebody forgotten.
    Stale,
    /// A later version of the same knowledge.
    Renewed,
    /// It says something new.
    Changed,
    /// That its owner said something which has not been heard.
    Missing,
    /// It is of this node, and later than what this node itself says: an earlier life with a later incarnation, or another
    /// node with the same name.
    Own(RecordStamp),
}

pub(super) struct RecordStore {
    own: Record,
    /// Signs the own record, where the fleet has certificates.
    notary: Option<SharedRecordSigner>,
    /// The version with which it began to say what it says.
    since: u64,
    renewed: NodeTime,
    /// Since when the owner of a record has not been alive.
    absent: BTreeMap<NodeId, NodeTime>,
    forgotten: BTreeMap<NodeId, (RecordStamp, NodeTime)>,
}

impl RecordStore {
    /// Begins with this knowledge of itself; goes on from what an actor before it knew.
    pub(super) fn new(
        owner: NodeId,
        incarnation: u64,
        knowledge: Knowledge,
        notary: Option<SharedRecordSigner>,
        known: &mut GossipState,
        now: NodeTime,
    ) -> RecordStore {
        let mut stamp = RecordStamp { incarnation, version: 0 };
        if let Some(before) = known.base.get(&owner).map(|heard| heard.record.stamp).filter(|before| *before >= stamp) {
            stamp = next(before).unwrap_or(before);
        }
        let mut own = Record { owner, stamp, knowledge, proof: None };
        own.proof = notary.as_ref().map(|notary| notary.sign(&own));
        known.base.merge(own.clone(), now);
        let absent =
            known.base.iter().map(|(node, _)| (node.clone(), now)).filter(|(node, _)| *node != own.owner).collect();
        RecordStore { since: stamp.version, own, notary, renewed: now, absent, forgotten: BTreeMap::new() }
    }

    pub(super) fn own(&self) -> &Record {
        &self.own
    }

    /// That the own record still says what it said.
    pub(super) fn refresh(&self) -> RecordUpdate {
        RecordUpdate::Refresh { stamp: self.own.stamp, since: self.since, proof: self.own.proof }
    }

    /// The owner's knowledge changes. True if it did, and there is a new version to tell of.
    pub(super) fn update(
        &mut self,
        change: impl FnOnce(&mut Knowledge),
        known: &mut GossipState,
        now: NodeTime,
    ) -> Result<bool, usize> {
        let mut record = self.own.clone();
        change(&mut record.knowledge);
        if record.knowledge == self.own.knowledge {
            return Ok(false);
        }
        let bytes = encoded_size(&record);
        if bytes > RECORD_MAX {
            return Err(bytes);
        }
        self.own = record;
        self.renew(known, now);
        self.since = self.own.stamp.version;
        Ok(true)
    }

    /// The owner still says the same, as it does at every `beat`: a new version now and then, else a confirmation of the one
    /// there is.
    pub(super) fn repeat(&mut self, every: Duration, beat: Duration, known: &mut GossipState, now: NodeTime) {
        if now.since(self.renewed) + beat / 2 >= every {
            self.renew(known, now);
        } else {
            known.base.confirm(&self.own.owner, self.own.stamp, now);
        }
    }

    /// Goes beyond a stamp that others believe to be this node's latest.
    pub(super) fn overtake(&mut self, stamp: RecordStamp, known: &mut GossipState, now: NodeTime) {
        self.own.stamp = self.own.stamp.max(stamp);
        self.renew(known, now);
        // What versions before this one said is the other's affair.
        self.since = self.own.stamp.version;
    }

    fn renew(&mut self, known: &mut GossipState, now: NodeTime) {
        // The last stamp of all cannot be overtaken, and takes longer to reach than any fleet lives.
        self.own.stamp = next(self.own.stamp).unwrap_or(self.own.stamp);
        self.own.proof = self.notary.as_ref().map(|notary| notary.sign(&self.own));
        self.renewed = now;
        known.base.merge(self.own.clone(), now);
    }

    /// Forgets what was heard without a proof, where there are proofs: their owners say it anew, and others may have made it up. True
    /// if there was anything.
    pub(super) fn forget_unproven(&mut self, known: &mut GossipState) -> bool {
        let before = known.base.iter().count();
        if self.notary.is_some() {
            known.base.retain(|record| record.proof.is_some() || record.owner == self.own.owner);
        }
        known.base.iter().count() < before
    }

    /// The owner says the same anew, in full.
    pub(super) fn restate(&mut self, known: &mut GossipState, now: NodeTime) {
        self.renew(known, now);
        self.since = self.own.stamp.version;
    }

    /// Takes in a record that somebody handed over.
    pub(super) fn receive(&mut self, record: Record, known: &mut GossipState, now: NodeTime) -> MergeOutcome {
        let Record { owner, stamp, .. } = &record;
        if *owner == self.own.owner {
            return if *stamp > self.own.stamp { MergeOutcome::Own(*stamp) } else { MergeOutcome::Stale };
        }
        let before = known.base.get(owner);
        let late = before.is_some_and(|heard| heard.record.stamp >= *stamp)
            || self.forgotten.get(owner).is_some_and(|(last, _)| last >= stamp);
        if late || encoded_size(&record) > RECORD_MAX {
            return MergeOutcome::Stale;
        }
        let same = before.is_some_and(|heard| heard.record.knowledge == record.knowledge);
        let owner = owner.clone();
        known.base.merge(record, now);
        self.forgotten.remove(&owner);
        if !known.is_alive(&owner) {
            self.absent.entry(owner).or_insert(now);
        }
        if same { MergeOutcome::Renewed } else { MergeOutcome::Changed }
    }

    /// An owner says that it still says what it said since a version of its present incarnation.
    pub(super) fn receive_refresh(
        &mut self,
        owner: &NodeId,
        stamp: RecordStamp,
        since: u64,
        proof: Option<Proof>,
        known: &mut GossipState,
        now: NodeTime,
    ) -> MergeOutcome {
        if *owner == self.own.owner {
            return if stamp > self.own.stamp { MergeOutcome::Own(stamp) } else { MergeOutcome::Stale };
        }
        if self.forgotten.get(owner).is_some_and(|(last, _)| *last >= stamp) {
            return MergeOutcome::Stale;
        }
        if known.base.refresh(owner, stamp, since, proof, now) { MergeOutcome::Renewed } else { MergeOutcome::Missing }
    }

    pub(super) fn mark_alive(&mut self, node: &NodeId) {
        self.absent.remove(node);
        self.forgotten.remove(node);
    }

    pub(super) fn mark_down(&mut self, node: &NodeId, now: NodeTime) {
        self.absent.entry(node.clone()).or_insert(now);
    }

    /// Forgets whoever has not been alive for so long. True if there was anybody.
    pub(super) fn forget(&mut self, after: Duration, known: &mut GossipState, now: NodeTime) -> bool {
        self.forgotten.retain(|_, (_, at)| now.since(*at) < STAMP_KEPT);
        let gone: Vec<NodeId> =
            self.absent.iter().filter(|(_, since)| now.since(**since) >= after).map(|(node, _)| node.clone()).collect();
        for node in &gone {
            self.absent.remove(node);
            known.status.remove(node);
            if let Some(heard) = known.base.remove(node) {
                self.forgotten.insert(node.clone(), (heard.record.stamp, now));
            }
        }
        !gone.is_empty()
    }

    /// Everybody of whom something is or was known, without being alive.
    pub(super) fn absent_nodes(&self) -> impl Iterator<Item = &NodeId> {
        self.absent.keys().chain(self.forgotten.keys())
    }

    /// What this node has, and besides it the last stamps of forgotten nodes of which the other has an older one: a node
    /// that comes back with its clock set back learns from it how far it was.
    pub(super) fn digest_for(&self, known: &GossipState, scope: DigestScope, other: &Digest) -> Digest {
        let mut digest = known.base.digest(scope);
        let last = self.forgotten.iter().map(|(node, (stamp, _))| (node, *stamp));
        let later = last.filter(|(node, stamp)| other.get(*node).is_some_and(|theirs| theirs < stamp));
        digest.extend(later.map(|(node, stamp)| (node.clone(), stamp)));
        digest
    }

    /// What to hand to a node with this digest of some. Records of nodes that are not alive are not handed on: so the dead are
    /// forgotten everywhere, whoever asks meanwhile.
    pub(super) fn missing_records<'a>(
        &self,
        known: &'a GossipState,
        scope: DigestScope,
        digest: &Digest,
    ) -> Vec<&'a Record> {
        let mut records = known.base.missing_for(scope, digest);
        let relayed = |record: &Record| record.owner == self.own.owner || !mutants::is_active(Mutant::LostRelay);
        records.retain(|record| known.is_alive(&record.owner) && relayed(record));
        records
    }
}

fn next(stamp: RecordStamp) -> Option<RecordStamp> {
    match stamp.version.checked_add(1) {
        Some(version) => Some(RecordStamp { version, ..stamp }),
        None => Some(RecordStamp { incarnation: stamp.incarnation.checked_add(1)?, version: 0 }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gossip::MemberStatus;
    use consort_protocol::versions::VersionRange;

    const T0: NodeTime = NodeTime::ZERO;

    fn node(name: &str) -> NodeId {
        NodeId::new(name).unwrap()
    }

    fn knowledge(replica: u64) -> Knowledge {
        Knowledge {
            may_vote: true,
            stationary: true,
            mains_powered: true,
            replica: Some(replica),
            cluster: None,
            leaving: false,
            supported_versions: VersionRange::OWN,
            robot: None,
        }
    }

    fn record(owner: &str, incarnation: u64, version: u64) -> Record {
        Record {
            owner: node(owner),
            stamp: RecordStamp { incarnation, version },
            knowledge: knowledge(version),
            proof: None,
        }
    }

    fn ada() -> (RecordStore, GossipState) {
        let mut known = GossipState::default();
        known.status.insert(node("ada"), MemberStatus::Alive { since: T0 });
        (RecordStore::new(node("ada"), 5, knowledge(0), None, &mut known, T0), known)
    }

    #[test]
    fn only_a_change_makes_a_new_version() {
        let (mut memory, mut known) = ada();
        assert_eq!(memory.update(|own| own.replica = Some(0), &mut known, T0), Ok(false));
        assert_eq!(memory.own().stamp, RecordStamp { incarnation: 5, version: 0 });
        assert_eq!(memory.update(|own| own.replica = Some(1), &mut known, T0), Ok(true));
        assert_eq!(memory.own().stamp, RecordStamp { incarnation: 5, version: 1 });
        assert_eq!(&known.base.get(&node("ada")).unwrap().record, memory.own());
    }

    #[test]
    fn an_actor_started_in_place_of_another_speaks_after_it() {
        let (_, mut known) = ada();
        let memory = RecordStore::new(node("ada"), 5, knowledge(0), None, &mut known, T0);
        assert_eq!(memory.own().stamp, RecordStamp { incarnation: 5, version: 1 });
    }

    #[test]
    fn who_claims_to_be_me_is_not_believed_but_overtaken() {
        let (mut memory, mut known) = ada();
        assert_eq!(memory.receive(record("ada", 4, 9), &mut known, T0), MergeOutcome::Stale);
        let later = RecordStamp { incarnation: 6, version: 2 };
        assert_eq!(memory.receive(record("ada", 6, 2), &mut known, T0), MergeOutcome::Own(later));
        memory.overtake(later, &mut known, T0);
        assert_eq!(known.base.get(&node("ada")).unwrap().record.stamp, RecordStamp { incarnation: 6, version: 3 });
        assert_eq!(known.base.get(&node("ada")).unwrap().record.knowledge, knowledge(0));
    }

    #[test]
    fn the_forgotten_stay_so_until_they_say_more_or_are_alive() {
        let (mut memory, mut known) = ada();
        let after = Duration::from_secs(30);
        assert_eq!(memory.receive(record("bob", 1, 1), &mut known, T0), MergeOutcome::Changed);
        assert!(!memory.forget(after, &mut known, NodeTime::at(after - Duration::from_millis(1))));
        let then = NodeTime::at(after);
        assert!(memory.forget(after, &mut known, then));
        assert_eq!(memory.receive(record("bob", 1, 1), &mut known, then), MergeOutcome::Stale);
        assert_eq!(memory.receive(record("bob", 1, 0), &mut known, then), MergeOutcome::Stale);
        assert_eq!(memory.receive(record("bob", 2, 0), &mut known, then), MergeOutcome::Changed);
        assert!(memory.forget(after, &mut known, NodeTime::at(after * 2)));
        memory.mark_alive(&node("bob"));
        assert_eq!(memory.receive(record("bob", 2, 0), &mut known, then), MergeOutcome::Changed);
    }

    #[test]
    fn the_stamp_of_the_forgotten_is_told_to_whom_it_concerns() {
        let (mut memory, mut known) = ada();
        memory.receive(record("bob", 9, 1), &mut known, T0);
        assert!(memory.forget(Duration::ZERO, &mut known, T0));
        let last = RecordStamp { incarnation: 9, version: 1 };
        let told = |has| {
            memory.digest_for(&known, DigestScope::ALL, &Digest::from([(node("bob"), has)])).get(&node("bob")).copied()
        };
        assert_eq!(told(RecordStamp { incarnation: 3, version: 70 }), Some(last));
        assert_eq!(told(last), None);
        assert_eq!(memory.digest_for(&known, DigestScope::ALL, &Digest::new()).get(&node("bob")), None);
    }

    #[test]
    fn records_of_the_dead_are_not_handed_on() {
        let (mut memory, mut known) = ada();
        memory.receive(record("bob", 1, 1), &mut known, T0);
        memory.receive(record("cyd", 1, 1), &mut known, T0);
        known.status.insert(node("bob"), MemberStatus::Alive { since: T0 });
        known.status.insert(node("cyd"), MemberStatus::Down { since: T0 });
        let owners: Vec<_> = memory
            .missing_records(&known, DigestScope::ALL, &Digest::new())
            .iter()
            .map(|record| record.owner.as_str())
            .collect();
        assert_eq!(owners, ["ada", "bob"]);
    }
}
