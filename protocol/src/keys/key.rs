//! Keys as values, formatted and parsed without the fleet's prefix.

use super::call::{ApiCall, DriverCall, PeopleCall, RaftCall};
use crate::ids::{EnsembleId, MissionId, NodeId, RobotId, RoleId};
use crate::trust::Fingerprint;
use std::fmt;

/// Key of a fleet, as a value.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Key {
    /// `wire/certificate/{fingerprint}`: the principal replies with the certificate that verifies
    /// its messages.
    Certificate(Fingerprint),
    /// `wire/certificate/{fingerprint}/known`: nodes reply with the certificate if they know it, for
    /// nodes without a path to its principal.
    KnownCertificate(Fingerprint),
    /// `wire/knowledge/{node}`: a node publishes its record.
    Knowledge(NodeId),
    /// `wire/motion/{node}`: in a large fleet, a node publishes the place, pose and charge of its robot,
    /// and confirms its record.
    Motion(NodeId),
    /// `wire/gossip/{node}`: a node replies to a digest with the records that the requester lacks.
    Gossip(NodeId),
    /// `wire/swim/{node}`: failure detection packets for a node.
    Swim(NodeId),
    /// `wire/raft/{member}/{call}`: consensus calls to a member, by its number.
    Raft(u64, RaftCall),
    /// `wire/bootstrap/{node}`: before it creates a ledger, a node asks the other nodes for
    /// permission.
    Bootstrap(NodeId),
    /// `wire/beacon`: the coordinator publishes that it coordinates.
    Beacon,
    /// `wire/bid/{robot}`: the coordinator calls for bids.
    Bid(RobotId),
    /// `wire/award/{robot}`: the coordinator notifies a robot of an award.
    Award(RobotId),
    /// `wire/report/{node}`: a robot reports to the coordinator on that node.
    Report(NodeId),
    /// `wire/clock/{node}`: the time of day of a node that may vote.
    Clock(NodeId),
    /// `wire/leader/{node}`: the leader that a node that may vote follows.
    Leader(NodeId),
    /// `wire/signal/{mission}/{role}`: a signal of the mission's plan, published for the role that
    /// awaits it.
    Signal(MissionId, RoleId),
    /// `wire/signal_history/{mission}/{role}`: a waiting role queries the signals that the role has
    /// sent.
    SignalHistory(MissionId, RoleId),
    /// `wire/ensemble/{ensemble}/{robot}`: a robot publishes values for the members of an ensemble.
    Ensemble(EnsembleId, RobotId),
    /// `wire/driver/{robot}/{call}`: a robot's node and its driver server.
    Driver(RobotId, DriverCall),
    /// `wire/people/{call}`: tasks of people in unmanaged roles.
    People(PeopleCall),
    /// `wire/world`: the simulator replies with the state of its world, in JSON; `view/world`
    /// passes it on.
    World,
    /// `view/fleet`.
    ViewFleet,
    /// `view/robot/{robot}`.
    ViewRobot(RobotId),
    /// `view/coordinator`.
    ViewCoordinator,
    /// `view/missions`.
    ViewMissions,
    /// `view/requests`.
    ViewRequests,
    /// Schedules.
    ViewSchedules,
    /// `view/audit`.
    ViewAudit,
    /// `view/mission/{mission}`.
    ViewMission(MissionId),
    /// `view/auctions`.
    ViewAuctions,
    /// `view/ensembles`.
    ViewEnsembles,
    /// `view/ensemble/{ensemble}`.
    ViewEnsemble(EnsembleId),
    /// `view/map`.
    ViewMap,
    /// `view/health`.
    ViewHealth,
    /// `view/world`: the world, in a fleet with a simulator.
    ViewWorld,
    /// `seen/{node}/…`: a view from this node.
    Seen(NodeId, Box<Key>),
    /// `api/{call}`.
    Api(ApiCall),
    /// `api/{call}/help`: description of a call.
    Help(ApiCall),
    /// `api/leave/{node}`: asks a node to leave the fleet permanently.
    Leave(NodeId),
    /// `alive/robot/{robot}`.
    AliveRobot(RobotId),
    /// `alive/node/{node}`.
    AliveNode(NodeId),
    /// `alive/coordinator/{term}/{node}`.
    AliveCoordinator(u64, NodeId),
    /// `events/{node}`: a node publishes its events.
    Events(NodeId),
}

impl fmt::Display for Key {
    /// Writes the key without the fleet's prefix.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Key::Certificate(fingerprint) => write!(f, "wire/certificate/{fingerprint}"),
            Key::KnownCertificate(fingerprint) => write!(f, "wire/certificate/{fingerprint}/known"),
            Key::Knowledge(node) => write!(f, "wire/knowledge/{node}"),
            Key::Motion(node) => write!(f, "wire/motion/{node}"),
            Key::Gossip(node) => write!(f, "wire/gossip/{node}"),
            Key::Swim(node) => write!(f, "wire/swim/{node}"),
            Key::Raft(member, call) => write!(f, "wire/raft/{member:016x}/{}", call.as_str()),
            Key::Bootstrap(node) => write!(f, "wire/bootstrap/{node}"),
            Key::Beacon => f.write_str("wire/beacon"),
            Key::Bid(robot) => write!(f, "wire/bid/{robot}"),
            Key::Award(robot) => write!(f, "wire/award/{robot}"),
            Key::Report(node) => write!(f, "wire/report/{node}"),
            Key::Clock(node) => write!(f, "wire/clock/{node}"),
            Key::Leader(node) => write!(f, "wire/leader/{node}"),
            Key::Signal(mission, role) => write!(f, "wire/signal/{mission}/{role}"),
            Key::SignalHistory(mission, role) => write!(f, "wire/signal_history/{mission}/{role}"),
            Key::Ensemble(ensemble, robot) => write!(f, "wire/ensemble/{ensemble}/{robot}"),
            Key::Driver(robot, call) => write!(f, "wire/driver/{robot}/{}", call.as_str()),
            Key::People(call) => write!(f, "wire/people/{}", call.as_str()),
            Key::ViewFleet => f.write_str("view/fleet"),
            Key::ViewRobot(robot) => write!(f, "view/robot/{robot}"),
            Key::ViewCoordinator => f.write_str("view/coordinator"),
            Key::ViewMissions => f.write_str("view/missions"),
            Key::ViewRequests => f.write_str("view/requests"),
            Key::ViewSchedules => f.write_str("view/schedules"),
            Key::ViewAudit => f.write_str("view/audit"),
            Key::ViewMission(mission) => write!(f, "view/mission/{mission}"),
            Key::ViewAuctions => f.write_str("view/auctions"),
            Key::World => f.write_str("wire/world"),
            Key::ViewEnsembles => f.write_str("view/ensembles"),
            Key::ViewEnsemble(ensemble) => write!(f, "view/ensemble/{ensemble}"),
            Key::ViewMap => f.write_str("view/map"),
            Key::ViewHealth => f.write_str("view/health"),
            Key::ViewWorld => f.write_str("view/world"),
            Key::Seen(node, view) => {
                let view = view.to_string();
                write!(f, "seen/{node}/{}", view.strip_prefix("view/").unwrap_or(&view))
            }
            Key::Help(call) => write!(f, "api/{}/help", call.as_str()),
            Key::Api(call) => write!(f, "api/{}", call.as_str()),
            Key::Leave(node) => write!(f, "api/leave/{node}"),
            Key::AliveRobot(robot) => write!(f, "alive/robot/{robot}"),
            Key::AliveNode(node) => write!(f, "alive/node/{node}"),
            Key::AliveCoordinator(term, node) => write!(f, "alive/coordinator/{term}/{node}"),
            Key::Events(node) => write!(f, "events/{node}"),
        }
    }
}

/// Parses a key without the fleet's prefix.
pub(super) fn read(text: &str) -> Option<Key> {
    let segments: Vec<&str> = text.split('/').collect();
    Some(match segments[..] {
        ["wire", "certificate", fingerprint] => Key::Certificate(fingerprint.parse().ok()?),
        ["wire", "certificate", fingerprint, "known"] => Key::KnownCertificate(fingerprint.parse().ok()?),
        ["wire", "knowledge", node] => Key::Knowledge(node.parse().ok()?),
        ["wire", "motion", node] => Key::Motion(node.parse().ok()?),
        ["wire", "gossip", node] => Key::Gossip(node.parse().ok()?),
        ["wire", "swim", node] => Key::Swim(node.parse().ok()?),
        ["wire", "raft", member, call] if member.len() == 16 => {
            Key::Raft(u64::from_str_radix(member, 16).ok()?, RaftCall::parse(call)?)
        }
        ["wire", "bootstrap", node] => Key::Bootstrap(node.parse().ok()?),
        ["wire", "beacon"] => Key::Beacon,
        ["wire", "bid", robot] => Key::Bid(robot.parse().ok()?),
        ["wire", "award", robot] => Key::Award(robot.parse().ok()?),
        ["wire", "report", node] => Key::Report(node.parse().ok()?),
        ["wire", "clock", node] => Key::Clock(node.parse().ok()?),
        ["wire", "leader", node] => Key::Leader(node.parse().ok()?),
        ["wire", "signal", mission, role] => Key::Signal(mission.parse().ok()?, role.parse().ok()?),
        ["wire", "signal_history", mission, role] => Key::SignalHistory(mission.parse().ok()?, role.parse().ok()?),
        ["wire", "ensemble", ensemble, robot] => Key::Ensemble(ensemble.parse().ok()?, robot.parse().ok()?),
        ["wire", "driver", robot, call] => Key::Driver(robot.parse().ok()?, DriverCall::parse(call)?),
        ["wire", "people", call] => Key::People(PeopleCall::parse(call)?),
        ["wire", "world"] => Key::World,
        ["view", ref view @ ..] => read_view(view)?,
        ["seen", node, ref view @ ..] => Key::Seen(node.parse().ok()?, Box::new(read_view(view)?)),
        ["api", call] => Key::Api(ApiCall::parse(call)?),
        ["api", call, "help"] if ApiCall::parse(call).is_some() => Key::Help(ApiCall::parse(call)?),
        ["api", "leave", node] => Key::Leave(node.parse().ok()?),
        ["alive", "robot", robot] => Key::AliveRobot(robot.parse().ok()?),
        ["alive", "node", node] => Key::AliveNode(node.parse().ok()?),
        ["alive", "coordinator", term, node] => Key::AliveCoordinator(term.parse().ok()?, node.parse().ok()?),
        ["events", node] => Key::Events(node.parse().ok()?),
        _ => return None,
    })
}

/// Parses a view from the segments after `view/`.
fn read_view(segments: &[&str]) -> Option<Key> {
    Some(match *segments {
        ["fleet"] => Key::ViewFleet,
        ["robot", robot] => Key::ViewRobot(robot.parse().ok()?),
        ["ensembles"] => Key::ViewEnsembles,
        ["ensemble", ensemble] => Key::ViewEnsemble(ensemble.parse().ok()?),
        ["coordinator"] => Key::ViewCoordinator,
        ["missions"] => Key::ViewMissions,
        ["requests"] => Key::ViewRequests,
        ["schedules"] => Key::ViewSchedules,
        ["audit"] => Key::ViewAudit,
        ["mission", mission] => Key::ViewMission(mission.parse().ok()?),
        ["auctions"] => Key::ViewAuctions,
        ["map"] => Key::ViewMap,
        ["health"] => Key::ViewHealth,
        ["world"] => Key::ViewWorld,
        _ => return None,
    })
}
