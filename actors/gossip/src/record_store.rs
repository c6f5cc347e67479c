//! The own record, and the stored records of other nodes.
//!
//! The record of a node that has not been alive for `forget_after` is removed. The stamp of its
//! last record remains, so that no peer restores the same record. A later record is accepted, and
//! so is the same record once its owner is alive.

use super::exchange::{RECORD_MAX, encoded_size};
use super::shared::GossipState;
use consort_bus::record_signer::SharedRecordSigner;
use consort_protocol::ids::NodeId;
use consort_protocol::knowledge::{Digest, DigestScope, Knowledge, Motion, MotionUpdate, Proof, Record, RecordStamp};
use consort_protocol::message::RecordUpdate;
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Time for which a removed record's stamp is stored. By then every node has removed the record,
/// since records of dead nodes are not forwarded.
const STAMP_RETENTION: Duration = Duration::from_secs(3600);

/// Result of merging a received record.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum MergeOutcome {
    /// Not merged: already stored, older than the stored record, or of a removed node.
    Stale,
    /// A later version of the same knowledge.
    Renewed,
    /// New knowledge.
    Changed,
    /// The owner has published a newer version than the stored version.
    Missing,
    /// A record of this node, later than its own: of an earlier run with a later incarnation, or of
    /// another node with the same name.
    Own(RecordStamp),
}

/// A refresh that a node published: its record is unchanged since version `since` of its present
/// incarnation.
#[derive(Debug)]
pub(super) struct Refresh<'a> {
    pub(super) owner: &'a NodeId,
    pub(super) stamp: RecordStamp,
    pub(super) since: u64,
    pub(super) proof: Option<Proof>,
}

/// The own record would exceed the size limit. It is unchanged.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("own record not changed: {bytes} bytes exceed the limit")]
pub(super) struct RecordTooLarge {
    /// Size of the rejected record.
    pub(super) bytes: usize,
}

/// The own record, and the state of the stored records that other actors do not read.
pub(super) struct RecordStore {
    own: Record,
    /// Signs the own record, if the fleet has certificates.
    signer: Option<SharedRecordSigner>,
    /// First version with the present content.
    since: u64,
    renewed: NodeTime,
    /// Motion of the own robot since the latest change of the record.
    motion: Option<Motion>,
    /// Number of the last motion update.
    motion_number: u64,
    /// Time since which the owner of a record has not been alive.
    absent: BTreeMap<NodeId, NodeTime>,
    removed: BTreeMap<NodeId, (RecordStamp, NodeTime)>,
    /// Owners with an update that this node missed.
    missing_from: BTreeSet<NodeId>,
}

impl RecordStore {
    /// Creates the store with the node's own record, which it signs. Continues from the records of
    /// an earlier actor.
    pub(super) fn new(
        mut own: Record,
        signer: Option<SharedRecordSigner>,
        state: &mut GossipState,
        now: NodeTime,
    ) -> RecordStore {
        let stored = state.base.get(&own.owner).map(|known_record| known_record.record.stamp);
        if let Some(stored) = stored.filter(|stored| *stored >= own.stamp) {
            own.stamp = next(stored).unwrap_or(stored);
        }
        own.proof = signer.as_ref().map(|signer| signer.sign(&own));
        state.base.merge(own.clone(), now);
        let absent =
            state.base.iter().map(|(node, _)| (node.clone(), now)).filter(|(node, _)| *node != own.owner).collect();
        RecordStore {
            since: own.stamp.version,
            own,
            signer,
            renewed: now,
            motion: None,
            motion_number: 0,
            absent,
            removed: BTreeMap::new(),
            missing_from: BTreeSet::new(),
        }
    }

    pub(super) fn own(&self) -> &Record {
        &self.own
    }

    /// Returns a refresh of the own record.
    pub(super) fn refresh(&self) -> RecordUpdate {
        RecordUpdate::Refresh { stamp: self.own.stamp, since: self.since, proof: self.own.proof }
    }

    /// Returns a confirmation of the own record, with the motion of the robot.
    pub(super) fn motion_update(&mut self) -> MotionUpdate {
        self.motion_number += 1;
        MotionUpdate { stamp: self.own.stamp, number: self.motion_number, motion: self.motion.clone() }
    }

    /// Changes the motion of the own robot, which the record does not contain. Returns the update to publish.
    pub(super) fn move_robot(&mut self, motion: Motion, state: &mut GossipState) -> MotionUpdate {
        self.motion = Some(motion);
        let update = self.motion_update();
        state.base.receive_motion(&self.own.owner, &update);
        update
    }

    /// Changes the own knowledge. Returns true if it changed and has a new version to publish.
    pub(super) fn update(
        &mut self,
        change: impl FnOnce(&mut Knowledge),
        state: &mut GossipState,
        now: NodeTime,
    ) -> Result<bool, RecordTooLarge> {
        // The new version has the latest motion, even if something else has changed.
        let latest = self.own_with_motion();
        let mut record = latest.clone();
        change(&mut record.knowledge);
        if record.knowledge == latest.knowledge {
            return Ok(false);
        }
        let bytes = encoded_size(&record);
        if bytes > RECORD_MAX {
            return Err(RecordTooLarge { bytes });
        }
        self.own = record;
        self.motion = None;
        self.renew(state, now);
        self.since = self.own.stamp.version;
        Ok(true)
    }

    /// Confirms the unchanged own record, at every `heartbeat`: by a new version once per `every`,
    /// else by confirming the present version.
    pub(super) fn repeat(&mut self, every: Duration, heartbeat: Duration, state: &mut GossipState, now: NodeTime) {
        if now.since(self.renewed) + heartbeat / 2 >= every {
            self.renew(state, now);
        } else {
            state.base.confirm(&self.own.owner, self.own.stamp, now);
        }
    }

    /// Continues after a stamp that other nodes store as this node's latest.
    pub(super) fn overtake(&mut self, stamp: RecordStamp, state: &mut GossipState, now: NodeTime) {
        self.own.stamp = self.own.stamp.max(stamp);
        self.include_motion();
        self.renew(state, now);
        // The content of earlier versions is unknown to this node.
        self.since = self.own.stamp.version;
    }

    /// Adds the latest motion to the content of the next version: all nodes replace what they know of this version.
    fn include_motion(&mut self) {
        let record = self.own_with_motion();
        if encoded_size(&record) <= RECORD_MAX {
            (self.own, self.motion) = (record, None);
        }
    }

    /// Returns the own record with the latest motion of the robot.
    fn own_with_motion(&self) -> Record {
        let mut record = self.own.clone();
        if let (Some(motion), Some(robot)) = (&self.motion, &mut record.knowledge.robot) {
            motion.apply_to(robot);
        }
        record
    }

    fn renew(&mut self, state: &mut GossipState, now: NodeTime) {
        // The highest stamp has no successor, and no fleet lives long enough to reach it.
        self.own.stamp = next(self.own.stamp).unwrap_or(self.own.stamp);
        self.own.proof = self.signer.as_ref().map(|signer| signer.sign(&self.own));
        self.renewed = now;
        state.base.merge(self.own.clone(), now);
        if self.motion.is_some() {
            let update = self.motion_update();
            state.base.receive_motion(&self.own.owner, &update);
        }
    }

    /// Publishes the same knowledge again, in full.
    pub(super) fn republish(&mut self, state: &mut GossipState, now: NodeTime) {
        self.include_motion();
        self.renew(state, now);
        self.since = self.own.stamp.version;
    }

    /// Merges a record from another node.
    pub(super) fn receive(&mut self, record: Record, state: &mut GossipState, now: NodeTime) -> MergeOutcome {
        let Record { owner, stamp, .. } = &record;
        if *owner == self.own.owner {
            return if *stamp > self.own.stamp { MergeOutcome::Own(*stamp) } else { MergeOutcome::Stale };
        }
        let stored = state.base.get(owner);
        let outdated = stored.is_some_and(|known_record| known_record.record.stamp >= *stamp)
            || self.removed.get(owner).is_some_and(|(last_stamp, _)| last_stamp >= stamp);
        if outdated || encoded_size(&record) > RECORD_MAX {
            return MergeOutcome::Stale;
        }
        let same = stored.is_some_and(|known_record| known_record.record.knowledge == record.knowledge);
        let owner = owner.clone();
        state.base.merge(record, now);
        self.removed.remove(&owner);
        self.missing_from.remove(&owner);
        if !state.is_alive(&owner) {
            self.absent.entry(owner).or_insert(now);
        }
        if same { MergeOutcome::Renewed } else { MergeOutcome::Changed }
    }

    /// Merges a refresh. If this node lacks the record, its owner is queried in a later round.
    pub(super) fn receive_refresh(
        &mut self,
        refresh: Refresh<'_>,
        state: &mut GossipState,
        now: NodeTime,
    ) -> MergeOutcome {
        let Refresh { owner, stamp, since, proof } = refresh;
        if *owner == self.own.owner {
            return if stamp > self.own.stamp { MergeOutcome::Own(stamp) } else { MergeOutcome::Stale };
        }
        if self.removed.get(owner).is_some_and(|(last_stamp, _)| *last_stamp >= stamp) {
            return MergeOutcome::Stale;
        }
        if state.base.refresh(owner, stamp, since, proof, now) {
            return MergeOutcome::Renewed;
        }
        self.missing_from.insert(owner.clone());
        MergeOutcome::Missing
    }

    /// Removes and returns the first live owner of a missed update.
    pub(super) fn next_missing_owner(&mut self, state: &GossipState) -> Option<NodeId> {
        self.missing_from.retain(|node| state.is_alive(node));
        self.missing_from.pop_first()
    }

    pub(super) fn mark_alive(&mut self, node: &NodeId) {
        self.absent.remove(node);
        self.removed.remove(node);
    }

    pub(super) fn mark_down(&mut self, node: &NodeId, now: NodeTime) {
        self.absent.entry(node.clone()).or_insert(now);
    }

    /// Removes nodes that have not been alive for `after`. Returns true if any was removed.
    pub(super) fn remove_absent(&mut self, after: Duration, state: &mut GossipState, now: NodeTime) -> bool {
        self.removed.retain(|_, (_, at)| now.since(*at) < STAMP_RETENTION);
        let expired: Vec<NodeId> =
            self.absent.iter().filter(|(_, since)| now.since(**since) >= after).map(|(node, _)| node.clone()).collect();
        for node in &expired {
            self.absent.remove(node);
            state.status.remove(node);
            if let Some(known_record) = state.base.remove(node) {
                self.removed.insert(node.clone(), (known_record.record.stamp, now));
            }
        }
        !expired.is_empty()
    }

    /// Returns all nodes with a present or former record that are not alive.
    pub(super) fn absent_nodes(&self) -> impl Iterator<Item = &NodeId> {
        self.absent.keys().chain(self.removed.keys())
    }

    /// Returns the digest of the stored records, plus the last stamps of removed nodes for which
    /// the peer has an older stamp. A node that returns with its clock set back learns its last
    /// stamp from this.
    pub(super) fn digest_for(&self, state: &GossipState, scope: DigestScope, other: &Digest) -> Digest {
        let mut digest = state.base.digest(scope);
        let last_stamp = self.removed.iter().map(|(node, (stamp, _))| (node, *stamp));
        let later = last_stamp.filter(|(node, stamp)| other.get(*node).is_some_and(|theirs| theirs < stamp));
        digest.extend(later.map(|(node, stamp)| (node.clone(), stamp)));
        digest
    }

    /// Returns the records that a peer with this digest lacks. Records of nodes that are not alive
    /// are not forwarded, so all nodes remove the dead eventually.
    pub(super) fn missing_records<'a>(
        &self,
        state: &'a GossipState,
        scope: DigestScope,
        digest: &Digest,
    ) -> Vec<&'a Record> {
        let mut records = state.base.missing_for(scope, digest);
        records.retain(|record| state.is_alive(&record.owner));
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
    use crate::shared::MemberStatus;

    const T0: NodeTime = NodeTime::ZERO;

    fn node(name: &str) -> NodeId {
        NodeId::new(name).unwrap()
    }

    fn knowledge(replica: u64) -> Knowledge {
        Knowledge { stationary: true, mains_powered: true, replica: Some(replica), ..Knowledge::of(None) }
    }

    fn record(owner: &str, incarnation: u64, version: u64) -> Record {
        Record {
            owner: node(owner),
            stamp: RecordStamp { incarnation, version },
            knowledge: knowledge(version),
            proof: None,
        }
    }

    fn own_record() -> Record {
        record("ada", 5, 0)
    }

    fn ada() -> (RecordStore, GossipState) {
        let mut state = GossipState::default();
        state.status.insert(node("ada"), MemberStatus::Alive { since: T0 });
        (RecordStore::new(own_record(), None, &mut state, T0), state)
    }

    #[test]
    fn only_a_change_creates_a_new_version() {
        let (mut records, mut state) = ada();
        assert_eq!(records.update(|own| own.replica = Some(0), &mut state, T0), Ok(false));
        assert_eq!(records.own().stamp, RecordStamp { incarnation: 5, version: 0 });
        assert_eq!(records.update(|own| own.replica = Some(1), &mut state, T0), Ok(true));
        assert_eq!(records.own().stamp, RecordStamp { incarnation: 5, version: 1 });
        assert_eq!(&state.base.get(&node("ada")).unwrap().record, records.own());
    }

    #[test]
    fn a_replacement_actor_continues_the_versions() {
        let (_, mut state) = ada();
        let records = RecordStore::new(own_record(), None, &mut state, T0);
        assert_eq!(records.own().stamp, RecordStamp { incarnation: 5, version: 1 });
    }

    #[test]
    fn a_later_record_of_the_own_node_is_superseded() {
        let (mut records, mut state) = ada();
        assert_eq!(records.receive(record("ada", 4, 9), &mut state, T0), MergeOutcome::Stale);
        let later = RecordStamp { incarnation: 6, version: 2 };
        assert_eq!(records.receive(record("ada", 6, 2), &mut state, T0), MergeOutcome::Own(later));
        records.overtake(later, &mut state, T0);
        assert_eq!(state.base.get(&node("ada")).unwrap().record.stamp, RecordStamp { incarnation: 6, version: 3 });
        assert_eq!(state.base.get(&node("ada")).unwrap().record.knowledge, knowledge(0));
    }

    #[test]
    fn a_removed_record_returns_only_if_later_or_alive() {
        let (mut records, mut state) = ada();
        let after = Duration::from_secs(30);
        assert_eq!(records.receive(record("bob", 1, 1), &mut state, T0), MergeOutcome::Changed);
        assert!(!records.remove_absent(after, &mut state, NodeTime::at(after - Duration::from_millis(1))));
        let then = NodeTime::at(after);
        assert!(records.remove_absent(after, &mut state, then));
        assert_eq!(records.receive(record("bob", 1, 1), &mut state, then), MergeOutcome::Stale);
        assert_eq!(records.receive(record("bob", 1, 0), &mut state, then), MergeOutcome::Stale);
        assert_eq!(records.receive(record("bob", 2, 0), &mut state, then), MergeOutcome::Changed);
        assert!(records.remove_absent(after, &mut state, NodeTime::at(after * 2)));
        records.mark_alive(&node("bob"));
        assert_eq!(records.receive(record("bob", 2, 0), &mut state, then), MergeOutcome::Changed);
    }

    #[test]
    fn the_digest_contains_stamps_of_removed_nodes() {
        let (mut records, mut state) = ada();
        records.receive(record("bob", 9, 1), &mut state, T0);
        assert!(records.remove_absent(Duration::ZERO, &mut state, T0));
        let last_stamp = RecordStamp { incarnation: 9, version: 1 };
        let stamp_in_digest = |has| {
            records.digest_for(&state, DigestScope::ALL, &Digest::from([(node("bob"), has)])).get(&node("bob")).copied()
        };
        assert_eq!(stamp_in_digest(RecordStamp { incarnation: 3, version: 70 }), Some(last_stamp));
        assert_eq!(stamp_in_digest(last_stamp), None);
        assert_eq!(records.digest_for(&state, DigestScope::ALL, &Digest::new()).get(&node("bob")), None);
    }

    #[test]
    fn records_of_dead_nodes_are_not_forwarded() {
        let (mut records, mut state) = ada();
        records.receive(record("bob", 1, 1), &mut state, T0);
        records.receive(record("cyd", 1, 1), &mut state, T0);
        state.status.insert(node("bob"), MemberStatus::Alive { since: T0 });
        state.status.insert(node("cyd"), MemberStatus::Down { since: T0 });
        let owners: Vec<_> = records
            .missing_records(&state, DigestScope::ALL, &Digest::new())
            .iter()
            .map(|record| record.owner.as_str())
            .collect();
        assert_eq!(owners, ["ada", "bob"]);
    }
}
