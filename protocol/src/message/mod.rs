//! Messages between nodes in bincode, and the key of each message.
//!
//! | key | kind | sender → receiver | message | reply |
//! |---|---|---|---|---|
//! | `wire/knowledge/{node}` | publish | node → all | [`RecordUpdate`] | – |
//! | `wire/motion/{node}` | publish | node → interested nodes | [`MotionUpdate`](crate::knowledge::MotionUpdate) | – |
//! | `wire/gossip/{node}` | query | node → node | [`Exchange`] | [`Exchange`] |
//! | `wire/bootstrap/*` | query | candidate → nodes that may vote | [`BootstrapRequest`] | [`BootstrapReply`] |
//! | `wire/beacon` | publish | coordinator → all | [`Beacon`] | – |
//! | `wire/bid/*`, `wire/bid/{robot}` | query | coordinator → robots | [`CallForBids`](crate::auction::CallForBids) | [`BidResponse`](crate::auction::BidResponse) |
//! | `wire/award/{robot}` | query | coordinator → robot | [`AwardNotice`] | [`AwardReply`] |
//! | `wire/report/{node}` | query | robot → coordinator | [`Report`] | [`ReportReply`] |
//! | `wire/clock/{node}` | query | coordinator → voter | empty | `u64`: milliseconds since 1970 |
//! | `wire/leader/{node}` | query | robot → voter | empty | `Option` of [`FollowedLeader`] |
//! | `wire/signal/{mission}/{role}` | publish | role → role | [`SignalHistory`] | – |
//! | `wire/signal_history/{mission}/{role}` | query | waiting role → role | empty | [`SignalHistory`] |
//! | `wire/ensemble/{ensemble}/{robot}` | publish | robot → members of the ensemble | [`MemberValues`](crate::ensemble::MemberValues) | – |
//!
//! From `wire/beacon` on, the payload of publications and queries is wrapped in a
//! [`ClusterEnvelope`].

use crate::bounds::{self, ELEMENTS_MAX};
use crate::cause::CauseClass;
use crate::codec::VersionedMessage;
use crate::ids::{ClusterId, MissionId, NodeId, PlaceId, RobotId, RoleId, TaskId};
use crate::knowledge::{Digest, DigestScope, Proof, Record, RecordStamp};
use crate::lease::{Award, DeclineReason, EndReason, Epoch, RoleHolder};
use crate::ledger::{
    Alarm, AlarmResponse, Closure, HeldItem, Ledger, MapPart, Resource, RobotOrder, SpeedLimit, TaskQuestion,
};
use crate::mission::ROLES_MAX;
use crate::mission::TaskOutcomes;
use crate::plan::{Signal, StepIndex};
use crate::units::MetresPerSecond;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

pub(crate) mod v1;

/// Publication of a node about itself.
#[expect(
    clippy::large_enum_variant,
    reason = "most updates are records; refreshes are small, and few of either are in memory at the same time"
)]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum RecordUpdate {
    /// The whole record.
    Record(Record),
    /// The record has not changed. A node that has the record need not receive it again.
    Refresh {
        /// Latest version of the record.
        stamp: RecordStamp,
        /// Version, of the same incarnation, since which the content is unchanged.
        since: u64,
        /// Proof of the record with the latest version, if the fleet has certificates.
        proof: Option<Proof>,
    },
}

impl VersionedMessage for RecordUpdate {
    const SINCE: u8 = 2;
    type Previous = v1::RecordUpdate;
}

/// Message of an anti-entropy round. The round starts with sums over the sender's records if both
/// nodes are likely to have the same records; the other node replies with its digest of the records
/// that differ. Otherwise the round starts with the digest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Exchange {
    /// Sums over all records of the sender
    /// ([`KnowledgeBase::class_sums`](crate::knowledge::KnowledgeBase::class_sums)) to compare; may
    /// be empty.
    pub sums: Vec<u64>,
    /// Owners covered by the digest.
    pub scope: DigestScope,
    /// Versions of these owners' records at the sender.
    pub digest: Digest,
    /// Records that the other node seems to lack, as many as fit a message.
    pub records: Vec<Record>,
}

impl VersionedMessage for Exchange {
    const SINCE: u8 = 2;
    type Previous = v1::Exchange;
}

/// Asks whether the sender may create the fleet's ledger. Candidates are ordered by suitability as
/// a voter: stationary before mobile, mains power before battery, then by name.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct BootstrapRequest {
    /// True if the node is mobile.
    pub mobile: bool,
    /// True if the node runs on a battery.
    pub on_battery: bool,
    /// Name of the node.
    pub node: NodeId,
}

/// Reply to a [`BootstrapRequest`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum BootstrapReply {
    /// The node grants the request. For a while it creates no ledger itself and grants no other
    /// request.
    Agreed,
    /// A ledger exists, or the node has granted another request.
    Refused {
        /// The ledger or the other candidate, as text.
        #[serde(deserialize_with = "bounds::text")]
        reason: String,
    },
}

/// Periodic announcement of the coordinator.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Beacon {
    /// Node of the coordinator.
    pub node: NodeId,
    /// Term of the coordinator, unique in its cluster. A beacon of an older term comes from a
    /// coordinator that has been replaced and has not detected it.
    pub term: u64,
    /// Voters of the ledger.
    pub voters: BTreeSet<NodeId>,
    /// Time since the coordinator took over, in milliseconds.
    pub since_ms: u64,
    /// Cluster of the coordinator; `None` while the cluster is being created.
    pub cluster: Option<ClusterId>,
    /// Wire version that the fleet writes, once it is set. The layout of beacons is the same in all
    /// versions, so that a node with an outdated program can detect it.
    pub wire: Option<u8>,
}

impl Beacon {
    /// Checks whether this beacon belongs to another leader session than `known`: another node, or
    /// another term of the same node.
    pub fn is_other_leader_session(&self, known: Option<&Beacon>) -> bool {
        known.is_none_or(|known| (self.term, &self.node) != (known.term, &known.node))
    }

    /// Checks whether this is certainly the coordinator of another cluster.
    pub fn is_other_cluster(&self, known: &Beacon) -> bool {
        self.cluster.is_some() && known.cluster.is_some() && self.cluster != known.cluster
    }
}

/// Envelope of every message about missions: two clusters under the same fleet name may have
/// missions with the same name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClusterEnvelope {
    /// Cluster of the sender, if known.
    pub cluster: Option<ClusterId>,
    /// The message.
    pub payload: Vec<u8>,
}

/// Leader of the ledger that a voter follows; the leader itself follows itself. A beacon of any author counts only
/// if voters state the same.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct FollowedLeader {
    /// Node of the leader.
    pub node: NodeId,
    /// Its term.
    pub term: u64,
}

/// Notification of a robot by the coordinator about its entry in the ledger.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum AwardNotice {
    /// The robot has a role.
    Awarded(Box<Award>),
    /// The robot no longer has the role.
    Revoked {
        /// Epoch of the award.
        epoch: Epoch,
        /// Reason for the end.
        reason: EndReason,
    },
    /// The robot is asked to return the role if it has not acted in it, or, for its own mission, if it only waits and
    /// has signalled no other role.
    GiveWay {
        /// Epoch of the award.
        epoch: Epoch,
        /// Mission that waits for the robot.
        to: MissionId,
        /// True if the robot gets the role again once it can start.
        for_now: bool,
    },
    /// The orders of people to the robot.
    Orders(Box<OrdersNotice>),
    /// A person reassigns the role: the robot returns it once its body is at rest, unless it may have an item, has
    /// signalled another role, or has ended a task that may not be repeated.
    Return {
        /// Epoch of the award.
        epoch: Epoch,
        /// The next robot may repeat tasks that have ended.
        repeat: bool,
        /// Cause, as text.
        #[serde(deserialize_with = "bounds::text")]
        cause: String,
    },
    /// The robot has the lease of a charger or a device.
    Leased {
        /// The charger or the device.
        resource: Resource,
        /// Position of the grant.
        epoch: Epoch,
    },
}

impl AwardNotice {
    /// Returns the position in the ledger that the notice states.
    pub fn position(&self) -> Epoch {
        match self {
            AwardNotice::Awarded(award) => award.epoch,
            AwardNotice::Revoked { epoch, .. }
            | AwardNotice::GiveWay { epoch, .. }
            | AwardNotice::Return { epoch, .. }
            | AwardNotice::Leased { epoch, .. } => *epoch,
            AwardNotice::Orders(orders) => orders.as_of,
        }
    }
}

/// Orders of people to a robot, as of a position in the ledger. A robot ignores an earlier position than the
/// latest that it has received, so a delayed message changes nothing.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct OrdersNotice {
    /// Position of the latest change of any order, or of the items that robots have after they lost their roles.
    pub as_of: Epoch,
    /// Present while the robot is held.
    pub hold: Option<OrderNotice>,
    /// Present while the robot is in maintenance.
    pub maintenance: Option<OrderNotice>,
    /// The closed zones, places and lanes.
    #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
    pub closures: Vec<ClosureNotice>,
    /// Present while people look for an item at the robot: it does not leave its place by itself.
    pub stay: Option<OrderNotice>,
    /// The speed limits.
    #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
    pub speed_limits: Vec<SpeedLimitNotice>,
    /// Present while alarms are in force.
    pub alarm: Option<AlarmNotice>,
}

/// All alarms in force, as a single order: the robot suspends its plan.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlarmNotice {
    /// The alarms, as text: `under alarm fire by Nia: smoke`.
    pub order: OrderNotice,
    /// Assembly places: the robot drives to the nearest that it can reach. Empty if it stands still.
    #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
    pub places: BTreeSet<PlaceId>,
    /// Zones, places and lanes that it does not enter.
    #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
    pub closes: BTreeSet<MapPart>,
}

/// A speed limit in a zone, at a place or on a lane.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SpeedLimitNotice {
    /// The zone, place or lane.
    pub part: MapPart,
    /// The highest allowed speed.
    pub speed: MetresPerSecond,
    /// Time until its end, in milliseconds from the receipt of the message; `None` for no end.
    pub remaining_ms: Option<u64>,
}

/// A closed zone, place or lane.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClosureNotice {
    /// The zone, place or lane.
    pub part: MapPart,
    /// The order, as text: `closed by Nia: a spill`.
    pub order: OrderNotice,
    /// Its end, for display, in milliseconds since 1970; `None` for no end.
    pub until_ms: Option<u64>,
}

/// Order of a person.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OrderNotice {
    /// The order, or another reason, as text: `held by Nia: a spill`.
    #[serde(deserialize_with = "bounds::text")]
    pub text: String,
    /// Time until its end, in milliseconds from the receipt of the message; `None` for no end.
    pub remaining_ms: Option<u64>,
}

impl OrdersNotice {
    /// Checks whether it contains neither orders, closures, speed limits nor alarms, nor a reason to stay.
    pub fn is_empty(&self) -> bool {
        let OrdersNotice { as_of: _, hold, maintenance, closures, stay, speed_limits, alarm } = self;
        let orders = [hold, maintenance, stay];
        orders.into_iter().all(Option::is_none) && closures.is_empty() && speed_limits.is_empty() && alarm.is_none()
    }

    /// Returns the orders of a robot. `confirmed_ms` is the time of day that a majority of the voters confirms, in
    /// milliseconds since 1970. Without it the whole period of an order remains: a single wrong clock ends no hold.
    pub fn of(ledger: &Ledger, robot: &RobotId, confirmed_ms: Option<u64>) -> OrdersNotice {
        let remaining_ms = |order: &RobotOrder| {
            let now_ms = confirmed_ms.unwrap_or(order.since_ms);
            order.until_ms.map(|until_ms| until_ms.saturating_sub(now_ms))
        };
        let notice = |order: &RobotOrder, text| OrderNotice { text, remaining_ms: remaining_ms(order) };
        let orders = ledger.orders_of(robot);
        let hold = orders.and_then(|orders| orders.hold.as_ref());
        let maintenance = orders.and_then(|orders| orders.maintenance.as_ref());
        let mut items = ledger.held_items().filter(|(_, held)| held.robot == *robot);
        let stay = items.next().map(|(entry, HeldItem { item, certain, .. })| {
            let has = if certain { "has" } else { "may have" };
            OrderNotice { text: format!("{has} the {item} of {}", entry.id), remaining_ms: None }
        });
        OrdersNotice {
            as_of: ledger.orders_changed(),
            hold: hold.map(|order| notice(order, order.hold_text())),
            maintenance: maintenance.map(|order| notice(order, order.maintenance_text())),
            closures: ledger
                .closures()
                .map(|Closure { part, order }| ClosureNotice {
                    part,
                    until_ms: order.until_ms,
                    order: notice(&order, order.closure_text()),
                })
                .collect(),
            stay,
            speed_limits: ledger
                .speed_limits()
                .map(|SpeedLimit { part, speed_mps, order }| SpeedLimitNotice {
                    part,
                    speed: speed_mps,
                    remaining_ms: remaining_ms(&order),
                })
                .collect(),
            alarm: AlarmNotice::of(ledger),
        }
    }
}

impl AlarmNotice {
    /// Returns the alarms in force. To stop prevails over assembly.
    fn of(ledger: &Ledger) -> Option<AlarmNotice> {
        if !ledger.has_alarm() {
            return None;
        }
        let mut text = ledger.alarms().map(Alarm::text).collect::<Vec<_>>().join("; ");
        bounds::limit_text(&mut text, bounds::TEXT_BYTES_MAX);
        let plans = || ledger.alarms().map(|alarm| &alarm.plan);
        let stops = plans().any(|plan| plan.robots == AlarmResponse::Stop);
        Some(AlarmNotice {
            order: OrderNotice { text, remaining_ms: None },
            places: plans().filter(|_| !stops).flat_map(|plan| &plan.places).cloned().collect(),
            closes: plans().flat_map(|plan| &plan.closes).cloned().collect(),
        })
    }
}

/// Reply of a robot to a notice.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum AwardReply {
    /// The robot will report, or has stopped.
    Acknowledged,
    /// The robot does not take the role.
    Declined(DeclineReason),
}

/// Report of a robot about a role that it holds; also its request to renew the lease.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Robot that reports.
    pub robot: RobotId,
    /// Incarnation of its node.
    pub incarnation: u64,
    /// The mission.
    pub mission: MissionId,
    /// The role.
    pub role: RoleId,
    /// Epoch of the award.
    pub epoch: Epoch,
    /// All steps that have ended so far.
    #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
    pub ended: BTreeSet<StepIndex>,
    /// Outcomes of tasks that the ledger may lack.
    #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
    pub outcomes: TaskOutcomes,
    /// Task in progress, for display.
    pub current_task: Option<TaskId>,
    /// Place of the robot, if known: the place to look for the item that it carries if the robot is
    /// lost.
    pub place: Option<PlaceId>,
    /// True if this incarnation of the node restored the plan from a checkpoint. An incarnation
    /// that did not restore it has no data about the plan.
    pub from_checkpoint: bool,
    /// Failure, if the role cannot be completed.
    pub failure: Option<TaskFailure>,
    /// Latest question of the robot to people, in its present task.
    pub question: Option<TaskQuestion>,
}

/// Answer to the question of a robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct QuestionAnswer {
    /// Task in which the robot asked.
    pub task: TaskId,
    /// Number of the question in this task.
    pub number: u32,
    /// True if a person has answered.
    pub is_answered: bool,
    /// The answer, or the reason for which there is none.
    #[serde(deserialize_with = "bounds::text")]
    pub text: String,
}

/// Failure of a role: its holder cannot complete it, after all recovery actions of its own.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskFailure {
    /// Task that failed permanently, if a single task is the cause.
    pub task: Option<TaskId>,
    /// Cause, as text.
    #[serde(deserialize_with = "bounds::text")]
    pub cause: String,
    /// Kind of failure.
    pub kind: FailureKind,
    /// Class of the cause.
    pub class: CauseClass,
    /// True if the robot has certainly moved no item in steps that it has not reported as ended.
    pub moved_nothing: bool,
}

impl TaskFailure {
    /// Creates a failure that no single task caused. It says nothing about other robots, and the robot may have
    /// moved an item.
    pub fn new(kind: FailureKind, cause: impl Into<String>) -> TaskFailure {
        TaskFailure { task: None, cause: cause.into(), kind, class: CauseClass::Robot, moved_nothing: false }
    }
}

/// Reason for which a holder gives up its role.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FailureKind {
    /// The skill of the task failed at every allowed attempt, and no alternative was left.
    Task,
    /// The skill of the task crashed.
    Crash,
    /// The task neither ended nor made progress.
    NoProgress,
    /// The battery will not last for the rest of the plan.
    Battery,
    /// The robot leaves the fleet.
    Leaving,
    /// The plan cannot be restored.
    Plan,
    /// The checkpoint cannot be written: after a crash the robot would not find its role.
    #[serde(alias = "notebook")]
    Checkpoint,
    /// Another mission waits for the robot, which has not acted in the role, or another role of this mission, for which
    /// the robot waits.
    GaveWay,
    /// The condition or a parameter of the task uses a result that is unknown. No other robot could do
    /// better, so the mission fails.
    UnknownResult,
    /// Another mission needs the robot now, which has not acted in the role. The robot gets it again.
    Postponed,
    /// A person has reassigned the role.
    Reassigned,
}

/// Reply of the coordinator to a report. The content of the report is in the ledger before any
/// reply other than `NotCoordinator` is sent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum ReportReply {
    /// The lease is renewed, counted from the time at which the report was sent.
    Renewed {
        /// Epoch of the award.
        epoch: Epoch,
        /// Steps that have ended according to the ledger.
        #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
        ended: BTreeSet<StepIndex>,
        /// Current holders of the mission's managed roles.
        #[serde(deserialize_with = "bounds::collection::<_, _, ROLES_MAX>")]
        holders: BTreeMap<RoleId, RoleHolder>,
        /// Signals from other roles to this role, according to the ledger: their sender may be gone
        /// before the signal is received.
        #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
        signals: BTreeSet<Signal>,
        /// Known outcomes of the tasks whose results the role uses.
        #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
        outcomes: TaskOutcomes,
        /// Answer to the question of the report; `None` without an answer.
        answer: Option<QuestionAnswer>,
        /// Orders of people to the robot.
        orders: Box<OrdersNotice>,
    },
    /// The reporter no longer holds the role, or the role is completed.
    Ended {
        /// Epoch of the award that was reported.
        epoch: Epoch,
        /// Reason.
        reason: EndReason,
        /// Epoch of the award of this role that is now in force, if any.
        current: Option<Epoch>,
    },
    /// This node is not the coordinator, or cannot confirm that it still is.
    NotCoordinator {
        /// Coordinator, if known to this node.
        coordinator: Option<NodeId>,
    },
}

/// Signals that a role has sent so far, to one role or to all roles. The message is idempotent,
/// since signals are only ever added.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SignalHistory {
    /// The mission.
    pub mission: MissionId,
    /// Epoch of the sender's award; the default for an unmanaged role.
    pub epoch: Epoch,
    /// Signals sent.
    #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
    pub signals: BTreeSet<Signal>,
}
