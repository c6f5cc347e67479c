//! What nodes say to one another in bincode, and on which key.
//!
//! | key | how | who → whom | says | answer |
//! |---|---|---|---|---|
//! | `wire/knowledge/{node}` | publish | node → all | [`Statement`] | – |
//! | `wire/gossip/{node}` | query | node → node | [`Exchange`] | [`Exchange`] |
//! | `wire/found/*` | query | founder → nodes that may vote | [`Founder`] | [`FoundingAnswer`] |
//! | `wire/beacon` | publish | coordinator → all | [`Beacon`] | – |
//! | `wire/bid/*` | query | coordinator → robots | [`CallForBids`](crate::auction::CallForBids) | [`Tender`](crate::auction::Tender) |
//! | `wire/award/{robot}` | query | coordinator → robot | [`AwardNotice`] | [`AwardAnswer`] |
//! | `wire/report/{node}` | query | robot → coordinator | [`Report`] | [`ReportAnswer`] |
//! | `wire/live/{node}` | query | anyone → coordinator | nothing | [`Live`], in parts |
//! | `wire/changed` | publish | coordinator → all | [`Changed`] | – |
//! | `wire/signal/{mission}/{role}` | publish | role → role | [`Said`] | – |
//! | `wire/said/{mission}/{role}` | query | late waiter → role | nothing | [`Said`] |
//!
//! From `wire/beacon` on, what is published or asked is [`Within`] a cluster.

use crate::codec::VersionedMessage;
use crate::ids::{ClusterId, MissionId, NodeId, PlaceId, RobotId, RoleId, TaskId};
use crate::knowledge::{Digest, DigestScope, Proof, Record, RecordStamp};
use crate::lease::{Award, DeclineReason, EndReason, Epoch, RoleHolder};
use crate::ledger::Branch;
use crate::plan::{Signal, StepIndex};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

mod active_missions;
pub mod v1;

pub use active_missions::{ActiveMissions, ActivePlan};

/// What a node publishes of itself.
#[expect(
    clippy::large_enum_variant,
    reason = "records are what is said in bulk; the few words are as rare in memory as on the wire"
)]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum RecordUpdate {
    /// All of it.
    Record(Record),
    /// That it still says what it said: whoever has heard that need not hear it again.
    Refresh {
        /// Its latest version.
        stamp: RecordStamp,
        /// The version, of the same incarnation, with which it began to say this.
        since: u64,
        /// That of its record with the latest version, if the fleet has certificates.
        proof: Option<Proof>,
    },
}

impl VersionedMessage for RecordUpdate {
    const SINCE: u8 = 2;
    type Previous = v1::RecordUpdate;
}

/// One side of an anti-entropy round. It begins with sums of what the one has, where both may well have the same; the other
/// answers with its digest of where they differ. Else it begins with the digest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Exchange {
    /// Sums of all that the sender has ([`KnowledgeBase::sums`](crate::knowledge::KnowledgeBase::sums)), to be compared; or none.
    pub sums: Vec<u64>,
    /// Of whom the digest tells.
    pub scope: DigestScope,
    /// What the sender has of them.
    pub digest: Digest,
    /// What the sender thinks the other lacks, as much as fits a message.
    pub records: Vec<Record>,
}

impl VersionedMessage for Exchange {
    const SINCE: u8 = 2;
    type Previous = v1::Exchange;
}

/// Asks whether its sender may found the fleet's ledger. Ordered by who is to keep a ledger rather: one that stays where it is
/// before one that moves, one on mains power before one on a battery, then by name.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct BootstrapRequest {
    /// Whether it moves about.
    pub mobile: bool,
    /// Whether it lives on a battery.
    pub on_battery: bool,
    /// Its name.
    pub node: NodeId,
}

/// What a node says to a [`Founder`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum BootstrapReply {
    /// It will found none for a while, and lets nobody else.
    Agreed,
    /// There is a ledger, or it has left it to somebody else to found one.
    Refused {
        /// Which, or who, in words.
        reason: String,
    },
}

/// The coordinator's sign of life.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Beacon {
    /// Its node.
    pub node: NodeId,
    /// Its term, which it shares with no other of its cluster: a beacon of an older one is a coordinator that does not know
    /// that it no longer is.
    pub term: u64,
    /// Who keeps the ledger.
    pub voters: BTreeSet<NodeId>,
    /// How long it has coordinated, in milliseconds.
    pub since_ms: u64,
    /// Its cluster; `None` while that is being founded.
    pub cluster: Option<ClusterId>,
    /// Which version of the wire the fleet writes, once that is said. Beacons have one layout in all versions: whoever is left
    /// behind must be able to read that it is.
    pub wire: Option<u8>,
}

impl Beacon {
    /// Whether whoever knows `known` should follow this one: it is no older, or of another cluster, to which the hearer has
    /// gone over and where terms are counted anew.
    pub fn supersedes(&self, known: Option<&Beacon>) -> bool {
        known.is_none_or(|known| self.term >= known.term || self.is_other_cluster(known))
    }

    /// Whether it is of another reign than `known`: of another node, or another term of the same.
    pub fn is_other_leader_session(&self, known: Option<&Beacon>) -> bool {
        known.is_none_or(|known| (self.term, &self.node) != (known.term, &known.node))
    }

    /// Whether this is certainly the coordinator of another cluster.
    pub fn is_other_cluster(&self, known: &Beacon) -> bool {
        self.cluster.is_some() && known.cluster.is_some() && self.cluster != known.cluster
    }
}

/// What goes around every message that concerns missions, on the bus: two clusters of one fleet name may have missions
/// of the same name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClusterEnvelope {
    /// Which cluster the sender belongs to, if it knows of one.
    pub cluster: Option<ClusterId>,
    /// The message.
    pub payload: Vec<u8>,
}

/// The coordinator tells a robot what the ledger says of it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum AwardNotice {
    /// It has a role.
    Awarded(Box<Award>),
    /// It no longer has one.
    Revoked {
        /// By which award it had it.
        epoch: Epoch,
        /// Why it ended.
        reason: EndReason,
    },
}

/// What a robot says to a notice.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum AwardReply {
    /// It will report, or has stopped.
    Acknowledged,
    /// It will not take the role.
    Declined(DeclineReason),
}

/// A robot's account of a role it holds; also its request to go on holding it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Report {
    /// Who reports.
    pub robot: RobotId,
    /// In which life of its node.
    pub incarnation: u64,
    /// The mission.
    pub mission: MissionId,
    /// The role.
    pub role: RoleId,
    /// By which award; the default for an unmanaged role.
    pub epoch: Epoch,
    /// For an unmanaged role, of which branch's plan; for a managed role, whose award tells it, the default.
    pub branch: Branch,
    /// All steps that have ended so far.
    pub ended: BTreeSet<StepIndex>,
    /// What it is at, to show.
    pub current_task: Option<TaskId>,
    /// Where the robot is, if it knows: where to look for what it carries, should it be lost.
    pub place: Option<PlaceId>,
    /// Whether this life of the node took the plan up from what the former one had written down. A life that did not knows
    /// nothing of the plan.
    pub from_checkpoint: bool,
    /// Why the role cannot be carried to its end, if so.
    pub failure: Option<TaskFailure>,
}

/// A role that its holder cannot carry to its end, after all that it could try by itself.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskFailure {
    /// The task that failed for good, if it is one task's fault.
    pub task: Option<TaskId>,
    /// Why, in words.
    pub cause: String,
    /// What kind of failure it is.
    pub kind: FailureKind,
}

/// Why a holder gives up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FailureKind {
    /// The task's skill failed as often as it was to be tried, and no alternative was left.
    Task,
    /// The task's skill crashed.
    Crash,
    /// The task came to no end and made no progress.
    NoProgress,
    /// The battery will not last for the rest of the plan.
    Battery,
    /// The robot leaves the fleet.
    Leaving,
    /// The plan cannot be taken up.
    Plan,
    /// Its notebook cannot be written: after a crash it would not know what it held.
    Notebook,
}

/// What the coordinator says to a report. What was reported is in the ledger before anything but `NotCoordinator` is said.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum ReportReply {
    /// The lease goes on, from when the report was sent.
    Renewed {
        /// The award.
        epoch: Epoch,
        /// Steps that the ledger knows as ended.
        ended: BTreeSet<StepIndex>,
        /// Who holds the mission's managed roles now.
        holders: BTreeMap<RoleId, RoleHolder>,
        /// What other roles have told this one, as far as the ledger knows: a teller may be gone before it was heard.
        signals: BTreeSet<Signal>,
    },
    /// The role is no longer the reporter's, or has been carried out.
    Ended {
        /// The award it reported under.
        epoch: Epoch,
        /// Why.
        reason: EndReason,
        /// The award of this role that is now in force, if there is one.
        current: Option<Epoch>,
    },
    /// This node does not coordinate, or cannot be sure that it still does.
    NotCoordinator {
        /// Who does, as far as it knows.
        coordinator: Option<NodeId>,
    },
}

/// Missions under way have changed: somebody who follows them should ask again.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MissionsChanged {
    /// The coordinator's node.
    pub node: NodeId,
    /// Its term.
    pub term: u64,
}

/// What a role has said so far to one other, or to all: idempotent, since signals are only ever added.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SignalHistory {
    /// The mission.
    pub mission: MissionId,
    /// By which award the sender holds its role; the default for an unmanaged role.
    pub epoch: Epoch,
    /// What was said.
    pub signals: BTreeSet<Signal>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coordinator_is_followed_forward_in_its_cluster_and_anyhow_into_another() {
        let beacon = |term, cluster: u64| Beacon {
            node: NodeId::new("ada").unwrap(),
            term,
            voters: BTreeSet::new(),
            since_ms: 0,
            cluster: (cluster > 0).then_some(ClusterId(cluster)),
            wire: None,
        };
        for (known, heard, follows) in [
            (None, beacon(1, 1), true),
            (Some(beacon(5, 1)), beacon(5, 1), true),
            (Some(beacon(5, 1)), beacon(4, 1), false),
            (Some(beacon(5, 1)), beacon(1, 2), true),
            (Some(beacon(5, 1)), beacon(4, 0), false),
            (Some(beacon(5, 0)), beacon(4, 1), false),
        ] {
            assert_eq!(heard.supersedes(known.as_ref()), follows, "{known:?} {heard:?}");
        }
    }
}
