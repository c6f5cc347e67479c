//! Every key there is. All other code calls this module, to write a key and to read one back.
//!
//! ```text
//! consort/{fleet}/wire/**   bincode, between nodes             (see `message` for who says what)
//! consort/{fleet}/view/**   JSON, for people and any client    get: what any one node knows, for all of them
//! consort/{fleet}/seen/**   JSON, for people and any client    get: {node}/…: the same views as this node has them
//! consort/{fleet}/api/**    JSON, for people and any client    query: submit, cancel, get, list, help, leave/{node} …
//! consort/{fleet}/alive/**  presence tokens                    robot/{id}, node/{id}, coordinator/{term}/{id}
//! consort/{fleet}/events/** JSON, published                    {node}: what happens there, as it happens
//! ```
//!
//! [`TABLE`] has each of them with who says it, how and what.
//!
//! ```
//! use consort_protocol::ids::{FleetId, RobotId};
//! use consort_protocol::keys::{Key, Keys};
//!
//! let keys = Keys::new(&FleetId::new("ward")?);
//! let award = Key::Award(RobotId::new("ada")?);
//! assert_eq!(keys.write(&award), "consort/ward/wire/award/ada");
//! assert_eq!(keys.read("consort/ward/wire/award/ada"), Some(award));
//! assert_eq!(keys.read("consort/annex/wire/award/ada"), None); // another fleet's
//! # Ok::<(), consort_protocol::ids::NameError>(())
//! ```

mod table;

pub use table::{KeyInfo, KeyUsage, TABLE};

use crate::ids::{FleetId, MissionId, NodeId, RobotId, RoleId};
use crate::trust::Fingerprint;
use crate::word_enum::words;
use std::fmt;

/// A key of a fleet, as a value.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Key {
    /// `wire/card/{fingerprint}`: asked, its bearer shows the certificate by which its messages are sealed.
    Certificate(Fingerprint),
    /// `wire/knowledge/{node}`: a node publishes its record.
    Knowledge(NodeId),
    /// `wire/gossip/{node}`: asked with a digest, a node answers with what the asker lacks.
    Gossip(NodeId),
    /// `wire/swim/{node}`: failure detection packets for a node.
    Swim(NodeId),
    /// `wire/raft/{member}/{call}`: consensus calls to a member, by its number.
    Raft(u64, RaftCall),
    /// `wire/found/{node}`: before it founds a ledger, a node asks whether anybody knows better.
    Bootstrap(NodeId),
    /// `wire/beacon`: the coordinator publishes that it coordinates.
    Beacon,
    /// `wire/bid/{robot}`: the coordinator asks for bids.
    Bid(RobotId),
    /// `wire/award/{robot}`: the coordinator tells a robot of an award.
    Award(RobotId),
    /// `wire/report/{node}`: a robot reports to the coordinator on that node.
    Report(NodeId),
    /// `wire/live/{node}`: anyone asks the coordinator on that node which missions are under way.
    ActiveMissions(NodeId),
    /// `wire/changed`: the coordinator publishes that missions under way have changed.
    Changed,
    /// `wire/signal/{mission}/{role}`: a message of the mission's plan, published for the role that awaits it.
    Signal(MissionId, RoleId),
    /// `wire/said/{mission}/{role}`: a late waiter asks which messages the role has sent.
    SignalHistory(MissionId, RoleId),
    /// `wire/body/{robot}/{call}`: a robot's node drives its body.
    Body(RobotId, BodyCall),
    /// `wire/people/{call}`: unmanaged roles are asked to act.
    People(PeopleCall),
    /// `wire/world`: asked, the host of bodies says how its world looks. In JSON, which is passed on as `view/world`.
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
    /// `view/world`: as the host of bodies sees it, where there is one.
    ViewWorld,
    /// `seen/{node}/…`: a view as this one node has it.
    Seen(NodeId, Box<Key>),
    /// `api/{call}`.
    Api(ApiCall),
    /// `api/{call}/help`: how a call is made.
    Help(ApiCall),
    /// `api/leave/{node}`: asks a node to leave the fleet for good.
    Leave(NodeId),
    /// `alive/robot/{robot}`.
    AliveRobot(RobotId),
    /// `alive/node/{node}`.
    AliveNode(NodeId),
    /// `alive/coordinator/{term}/{node}`.
    AliveCoordinator(u64, NodeId),
    /// `events/{node}`: a node publishes what happens on it.
    Events(NodeId),
}

words! {
    /// A consensus call.
    RaftCall {
        /// A candidate asks for a vote.
        Vote = "vote",
        /// The leader appends entries, or says that it leads.
        Append = "append",
        /// The leader hands over a snapshot, piece by piece.
        Snapshot = "snapshot",
        /// Before it stands, a node asks whether anybody would vote for it.
        PreVote = "canvass",
        /// A leader that leaves says who is to succeed it.
        TransferLeadership = "succeed",
        /// A leader that waits for an answer asks whether the voter is still there.
        Heartbeat = "beat",
    }
    /// A call between a robot's node and the host of its body.
    BodyCall {
        /// Query to the host: begin or end a goal, or just say how things stand.
        Command = "command",
        /// Publication by the host: telemetry and the state of goals.
        State = "state",
    }
    /// A call between unmanaged roles' attendants and the host of people.
    PeopleCall {
        /// Query to the host: ask or dismiss a person.
        Ask = "ask",
        /// Publication by the host: what a person has done.
        Done = "done",
    }
    /// A request that clients in any language make, in JSON.
    ApiCall {
        /// Ask for a mission.
        Submit = "submit",
        /// Withdraw a mission.
        Cancel = "cancel",
        /// Say that a person has taken care of what a mission left in robots' hands.
        Resolve = "rescued",
        /// Ask for a copy of the ledger.
        Backup = "backup",
        /// Ask how far the fleet is on its way to the next version of the wire, and finish it.
        Upgrade = "upgrade",
        /// Look at one mission.
        Get = "get",
        /// Look at all missions.
        List = "list",
        /// Ask why each robot did or did not get each role of a mission.
        Explain = "explain",
        /// Ask which calls there are, and what they take.
        Help = "help",
    }
    /// What is said on a key, whoever says it of whom: to count by.
    KeyKind {
        /// Certificates.
        Certificate = "card",
        /// Records of knowledge.
        Knowledge = "knowledge",
        /// Comparisons of knowledge.
        Gossip = "gossip",
        /// Failure detection.
        Swim = "swim",
        /// The leader's questions whether a voter is there.
        RaftHeartbeat = "raft/beat",
        /// Entries of the ledger, and heartbeats.
        RaftAppend = "raft/append",
        /// All else of consensus.
        Raft = "raft",
        /// The coordinator's signs of life.
        Beacon = "beacon",
        /// What a body's driver says to its host.
        BodyCommand = "body/command",
        /// What a host says of its bodies.
        BodyState = "body/state",
        /// Auctions, awards and reports.
        Work = "work",
        /// Messages of missions, and questions for them.
        Signal = "signal",
        /// Changes of missions, and questions about those under way.
        ActiveMissions = "live",
        /// Views and requests of people.
        People = "people",
        /// Whatever else.
        Other = "other",
    }
}

impl ApiCall {
    /// Whether it changes nothing, and any node answers it from what it knows. A copy of the ledger is the coordinator's: nobody
    /// else knows that nothing is missing.
    pub fn is_read_only(self) -> bool {
        match self {
            ApiCall::Submit | ApiCall::Cancel | ApiCall::Resolve | ApiCall::Backup | ApiCall::Upgrade => false,
            ApiCall::Get | ApiCall::List | ApiCall::Explain | ApiCall::Help => true,
        }
    }
}

impl KeyKind {
    /// The kind of a key or key expression, of whichever fleet.
    pub fn of(text: &str) -> KeyKind {
        let mut segments = text.split('/').skip(2);
        match (segments.next(), segments.next()) {
            (Some("wire"), Some(kind)) => match (kind, segments.last()) {
                ("card", _) => KeyKind::Certificate,
                ("knowledge", _) => KeyKind::Knowledge,
                ("gossip", _) => KeyKind::Gossip,
                ("swim", _) => KeyKind::Swim,
                ("raft", Some("beat")) => KeyKind::RaftHeartbeat,
                ("raft", Some("append")) => KeyKind::RaftAppend,
                ("raft" | "found", _) => KeyKind::Raft,
                ("beacon", _) => KeyKind::Beacon,
                ("body", Some("state")) => KeyKind::BodyState,
                ("body", _) => KeyKind::BodyCommand,
                ("bid" | "award" | "report", _) => KeyKind::Work,
                ("signal" | "said", _) => KeyKind::Signal,
                ("live" | "changed", _) => KeyKind::ActiveMissions,
                ("people" | "world", _) => KeyKind::People,
                _ => KeyKind::Other,
            },
            (Some("view" | "seen" | "api" | "events"), _) => KeyKind::People,
            _ => KeyKind::Other,
        }
    }
}

/// Writes and reads the keys of one fleet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Keys {
    fleet: FleetId,
    prefix: String,
}

impl Keys {
    /// The keys of a fleet.
    pub fn new(fleet: &FleetId) -> Keys {
        Keys { fleet: fleet.clone(), prefix: format!("consort/{fleet}") }
    }

    /// Whose keys they are.
    pub fn fleet(&self) -> &FleetId {
        &self.fleet
    }

    /// The key as text.
    pub fn write(&self, key: &Key) -> String {
        format!("{}/{key}", self.prefix)
    }

    /// The key that a text is, if it is one of this fleet's.
    pub fn read(&self, text: &str) -> Option<Key> {
        read(self.strip_fleet(text)?)
    }

    /// Whether what is said on this key, or key expression, concerns missions and is [`Within`](crate::message::Within)
    /// a cluster.
    pub fn is_cluster_scoped(&self, text: &str) -> bool {
        let below = text.strip_prefix(&self.prefix).and_then(|rest| rest.strip_prefix("/wire/"));
        let kind = below.map(|rest| rest.split('/').next().unwrap_or(rest));
        kind.is_some_and(|kind| {
            ["beacon", "bid", "award", "report", "live", "changed", "signal", "said"].contains(&kind)
        })
    }

    /// What is below the fleet's prefix of a key or key expression: `wire/bid/*`.
    pub fn strip_fleet<'a>(&self, text: &'a str) -> Option<&'a str> {
        text.strip_prefix(&self.prefix)?.strip_prefix('/')
    }

    /// Key expression for all certificates.
    pub fn any_certificate(&self) -> String {
        format!("{}/wire/card/*", self.prefix)
    }

    /// Key expression for all records of knowledge.
    pub fn any_knowledge(&self) -> String {
        format!("{}/wire/knowledge/*", self.prefix)
    }

    /// Key expression that asks all robots for bids.
    pub fn any_bid(&self) -> String {
        format!("{}/wire/bid/*", self.prefix)
    }

    /// Key expression for the messages of a mission to one of its roles, whichever mission it is.
    pub fn any_signal(&self) -> String {
        format!("{}/wire/signal/*/*", self.prefix)
    }

    /// Key expression for all bodies' commands: what a host of bodies serves.
    pub fn any_body_command(&self) -> String {
        format!("{}/wire/body/*/{}", self.prefix, BodyCall::Command.as_str())
    }

    /// Key expression for all bodies' states: what tells which bodies there are.
    pub fn any_body_state(&self) -> String {
        format!("{}/wire/body/*/{}", self.prefix, BodyCall::State.as_str())
    }

    /// Key expression for a member's consensus calls.
    pub fn any_raft(&self, member: u64) -> String {
        format!("{}/wire/raft/{member:016x}/*", self.prefix)
    }

    /// Key expression that asks all nodes that may vote whether one may found a ledger.
    pub fn any_bootstrap(&self) -> String {
        format!("{}/wire/found/*", self.prefix)
    }

    /// Key expression for all views.
    pub fn any_view(&self) -> String {
        format!("{}/view/**", self.prefix)
    }

    /// Key expression for all views as one node has them.
    pub fn any_seen(&self, node: &NodeId) -> String {
        format!("{}/seen/{node}/**", self.prefix)
    }

    /// Key expression for all views as each node has them.
    pub fn any_seen_by_any(&self) -> String {
        format!("{}/seen/**", self.prefix)
    }

    /// Key expression for what each node believes of the coordinator.
    pub fn any_seen_coordinator(&self) -> String {
        format!("{}/seen/*/coordinator", self.prefix)
    }

    /// Key expression that asks nodes to leave.
    pub fn any_leave(&self) -> String {
        format!("{}/api/leave/*", self.prefix)
    }

    /// Key expression for the help on each call.
    pub fn any_help(&self) -> String {
        format!("{}/api/*/help", self.prefix)
    }

    /// Key expression for all requests.
    pub fn any_api(&self) -> String {
        format!("{}/api/*", self.prefix)
    }

    /// Key expression for the events of all nodes.
    pub fn any_events(&self) -> String {
        format!("{}/events/**", self.prefix)
    }

    /// Key expression for all presence tokens.
    pub fn any_alive(&self) -> String {
        format!("{}/alive/**", self.prefix)
    }

    /// Key expression for the presence tokens of nodes.
    pub fn any_alive_node(&self) -> String {
        format!("{}/alive/node/*", self.prefix)
    }
}

impl fmt::Display for Key {
    /// The key without the fleet's prefix.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Key::Certificate(fingerprint) => write!(f, "wire/card/{fingerprint}"),
            Key::Knowledge(node) => write!(f, "wire/knowledge/{node}"),
            Key::Gossip(node) => write!(f, "wire/gossip/{node}"),
            Key::Swim(node) => write!(f, "wire/swim/{node}"),
            Key::Raft(member, call) => write!(f, "wire/raft/{member:016x}/{}", call.as_str()),
            Key::Bootstrap(node) => write!(f, "wire/found/{node}"),
            Key::Beacon => f.write_str("wire/beacon"),
            Key::Bid(robot) => write!(f, "wire/bid/{robot}"),
            Key::Award(robot) => write!(f, "wire/award/{robot}"),
            Key::Report(node) => write!(f, "wire/report/{node}"),
            Key::ActiveMissions(node) => write!(f, "wire/live/{node}"),
            Key::Changed => f.write_str("wire/changed"),
            Key::Signal(mission, role) => write!(f, "wire/signal/{mission}/{role}"),
            Key::SignalHistory(mission, role) => write!(f, "wire/said/{mission}/{role}"),
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
        ["wire", "card", fingerprint] => Key::Certificate(fingerprint.parse().ok()?),
        ["wire", "knowledge", node] => Key::Knowledge(node.parse().ok()?),
        ["wire", "gossip", node] => Key::Gossip(node.parse().ok()?),
        ["wire", "swim", node] => Key::Swim(node.parse().ok()?),
        ["wire", "raft", member, call] if member.len() == 16 => {
            Key::Raft(u64::from_str_radix(member, 16).ok()?, RaftCall::parse(call)?)
        }
        ["wire", "found", node] => Key::Bootstrap(node.parse().ok()?),
        ["wire", "beacon"] => Key::Beacon,
        ["wire", "bid", robot] => Key::Bid(robot.parse().ok()?),
        ["wire", "award", robot] => Key::Award(robot.parse().ok()?),
        ["wire", "report", node] => Key::Report(node.parse().ok()?),
        ["wire", "live", node] => Key::ActiveMissions(node.parse().ok()?),
        ["wire", "changed"] => Key::Changed,
        ["wire", "signal", mission, role] => Key::Signal(mission.parse().ok()?, role.parse().ok()?),
        ["wire", "said", mission, role] => Key::SignalHistory(mission.parse().ok()?, role.parse().ok()?),
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

/// A view, by the segments behind `view/`.
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
    fn every_key_reads_back_as_what_was_written() {
        let keys = Keys::new(&FleetId::new("ward").unwrap());
        for key in all() {
            let text = keys.write(&key);
            assert!(text.starts_with("consort/ward/"), "{text}");
            assert_eq!(keys.read(&text).as_ref(), Some(&key), "{text}");
        }
    }

    #[test]
    fn every_key_but_tokens_has_a_kind_to_count_it_by() {
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
    fn no_two_keys_are_written_alike() {
        let keys = Keys::new(&FleetId::new("ward").unwrap());
        let texts: std::collections::BTreeSet<String> = all().iter().map(|key| keys.write(key)).collect();
        assert_eq!(texts.len(), all().len());
    }

    #[test]
    fn what_concerns_missions_is_within_a_cluster() {
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
    fn what_is_not_a_key_of_this_fleet_is_none() {
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
