//! Views of nodes, robots and ensembles.

use super::{LedgerCopy, readable, readable_if_known, readable_or_default};
use crate::codec;
use crate::ensemble::{ExchangedValue, Membership};
use crate::fnv::fnv1a;
use crate::ids::{AlarmId, ClusterId, EnsembleId, MissionId, NodeId, PlaceId, RobotId, RoleId, TaskType, ZoneId};
use crate::knowledge::RobotKnowledge;
use crate::ledger::{Alarm, AlarmPlan, Closure, RobotOrders, SpeedLimit};
use crate::scalar::Scalar;
use crate::units::{BatteryShare, Seconds};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// The nodes of a fleet, and its ensembles.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FleetView {
    /// Cluster of the node that replies; null if it belongs to none yet.
    #[serde(default)]
    pub cluster: Option<ClusterId>,
    /// Nodes with a known record, in the order of their names.
    #[serde(default, deserialize_with = "readable")]
    pub nodes: Vec<NodeView>,
    /// Ensembles of the fleet.
    #[serde(default, deserialize_with = "readable")]
    pub ensembles: Vec<EnsembleView>,
    /// Zones, places and lanes that people have closed; null if neither the replying node nor a voter that it
    /// has asked has a ledger.
    #[serde(default, deserialize_with = "readable_if_known")]
    pub closures: Option<Vec<Closure>>,
    /// Speed limits that people have set; null if neither the replying node nor a voter that it
    /// has asked has a ledger.
    #[serde(default, deserialize_with = "readable_if_known")]
    pub speed_limits: Option<Vec<SpeedLimit>>,
    /// Alarms in force; null if neither the replying node nor a voter that it
    /// has asked has a ledger.
    #[serde(default, deserialize_with = "readable_if_known")]
    pub alarms: Option<Vec<Alarm>>,
    /// Charging by the robots themselves; null if robots charge by tasks of missions only.
    #[serde(default, deserialize_with = "readable_or_default")]
    pub charging: Option<ChargingView>,
    /// Chargers that are leased, or for which robots wait, in the order of their names.
    #[serde(default, deserialize_with = "readable")]
    pub chargers: Vec<ChargerView>,
    /// Names that people may use in orders, by the fleet file of the replying node. The coordinator resolves them by its own.
    #[serde(default, deserialize_with = "readable_or_default")]
    pub declared: DeclarationsView,
}

/// What a fleet file declares for orders of people. Nodes may have different files.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DeclarationsView {
    /// Alarms, with their plans.
    #[serde(default)]
    pub alarms: BTreeMap<AlarmId, AlarmPlan>,
    /// Zones, with their places.
    #[serde(default)]
    pub zones: BTreeMap<ZoneId, BTreeSet<PlaceId>>,
    /// Hash of the alarms and zones, as 16 hexadecimal digits: it is the same at all nodes whose files declare the same.
    #[serde(default)]
    pub hash: String,
}

impl DeclarationsView {
    /// Returns the view of these declarations.
    ///
    /// # Panics
    /// Never: a fleet file is smaller than a record.
    pub fn of(alarms: BTreeMap<AlarmId, AlarmPlan>, zones: BTreeMap<ZoneId, BTreeSet<PlaceId>>) -> DeclarationsView {
        let content = codec::encode_record(&(&alarms, &zones)).expect("declarations fit a record");
        DeclarationsView { hash: format!("{:016x}", fnv1a(content)), alarms, zones }
    }
}

/// Charging of a fleet by the robots themselves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ChargingView {
    /// Charge below which a free robot goes to a charger, as a share.
    pub below: BatteryShare,
    /// Charge at which a robot has charged enough, as a share.
    pub until: BatteryShare,
    /// Charge below which a free robot uses a charger that no other robot needs, as a share; null for none.
    #[serde(default)]
    pub opportunistic: Option<BatteryShare>,
    /// Places of the chargers.
    #[serde(default, deserialize_with = "readable")]
    pub chargers: Vec<PlaceId>,
}

/// A charger, as seen by the node that replies.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ChargerView {
    /// Its place.
    pub charger: PlaceId,
    /// Its lease; null without one, or if the replying node has no ledger.
    #[serde(default)]
    pub lease: Option<ChargerLeaseView>,
    /// Robots that wait for it, the next first; a robot may wait for several chargers.
    #[serde(default)]
    pub waiting: Vec<RobotId>,
}

/// Lease of a charger.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ChargerLeaseView {
    /// The robot.
    pub robot: RobotId,
    /// Epoch of the grant, as `term.index`.
    pub epoch: String,
    /// Time of the grant in milliseconds since 1970; 0 if it is unknown.
    #[serde(default)]
    pub since_ms: u64,
}

/// A node, as seen by the node that replies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NodeView {
    /// The node.
    pub node: NodeId,
    /// Contact with the node.
    #[serde(flatten)]
    pub contact: Contact,
    /// Its record.
    #[serde(flatten)]
    pub record: PublishedRecord,
    /// Its traits.
    #[serde(flatten)]
    pub traits: NodeTraits,
    /// The role that its robot holds: by the ledger, or by the robot's record if neither the replying node nor a
    /// voter that it has asked has a ledger.
    #[serde(default)]
    pub holds: Option<HeldRole>,
    /// Orders of people to its robot, by the ledger; none if neither the replying node nor a voter that it has
    /// asked has a ledger.
    #[serde(default)]
    pub orders: RobotOrders,
    /// Roles that its robot gets later, in their order, by the ledger; none if neither the replying node nor a
    /// voter that it has asked has a ledger.
    #[serde(default, deserialize_with = "readable")]
    pub promised: Vec<PromisedRoleView>,
}

/// Contact with a node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Contact {
    /// The node that states the contact.
    pub seen_by: NodeId,
    /// True if the node counts as alive.
    #[serde(default)]
    pub alive: bool,
    /// Its state in the membership protocol.
    #[serde(default)]
    pub status: NodeStatus,
    /// Age of its record in milliseconds, since the last contact.
    #[serde(default)]
    pub age_ms: u64,
}

/// State of a node in the membership protocol.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NodeStatus {
    /// Not in contact yet, or removed.
    #[default]
    Unknown,
    /// Alive.
    Alive,
    /// Suspected: it counts as alive until it is declared down.
    Suspect,
    /// Declared down.
    Down,
}

impl NodeStatus {
    /// Returns the word in JSON.
    pub fn as_str(self) -> &'static str {
        match self {
            NodeStatus::Unknown => "unknown",
            NodeStatus::Alive => "alive",
            NodeStatus::Suspect => "suspect",
            NodeStatus::Down => "down",
        }
    }
}

/// Latest known record of a node.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct PublishedRecord {
    /// Number that grows with each start of the node.
    pub incarnation: u64,
    /// Number that grows with each change of the record.
    pub version: u64,
    /// Cluster of the node; null if it belongs to none yet.
    pub cluster: Option<ClusterId>,
    /// True if the node is about to leave the fleet permanently.
    pub leaving: bool,
    /// State and abilities of its robot; null if the node has no robot.
    pub robot: Option<RobotKnowledge>,
}

/// Traits of a node that do not change.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct NodeTraits {
    /// True if it may become a voter of the ledger and the coordinator.
    pub may_vote: bool,
    /// True if it does not move.
    pub stationary: bool,
    /// True if it runs on mains power.
    pub mains_powered: bool,
}

/// Role that a robot holds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct HeldRole {
    /// The mission.
    pub mission: MissionId,
    /// The role in it.
    pub role: RoleId,
    /// Epoch of the award, as `term.index`; null if it is not known.
    #[serde(default)]
    pub epoch: Option<String>,
}

/// Role that a robot gets later.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct PromisedRoleView {
    /// The mission.
    pub mission: MissionId,
    /// The role in it.
    pub role: RoleId,
    /// Time at which the robot is estimated to be free for it, in milliseconds since 1970.
    pub planned_at_ms: u64,
    /// Estimated time for its tasks; null if it is not known.
    #[serde(default)]
    pub time_s: Option<Seconds>,
}

/// A robot's node. `age_ms` is the age of its record, and `version` the version of its record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RobotView {
    /// The node.
    #[serde(flatten)]
    pub node: NodeView,
    /// The coordinator, as seen by the replying node; null if there is none.
    #[serde(default)]
    pub coordinator: Option<NodeId>,
    /// Term of the coordinator.
    #[serde(default)]
    pub term: u64,
    /// Time by the replying node's clock, in milliseconds since 1970.
    #[serde(default)]
    pub at_ms: u64,
    /// Latest readings that the robot's driver has published, by name. Null if the robot's node does not
    /// reply to the replying node, if its driver has not reported, and for a robot of another node in the
    /// reply to a key expression that covers other views too, as `view/**`.
    #[serde(default)]
    pub readings: Option<BTreeMap<String, Scalar>>,
    /// Latest values of the feedback of the goal in progress, by name; empty without such a goal, or if its action
    /// declares no feedback. Null in the cases in which the readings are null.
    #[serde(default)]
    pub feedback: Option<BTreeMap<String, Scalar>>,
    /// The copy of the ledger that the role, the orders and the promised roles are from; absent if they are not from
    /// a ledger.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ledger: Option<LedgerCopy>,
}

/// The ensembles of a fleet.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct EnsemblesView {
    /// Ensembles.
    #[serde(default, deserialize_with = "readable")]
    pub ensembles: Vec<EnsembleView>,
}

/// Values that the members of an ensemble exchange, as received by a member.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EnsembleKnowledgeView {
    /// Name of the ensemble.
    pub ensemble: EnsembleId,
    /// The member that has received the values.
    pub member: NodeId,
    /// Latest values of each member that has sent any.
    #[serde(default)]
    pub robots: BTreeMap<RobotId, MemberKnowledge>,
}

/// Values of a member of an ensemble.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct MemberKnowledge {
    /// Age of the values in milliseconds, since their arrival.
    pub age_ms: u64,
    /// Attributes of the robot that the ensemble lists.
    pub attributes: BTreeMap<String, Scalar>,
    /// Readings of its driver that the ensemble lists.
    pub readings: BTreeMap<String, Scalar>,
}

/// An ensemble: its conditions, and its members as evaluated by the node that replies.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct EnsembleView {
    /// Name of the ensemble.
    pub name: EnsembleId,
    /// Conditions on a member, all of which must hold.
    #[serde(default)]
    pub membership: Vec<String>,
    /// Skills that its missions need.
    #[serde(default)]
    pub skills: BTreeSet<TaskType>,
    /// Maximum age of knowledge, in milliseconds.
    #[serde(default)]
    pub stale_after_ms: u64,
    /// Values that its members exchange.
    #[serde(default)]
    pub exchange: BTreeSet<ExchangedValue>,
    /// Every known node, with its membership.
    #[serde(default, deserialize_with = "readable")]
    pub nodes: Vec<EnsembleMember>,
    /// The members.
    #[serde(default)]
    pub members: Vec<NodeId>,
    /// The other nodes, with the reasons.
    #[serde(default)]
    pub not_members: BTreeMap<NodeId, String>,
}

/// A node, with its membership in an ensemble.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct EnsembleMember {
    /// The node.
    pub node: NodeId,
    /// Its membership.
    #[serde(flatten)]
    pub membership: Membership,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_declarations_have_the_same_hash() {
        let hash = |place: &str| {
            let zones = BTreeMap::from([("icu".parse().unwrap(), BTreeSet::from([place.parse().unwrap()]))]);
            DeclarationsView::of(BTreeMap::new(), zones).hash
        };
        assert_eq!((hash("IC Room 5").len(), hash("IC Room 5")), (16, hash("IC Room 5")));
        assert_ne!(hash("IC Room 6"), hash("IC Room 5"));
    }
}
