//! All keys of the project. Other code calls this module to format and to parse keys.
//!
//! ```text
//! consort/{fleet}/wire/**   bincode, between nodes             (messages: see `message`)
//! consort/{fleet}/view/**   JSON, for people and any client    get: the fleet as any node sees it
//! consort/{fleet}/seen/**   JSON, for people and any client    get: {node}/…: the same views, from this node
//! consort/{fleet}/api/**    JSON, for people and any client    query: submit, cancel, get, list, help, leave/{node} …
//! consort/{fleet}/alive/**  presence tokens                    robot/{id}, node/{id}, coordinator/{term}/{id}
//! consort/{fleet}/events/** JSON, published                    {node}: events of this node, as they happen
//! ```
//!
//! [`TABLE`] lists each key with its owner, usage and content.
//!
//! ```
//! use consort_protocol::ids::{FleetId, RobotId};
//! use consort_protocol::keys::{Key, Keys};
//!
//! let keys = Keys::new(&FleetId::new("ward")?);
//! let award = Key::Award(RobotId::new("ada")?);
//! assert_eq!(keys.write(&award), "consort/ward/wire/award/ada");
//! assert_eq!(keys.read("consort/ward/wire/award/ada"), Some(award));
//! assert_eq!(keys.read("consort/annex/wire/award/ada"), None); // a key of another fleet
//! # Ok::<(), consort_protocol::ids::NameError>(())
//! ```

mod table;

pub use table::{KeyInfo, KeyUsage, TABLE};

use crate::ids::{FleetId, MissionId, NodeId, RobotId, RoleId};
use crate::trust::Fingerprint;
use crate::word_enum::words;
use std::fmt;

/// Key of a fleet, as a value.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Key {
    /// `wire/certificate/{fingerprint}`: the principal replies with the certificate that verifies
    /// its messages.
    Certificate(Fingerprint),
    /// `wire/knowledge/{node}`: a node publishes its record.
    Knowledge(NodeId),
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
    /// `wire/active_missions/{node}`: any node queries the coordinator on that node for the active
    /// missions.
    ActiveMissions(NodeId),
    /// `wire/changed`: the coordinator publishes that active missions have changed.
    Changed,
    /// `wire/signal/{mission}/{role}`: a signal of the mission's plan, published for the role that
    /// awaits it.
    Signal(MissionId, RoleId),
    /// `wire/signal_history/{mission}/{role}`: a waiting role queries the signals that the role has
    /// sent.
    SignalHistory(MissionId, RoleId),
    /// `wire/body/{robot}/{call}`: a robot's node and its driver server.
    Body(RobotId, BodyCall),
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
    /// `view/mission/{mission}`.
    ViewMission(MissionId),
    /// `view/auctions`.
    ViewAuctions,
    /// `view/ensembles`.
    ViewEnsembles,
    /// `view/map`.
    ViewMap,
    /// `view/health`.
    ViewHealth,
    /// `view/world`: the world from the simulator, if there is one.
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

words! {
    /// Consensus call.
    RaftCall {
        /// A candidate requests a vote.
        Vote = "vote",
        /// The leader appends entries, or confirms its leadership.
        Append = "append",
        /// The leader sends a snapshot, in chunks.
        Snapshot = "snapshot",
        /// Before it campaigns, a node asks the voters whether they would vote for it.
        PreVote = "pre_vote",
        /// A leader that leaves transfers its leadership.
        TransferLeadership = "transfer_leadership",
        /// A leader that waits for a reply checks that the voter is reachable.
        Heartbeat = "heartbeat",
    }
    /// Call between a robot's node and its driver server.
    BodyCall {
        /// Query to the server: start or cancel a goal, or only return the state.
        Command = "command",
        /// Publication by the server: telemetry and the state of goals.
        State = "state",
    }
    /// Call between a human task proxy and the host of people.
    PeopleCall {
        /// Query to the host: ask or dismiss a person.
        Ask = "ask",
        /// Publication by the host: a task that a person has completed.
        Done = "done",
    }
    /// Request of clients in any language, in JSON.
    ApiCall {
        /// Submit a mission.
        Submit = "submit",
        /// Cancel a mission.
        Cancel = "cancel",
        /// Resolve an intervention: a person has taken care of the items that robots had.
        Resolve = "resolve",
        /// Get a backup of the ledger.
        Backup = "backup",
        /// Get the progress of an upgrade to the next wire version, and complete it.
        Upgrade = "upgrade",
        /// Get a mission.
        Get = "get",
        /// List all missions.
        List = "list",
        /// Explain for each role of a mission the outcome of each robot's bid.
        Explain = "explain",
        /// List the calls with their parameters.
        Help = "help",
    }
    /// Category of the messages on a key, for metrics.
    KeyKind {
        /// Certificates.
        Certificate = "certificate",
        /// Records of knowledge.
        Knowledge = "knowledge",
        /// Comparisons of knowledge.
        Gossip = "gossip",
        /// Failure detection.
        Swim = "swim",
        /// Heartbeats of the leader to its voters.
        RaftHeartbeat = "raft/heartbeat",
        /// Entries of the ledger, and confirmations of the leadership.
        RaftAppend = "raft/append",
        /// Other consensus messages.
        Raft = "raft",
        /// Beacons of the coordinator.
        Beacon = "beacon",
        /// Commands to driver servers.
        BodyCommand = "body/command",
        /// States published by driver servers.
        BodyState = "body/state",
        /// Auctions, awards and reports.
        Work = "work",
        /// Signals of missions, and queries for them.
        Signal = "signal",
        /// Changes of missions, and queries for active missions.
        ActiveMissions = "active_missions",
        /// Views and requests of people.
        People = "people",
        /// All other messages.
        Other = "other",
    }
}

impl ApiCall {
    /// Checks whether the call changes nothing and any node can answer it from its own data. A
    /// backup of the ledger is not such a call: only the coordinator can ensure that it is
    /// complete.
    pub fn is_read_only(self) -> bool {
        match self {
            ApiCall::Submit | ApiCall::Cancel | ApiCall::Resolve | ApiCall::Backup | ApiCall::Upgrade => false,
            ApiCall::Get | ApiCall::List | ApiCall::Explain | ApiCall::Help => true,
        }
    }
}

impl KeyKind {
    /// Returns the category of a key or key expression, of any fleet.
    pub fn of(text: &str) -> KeyKind {
        let mut segments = text.split('/').skip(2);
        match (segments.next(), segments.next()) {
            (Some("wire"), Some(kind)) => match (kind, segments.last()) {
                ("certificate", _) => KeyKind::Certificate,
                ("knowledge", _) => KeyKind::Knowledge,
                ("gossip", _) => KeyKind::Gossip,
                ("swim", _) => KeyKind::Swim,
                ("raft", Some("heartbeat")) => KeyKind::RaftHeartbeat,
                ("raft", Some("append")) => KeyKind::RaftAppend,
                ("raft" | "bootstrap", _) => KeyKind::Raft,
                ("beacon", _) => KeyKind::Beacon,
                ("body", Some("state")) => KeyKind::BodyState,
                ("body", _) => KeyKind::BodyCommand,
                ("bid" | "award" | "report", _) => KeyKind::Work,
                ("signal" | "signal_history", _) => KeyKind::Signal,
                ("active_missions" | "changed", _) => KeyKind::ActiveMissions,
                ("people" | "world", _) => KeyKind::People,
                _ => KeyKind::Other,
            },
            (Some("view" | "seen" | "api" | "events"), _) => KeyKind::People,
            _ => KeyKind::Other,
        }
    }
}

/// Formats and parses the keys of a fleet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Keys {
    fleet: FleetId,
    prefix: String,
}

impl Keys {
    /// Creates the keys of a fleet.
    pub fn new(fleet: &FleetId) -> Keys {
        Keys { fleet: fleet.clone(), prefix: format!("consort/{fleet}") }
    }

    /// Returns the fleet.
    pub fn fleet(&self) -> &FleetId {
        &self.fleet
    }

    /// Formats a key.
    pub fn write(&self, key: &Key) -> String {
        format!("{}/{key}", self.prefix)
    }

    /// Parses a key. `None` if the text is not a key of this fleet.
    pub fn read(&self, text: &str) -> Option<Key> {
        read(self.strip_fleet(text)?)
    }

    /// Checks whether messages on this key or key expression concern missions and are wrapped in a
    /// [`ClusterEnvelope`](crate::message::ClusterEnvelope).
    pub fn is_cluster_scoped(&self, text: &str) -> bool {
        let below = text.strip_prefix(&self.prefix).and_then(|rest| rest.strip_prefix("/wire/"));
        let kind = below.map(|rest| rest.split('/').next().unwrap_or(rest));
        kind.is_some_and(|kind| {
            ["beacon", "bid", "award", "report", "active_missions", "changed", "signal", "signal_history"]
                .contains(&kind)
        })
    }

    /// Returns the part of a key or key expression below the fleet's prefix: `wire/bid/*`.
    pub fn strip_fleet<'a>(&self, text: &'a str) -> Option<&'a str> {
        text.strip_prefix(&self.prefix)?.strip_prefix('/')
    }

    /// Returns the key expression for all certificates.
    pub fn any_certificate(&self) -> String {
        format!("{}/wire/certificate/*", self.prefix)
    }

    /// Returns the key expression for the records of all nodes.
    pub fn any_knowledge(&self) -> String {
        format!("{}/wire/knowledge/*", self.prefix)
    }

    /// Returns the key expression for calls for bids to all robots.
    pub fn any_bid(&self) -> String {
        format!("{}/wire/bid/*", self.prefix)
    }

    /// Returns the key expression for the signals of all missions to all roles.
    pub fn any_signal(&self) -> String {
        format!("{}/wire/signal/*/*", self.prefix)
    }

    /// Returns the key expression for the commands to all robots, which a driver server serves.
    pub fn any_body_command(&self) -> String {
        format!("{}/wire/body/*/{}", self.prefix, BodyCall::Command.as_str())
    }

    /// Returns the key expression for the states of all robots, which shows the connected robots.
    pub fn any_body_state(&self) -> String {
        format!("{}/wire/body/*/{}", self.prefix, BodyCall::State.as_str())
    }

    /// Returns the key expression for the consensus calls to a member.
    pub fn any_raft(&self, member: u64) -> String {
        format!("{}/wire/raft/{member:016x}/*", self.prefix)
    }

    /// Returns the key expression for bootstrap requests to all nodes that may vote.
    pub fn any_bootstrap(&self) -> String {
        format!("{}/wire/bootstrap/*", self.prefix)
    }

    /// Returns the key expression for all views.
    pub fn any_view(&self) -> String {
        format!("{}/view/**", self.prefix)
    }

    /// Returns the key expression for all views of a single node.
    pub fn any_seen(&self, node: &NodeId) -> String {
        format!("{}/seen/{node}/**", self.prefix)
    }

    /// Returns the key expression for all views of each node.
    pub fn any_seen_by_any(&self) -> String {
        format!("{}/seen/**", self.prefix)
    }

    /// Returns the key expression for the coordinator as seen by each node.
    pub fn any_seen_coordinator(&self) -> String {
        format!("{}/seen/*/coordinator", self.prefix)
    }

    /// Returns the key expression for requests to leave.
    pub fn any_leave(&self) -> String {
        format!("{}/api/leave/*", self.prefix)
    }

    /// Returns the key expression for the help on each call.
    pub fn any_help(&self) -> String {
        format!("{}/api/*/help", self.prefix)
    }

    /// Returns the key expression for all requests.
    pub fn any_api(&self) -> String {
        format!("{}/api/*", self.prefix)
    }

    /// Returns the key expression for the events of all nodes.
    pub fn any_events(&self) -> String {
        format!("{}/events/**", self.prefix)
    }

    /// Returns the key expression for all presence tokens.
    pub fn any_alive(&self) -> String {
        format!("{}/alive/**", self.prefix)
    }

    /// Returns the key expression for the presence tokens of nodes.
    pub fn any_alive_node(&self) -> String {
        format!("{}/alive/node/*", self.prefix)
    }
}

impl fmt::Display for Key {
    /// Writes the key without the fleet's prefix.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Key::Certificate(fingerprint) => write!(f, "wire/certificate/{fingerprint}"),
            Key::Knowledge(node) => write!(f, "wire/knowledge/{node}"),
            Key::Gossip(node) => write!(f, "wire/gossip/{node}"),
            Key::Swim(node) => write!(f, "wire/swim/{node}"),
            Key::Raft(member, call) => write!(f, "wire/raft/{member:016x}/{}", call.as_str()),
            Key::Bootstrap(node) => write!(f, "wire/bootstrap/{node}"),
            Key::Beacon => f.write_str("wire/beacon"),
            Key::Bid(robot) => write!(f, "wire/bid/{robot}"),
            Key::Award(robot) => write!(f, "wire/award/{robot}"),
            Key::Report(node) => write!(f, "wire/report/{node}"),
            Key::ActiveMissions(node) => write!(f, "wire/active_missions/{node}"),
            Key::Changed => f.write_str("wire/changed"),
            Key::Signal(mission, role) => write!(f, "wire/signal/{mission}/{role}"),
            Key::SignalHistory(mission, role) => write!(f, "wire/signal_history/{mission}/{role}"),
            Key::Body(robot, call) => write!(f, "wire/body/{robot}/{}", call.as_str()),
            Key::People(call) => write!(f, "wire/people/{}", call.as_str()),
            Key::ViewFleet => f.write_str("view/fleet"),
            Key::ViewRobot(robot) => write!(f, "view/robot/{robot}"),
            Key::ViewCoordinator => f.write_str("view/coordinator"),
            Key::ViewMissions => f.write_str("view/missions"),
            Key::ViewMission(mission) => write!(f, "view/mission/{mission}"),
            Key::ViewAuctions => f.write_str("view/auctions"),
            Key::World => f.write_str("wire/world"),
            Key::ViewEnsembles => f.write_str("view/ensembles"),
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

fn read(text: &str) -> Option<Key> {
    let segments: Vec<&str> = text.split('/').collect();
    Some(match segments[..] {
        ["wire", "certificate", fingerprint] => Key::Certificate(fingerprint.parse().ok()?),
        ["wire", "knowledge", node] => Key::Knowledge(node.parse().ok()?),
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
        ["wire", "active_missions", node] => Key::ActiveMissions(node.parse().ok()?),
        ["wire", "changed"] => Key::Changed,
        ["wire", "signal", mission, role] => Key::Signal(mission.parse().ok()?, role.parse().ok()?),
        ["wire", "signal_history", mission, role] => Key::SignalHistory(mission.parse().ok()?, role.parse().ok()?),
        ["wire", "body", robot, call] => Key::Body(robot.parse().ok()?, BodyCall::parse(call)?),
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
        ["coordinator"] => Key::ViewCoordinator,
        ["missions"] => Key::ViewMissions,
        ["mission", mission] => Key::ViewMission(mission.parse().ok()?),
        ["auctions"] => Key::ViewAuctions,
        ["map"] => Key::ViewMap,
        ["health"] => Key::ViewHealth,
        ["world"] => Key::ViewWorld,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn all() -> Vec<Key> {
        let node = NodeId::new("lab-1").unwrap();
        let robot = RobotId::new("ada").unwrap();
        let mission = MissionId::new("lab-samples-3").unwrap();
        let role = RoleId::new("r1").unwrap();
        let mut keys = vec![
            Key::Certificate(Fingerprint([0xc0; 16])),
            Key::Knowledge(node.clone()),
            Key::Gossip(node.clone()),
            Key::Swim(node.clone()),
            Key::Bootstrap(node.clone()),
            Key::Beacon,
            Key::Bid(robot.clone()),
            Key::Award(robot.clone()),
            Key::Report(node.clone()),
            Key::ActiveMissions(node.clone()),
            Key::Changed,
            Key::Signal(mission.clone(), role.clone()),
            Key::SignalHistory(mission.clone(), role),
            Key::ViewFleet,
            Key::ViewRobot(robot.clone()),
            Key::ViewCoordinator,
            Key::ViewMissions,
            Key::ViewMission(mission.clone()),
            Key::ViewAuctions,
            Key::ViewEnsembles,
            Key::ViewMap,
            Key::ViewHealth,
            Key::ViewWorld,
            Key::World,
            Key::Seen(node.clone(), Box::new(Key::ViewMission(mission))),
            Key::Seen(node.clone(), Box::new(Key::ViewHealth)),
            Key::Leave(node.clone()),
            Key::AliveRobot(robot.clone()),
            Key::AliveNode(node.clone()),
            Key::AliveCoordinator(7, node.clone()),
            Key::Events(node),
        ];
        keys.extend(RaftCall::ALL.iter().map(|call| Key::Raft(0x00ab_cdef, *call)));
        keys.extend(BodyCall::ALL.iter().map(|call| Key::Body(robot.clone(), *call)));
        keys.extend(PeopleCall::ALL.iter().map(|call| Key::People(*call)));
        keys.extend(ApiCall::ALL.iter().flat_map(|call| [Key::Api(*call), Key::Help(*call)]));
        keys
    }

    #[test]
    fn every_key_parses_to_the_value_that_was_formatted() {
        let keys = Keys::new(&FleetId::new("ward").unwrap());
        for key in all() {
            let text = keys.write(&key);
            assert!(text.starts_with("consort/ward/"), "{text}");
            assert_eq!(keys.read(&text).as_ref(), Some(&key), "{text}");
        }
    }

    #[test]
    fn every_key_except_tokens_has_a_category() {
        let keys = Keys::new(&FleetId::new("ward").unwrap());
        let mut counted = std::collections::BTreeSet::new();
        for key in all() {
            let kind = KeyKind::of(&keys.write(&key));
            let token = matches!(key, Key::AliveRobot(_) | Key::AliveNode(_) | Key::AliveCoordinator(..));
            assert_eq!(kind == KeyKind::Other, token, "{key}");
            counted.insert(kind);
        }
        assert_eq!(counted.len(), KeyKind::ALL.len());
        assert_eq!(KeyKind::of(&keys.any_bid()), KeyKind::Work);
        assert_eq!(KeyKind::of(&keys.any_body_command()), KeyKind::BodyCommand);
        assert_eq!(KeyKind::of(&keys.any_body_state()), KeyKind::BodyState);
        assert_eq!(KeyKind::of("consort"), KeyKind::Other);
    }

    #[test]
    fn all_keys_are_formatted_differently() {
        let keys = Keys::new(&FleetId::new("ward").unwrap());
        let texts: std::collections::BTreeSet<String> = all().iter().map(|key| keys.write(key)).collect();
        assert_eq!(texts.len(), all().len());
    }

    #[test]
    fn keys_about_missions_are_cluster_scoped() {
        let keys = Keys::new(&FleetId::new("ward").unwrap());
        for text in [keys.any_bid(), keys.any_signal(), keys.write(&Key::Beacon), keys.write(&Key::Changed)] {
            assert!(keys.is_cluster_scoped(&text), "{text}");
        }
        let warden = "consort/warden/wire/beacon".to_owned();
        for text in [keys.any_knowledge(), keys.any_raft(7), keys.any_bootstrap(), keys.any_view(), warden] {
            assert!(!keys.is_cluster_scoped(&text), "{text}");
        }
    }

    #[test]
    fn keys_outside_the_fleet_are_not_parsed() {
        let keys = Keys::new(&FleetId::new("ward").unwrap());
        for text in [
            "consort/warden/wire/beacon",
            "consort/ward",
            "consort/ward/",
            "consort/ward/wire/bid",
            "consort/ward/wire/bid/a*",
            "consort/ward/wire/raft/12/vote",
            "consort/ward/api/reboot",
            "consort/ward/api/reboot/help",
            "consort/ward/view/tea",
            "consort/ward/seen/lab-1",
            "consort/ward/seen/lab-1/seen/lab-1/fleet",
        ] {
            assert_eq!(keys.read(text), None, "{text}");
        }
    }
}
