//! Table of all keys with owner, usage, encoding and content, for users with clients of their own.
//!
//! The table and [`Key::info`] are generated from the same lines, and the compiler ensures that no
//! kind of key is missing.

use super::call::{ApiCall, DriverCall, PeopleCall, RaftCall};
use super::key::Key;
use serde::Serialize;

/// Description of a kind of key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct KeyInfo {
    /// Key after `consort/{fleet}/`, with variables in braces: `wire/award/{robot}`.
    pub pattern: &'static str,
    /// Node that publishes, answers or announces it.
    pub owner: &'static str,
    /// Usage of the key by its owner.
    pub usage: KeyUsage,
    /// Encoding of the content: a MIME type, or empty if there is no content.
    pub encoding: &'static str,
    /// Content of the messages.
    pub what: &'static str,
}

/// Usage of a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum KeyUsage {
    /// Published: subscribe to it.
    Publishes,
    /// Answered: query it, with a payload where needed.
    Answers,
    /// Present while its owner is present: a liveliness token.
    Announces,
}

impl KeyUsage {
    /// Returns the name.
    pub fn as_str(self) -> &'static str {
        match self {
            Publishes => "publishes",
            Answers => "answers",
            Announces => "announces",
        }
    }
}

use KeyUsage::{Announces, Answers, Publishes};

const WIRE: &str = "application/octet-stream";
const JSON: &str = "application/json";

macro_rules! table {
    ($($key:pat => $pattern:literal, $owner:literal $usage:ident $encoding:expr, $what:literal;)*) => {
        /// All kinds of keys.
        pub const TABLE: &[KeyInfo] = &[$(
            KeyInfo { pattern: $pattern, owner: $owner, usage: $usage, encoding: $encoding, what: $what },
        )*];

        impl Key {
            /// Returns the description of this kind of key.
            pub fn info(&self) -> KeyInfo {
                match self {
                    $($key => KeyInfo { pattern: $pattern, owner: $owner, usage: $usage, encoding: $encoding, what: $what },)*
                }
            }
        }
    };
}

table! {
    Key::ViewFleet => "view/fleet", "any node" Answers JSON, "the nodes, each with the age of its record, and the ensembles";
    Key::ViewRobot(_) => "view/robot/{robot}", "any node" Answers JSON, "a robot: place, battery, skills, readings, and the role that it holds";
    Key::ViewEnsembles => "view/ensembles", "any node" Answers JSON, "the members of each ensemble, and the reason for each node that is not a member";
    Key::ViewEnsemble(_) => "view/ensemble/{ensemble}", "any node" Answers JSON, "the values that the members of an ensemble exchange, if it lists any";
    Key::ViewCoordinator => "view/coordinator", "any node" Answers JSON, "the coordinator, its term and start time; voters and learners";
    Key::ViewMissions => "view/missions", "any node" Answers JSON, "all missions, in brief";
    Key::ViewSchedules => "view/schedules", "any node" Answers JSON, "the schedules of missions, with their next occurrences";
    Key::ViewAudit => "view/audit", "any node" Answers JSON, "who requested which change, and when";
    Key::ViewRequests => "view/requests", "any node" Answers JSON, "the requests to people, open ones first";
    Key::ViewMission(_) => "view/mission/{mission}", "any node" Answers JSON, "a mission: its task tree, roles, holders, epochs";
    Key::ViewAuctions => "view/auctions", "any node" Answers JSON, "the latest auction of each mission: bids, refusals, and the reason for the result";
    Key::ViewMap => "view/map", "any node" Answers JSON, "places, lanes, doors, lifts and walls of the fleet's map";
    Key::ViewHealth => "view/health", "any node" Answers JSON, "health findings as text, each with a level: ok, warning or error";
    Key::ViewWorld => "view/world", "any node" Answers JSON, "the world from the simulator, if there is one";
    Key::Seen(..) => "seen/{node}/{view}", "the node" Answers JSON, "the same views, from this node alone";
    Key::Api(ApiCall::Submit) => "api/submit", "the coordinator" Answers JSON, "submits a mission; the reply follows the commit";
    Key::Api(ApiCall::Cancel) => "api/cancel", "the coordinator" Answers JSON, "cancels a mission";
    Key::Api(ApiCall::CancelMissions) => "api/cancel_missions", "the coordinator" Answers JSON, "cancels several missions, by name or by a condition; or lists them";
    Key::Api(ApiCall::Priority) => "api/priority", "the coordinator" Answers JSON, "changes the priority of a mission that waits or runs";
    Key::Api(ApiCall::Reassign) => "api/reassign", "the coordinator" Answers JSON, "gives a role to another robot, or pins it to a robot";
    Key::Api(ApiCall::Resolve) => "api/resolve", "the coordinator" Answers JSON, "resolves an intervention: a person has taken care of the items of a mission";
    Key::Api(ApiCall::Answer) => "api/answer", "the coordinator" Answers JSON, "answers a request to a person; the first answer counts";
    Key::Api(ApiCall::Backup) => "api/backup", "the coordinator" Answers JSON, "a backup of the ledger, with all acknowledged entries, for `consort restore`";
    Key::Api(ApiCall::Upgrade) => "api/upgrade", "the coordinator" Answers JSON, "the wire versions that each node reads; switches the fleet to the next version";
    Key::Api(ApiCall::Get) => "api/get", "any node" Answers JSON, "a mission, as in view/mission/{mission}";
    Key::Api(ApiCall::List) => "api/list", "any node" Answers JSON, "all missions, as in view/missions";
    Key::Api(ApiCall::Schedule) => "api/schedule", "the coordinator" Answers JSON, "adds, pauses, resumes or removes a schedule";
    Key::Api(ApiCall::Hold) => "api/hold", "the coordinator" Answers JSON, "holds robots: they stand still, and keep their roles";
    Key::Api(ApiCall::Release) => "api/release", "the coordinator" Answers JSON, "releases held robots";
    Key::Api(ApiCall::Maintenance) => "api/maintenance", "the coordinator" Answers JSON, "takes robots out of service once their roles have ended, or returns them to service";
    Key::Api(ApiCall::Close) => "api/close", "the coordinator" Answers JSON, "closes zones, places or lanes: no robot enters them";
    Key::Api(ApiCall::Open) => "api/open", "the coordinator" Answers JSON, "opens closed zones, places or lanes";
    Key::Api(ApiCall::Limit) => "api/limit", "the coordinator" Answers JSON, "sets or clears speed limits in zones, at places or on lanes";
    Key::Api(ApiCall::Alarm) => "api/alarm", "the coordinator" Answers JSON, "raises an alarm that the fleet file declares, or clears alarms";
    Key::Api(ApiCall::Audit) => "api/audit", "any node" Answers JSON, "the changes that people have requested, as in view/audit";
    Key::Api(ApiCall::Schedules) => "api/schedules", "any node" Answers JSON, "the schedules, as in view/schedules";
    Key::Api(ApiCall::Requests) => "api/requests", "any node" Answers JSON, "the requests to people, as in view/requests";
    Key::Api(ApiCall::Explain) => "api/explain", "any node" Answers JSON, "for each role of a mission, the reason for which each robot got it or not";
    Key::Api(ApiCall::Help) => "api/help", "any node" Answers JSON, "all calls: parameters, an example, JSON Schemas";
    Key::Help(_) => "api/{call}/help", "any node" Answers JSON, "the same for a single call";
    Key::Leave(_) => "api/leave/{node}", "the node" Answers JSON, "asks a node to leave the fleet permanently";
    Key::Events(_) => "events/{node}", "the node" Publishes JSON, "events of the node, as they happen, with sequence numbers";
    Key::AliveRobot(_) => "alive/robot/{robot}", "the robot's node" Announces "", "the robot is present";
    Key::AliveNode(_) => "alive/node/{node}", "the node" Announces "", "the node is present";
    Key::AliveCoordinator(..) => "alive/coordinator/{term}/{node}", "the coordinator" Announces "", "this node is coordinator in this term";
    Key::KnownCertificate(_) => "wire/certificate/{fingerprint}/known", "any node" Answers WIRE, "the certificate, if the node knows it: for nodes without a path to its principal";
    Key::Certificate(_) => "wire/certificate/{fingerprint}", "its principal" Answers WIRE, "the certificate that verifies the messages of a node";
    Key::Knowledge(_) => "wire/knowledge/{node}", "the node" Publishes WIRE, "the record of the node";
    Key::Motion(_) => "wire/motion/{node}", "the node" Publishes WIRE, "in a large fleet: place, pose and charge of the node's robot, and that its record is current";
    Key::Gossip(_) => "wire/gossip/{node}", "the node" Answers WIRE, "compares the records of two nodes, and returns those that the requester lacks";
    Key::Swim(_) => "wire/swim/{node}", "the others" Publishes WIRE, "failure detection packets for the node";
    Key::Raft(_, RaftCall::Vote | RaftCall::Append | RaftCall::Snapshot | RaftCall::PreVote | RaftCall::TransferLeadership | RaftCall::Heartbeat | RaftCall::SnapshotBlocks) =>
        "wire/raft/{member}/{call}", "the member" Answers WIRE, "consensus: vote, append, snapshot, pre_vote, transfer_leadership, heartbeat, snapshot_blocks";
    Key::Bootstrap(_) => "wire/bootstrap/{node}", "nodes that may vote" Answers WIRE, "permission to create a ledger";
    Key::Beacon => "wire/beacon", "the coordinator" Publishes WIRE, "the coordinator, its term, and the voters of the ledger";
    Key::Bid(_) => "wire/bid/{robot}", "the robot" Answers WIRE, "the coordinator's call for bids";
    Key::Award(_) => "wire/award/{robot}", "the robot" Answers WIRE, "the award or the revocation of a role, and the orders of people";
    Key::Report(_) => "wire/report/{node}", "the coordinator" Answers WIRE, "reports of robots, which also renew their leases";
    Key::Clock(_) => "wire/clock/{node}", "nodes that may vote" Answers WIRE, "the time of day of the node, for the coordinator";
    Key::Leader(_) => "wire/leader/{node}", "nodes that may vote" Answers WIRE, "the leader that the node follows: by it robots confirm their coordinator";
    Key::Signal(..) => "wire/signal/{mission}/{role}", "robots, and the coordinator for people" Publishes WIRE, "a signal of the mission's plan for this role";
    Key::SignalHistory(..) => "wire/signal_history/{mission}/{role}", "the robot that holds the role" Answers WIRE, "the signals that the role has sent";
    Key::Ensemble(..) => "wire/ensemble/{ensemble}/{robot}", "the robot" Publishes WIRE, "values of the robot for the members of the ensemble";
    Key::Driver(_, DriverCall::Command) => "wire/driver/{robot}/command", "the driver server" Answers WIRE, "goals for a robot";
    Key::Driver(_, DriverCall::State) => "wire/driver/{robot}/state", "the driver server" Publishes WIRE, "telemetry, and the state of goals";
    Key::People(PeopleCall::Ask) => "wire/people/ask", "the host of simulated people" Answers WIRE, "asks a person to do something, or dismisses one";
    Key::People(PeopleCall::Done) => "wire/people/done", "the host of simulated people" Publishes WIRE, "the tasks that people have completed";
    Key::World => "wire/world", "the simulator" Answers JSON, "the state of its world; view/world passes it on. With the name of a robot as payload: the readings of its range sensors";
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// Checks whether a key matches a pattern.
    fn fits(pattern: &str, key: &str) -> bool {
        let mut segments = key.split('/');
        for part in pattern.split('/') {
            let segment = segments.next();
            match part {
                "{view}" => return segment.is_some(),
                part if part.starts_with('{') => {
                    if segment.is_none() {
                        return false;
                    }
                }
                part => {
                    if segment != Some(part) {
                        return false;
                    }
                }
            }
        }
        segments.next().is_none()
    }

    #[test]
    fn every_key_matches_its_row_of_the_table() {
        let mut seen = BTreeSet::new();
        for key in crate::keys::tests::all() {
            let about = key.info();
            assert!(TABLE.contains(&about), "{key}");
            assert!(fits(about.pattern, &key.to_string()), "{key} does not match {}", about.pattern);
            seen.insert(about.pattern);
        }
        // Every row of the table belongs to a key.
        assert_eq!(seen, TABLE.iter().map(|about| about.pattern).collect());
        assert_eq!(seen.len(), TABLE.len(), "each pattern occurs once");
    }

    #[test]
    fn keys_for_people_use_json_and_keys_between_nodes_do_not() {
        for about in TABLE {
            let encoding = match about.pattern.split('/').next() {
                Some("wire") if about.pattern != "wire/world" => WIRE,
                Some("alive") => "",
                _ => JSON,
            };
            assert_eq!(about.encoding, encoding, "{}", about.pattern);
        }
    }
}
