//! Every key with who says it, how, in which encoding, and what: for people who look in with a client of their own.
//!
//! The table and [`Key::about`] are made of the same lines, and the compiler sees to it that no kind of key is missing.

use super::{ApiCall, BodyCall, Key, PeopleCall, RaftCall};
use serde::Serialize;

/// What a key is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct KeyInfo {
    /// The key behind `consort/{fleet}/`, with names for what varies: `wire/award/{robot}`.
    pub pattern: &'static str,
    /// Who publishes, answers or announces it.
    pub who: &'static str,
    /// What that one does with it.
    pub usage: KeyUsage,
    /// How the content is encoded: a MIME type, or nothing where there is none.
    pub encoding: &'static str,
    /// What it is about.
    pub what: &'static str,
}

/// How a key is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum KeyUsage {
    /// It is published: subscribe to it.
    Publishes,
    /// It is answered: get it, with a payload where one is needed.
    Answers,
    /// It is there as long as somebody is: a liveliness token.
    Announces,
}

impl KeyUsage {
    /// One word for it.
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
    ($($key:pat => $pattern:literal, $who:literal $usage:ident $encoding:expr, $what:literal;)*) => {
        /// Every kind of key there is.
        pub const TABLE: &[KeyInfo] = &[$(
            KeyInfo { pattern: $pattern, who: $who, usage: $usage, encoding: $encoding, what: $what },
        )*];

        impl Key {
            /// What keys of this kind are for.
            pub fn info(&self) -> KeyInfo {
                match self {
                    $($key => KeyInfo { pattern: $pattern, who: $who, usage: $usage, encoding: $encoding, what: $what },)*
                }
            }
        }
    };
}

table! {
    Key::ViewFleet => "view/fleet", "any node" Answers JSON, "the nodes, with the age of what is known of each, and the ensembles";
    Key::ViewRobot(_) => "view/robot/{robot}", "any node" Answers JSON, "one robot: place, battery, skills, what it holds";
    Key::ViewEnsembles => "view/ensembles", "any node" Answers JSON, "who is a member of each ensemble, and why the others are not";
    Key::ViewCoordinator => "view/coordinator", "any node" Answers JSON, "who coordinates, in which term and since when; voters and observers";
    Key::ViewMissions => "view/missions", "any node" Answers JSON, "all missions, briefly";
    Key::ViewMission(_) => "view/mission/{mission}", "any node" Answers JSON, "one mission: its tree of tasks, roles, holders, epochs";
    Key::ViewAuctions => "view/auctions", "any node" Answers JSON, "the latest auction of each mission: bids, refusals, and why the winner won";
    Key::ViewMap => "view/map", "any node" Answers JSON, "places, lanes, doors, lifts and walls of the fleet's map";
    Key::ViewHealth => "view/health", "any node" Answers JSON, "what is the matter, in words, each with a level: ok, warning or error";
    Key::ViewWorld => "view/world", "any node" Answers JSON, "the world as the host of bodies sees it, where there is one";
    Key::Seen(..) => "seen/{node}/{view}", "the node" Answers JSON, "the same views, as this one node has them by itself";
    Key::Api(ApiCall::Submit) => "api/submit", "the coordinator" Answers JSON, "asks for a mission; answered once it is committed";
    Key::Api(ApiCall::Cancel) => "api/cancel", "the coordinator" Answers JSON, "withdraws a mission";
    Key::Api(ApiCall::Resolve) => "api/rescued", "the coordinator" Answers JSON, "says that a person has taken care of what a mission left behind";
    Key::Api(ApiCall::Backup) => "api/backup", "the coordinator" Answers JSON, "a copy of the ledger, with all that is acknowledged, for `consort restore`";
    Key::Api(ApiCall::Upgrade) => "api/upgrade", "the coordinator" Answers JSON, "which versions of the wire each node reads; has the fleet write the next one";
    Key::Api(ApiCall::Get) => "api/get", "any node" Answers JSON, "one mission, as view/mission/{mission}";
    Key::Api(ApiCall::List) => "api/list", "any node" Answers JSON, "all missions, as view/missions";
    Key::Api(ApiCall::Explain) => "api/explain", "any node" Answers JSON, "why each robot did or did not get each role of a mission";
    Key::Api(ApiCall::Help) => "api/help", "any node" Answers JSON, "every call: what it takes, an example, JSON Schemas";
    Key::Help(_) => "api/{call}/help", "any node" Answers JSON, "the same of one call";
    Key::Leave(_) => "api/leave/{node}", "the node" Answers JSON, "asks a node to leave the fleet for good";
    Key::Events(_) => "events/{node}", "the node" Publishes JSON, "what happens there, as it happens, with sequence numbers";
    Key::AliveRobot(_) => "alive/robot/{robot}", "the robot's node" Announces "", "the robot is there";
    Key::AliveNode(_) => "alive/node/{node}", "the node" Announces "", "the node is there";
    Key::AliveCoordinator(..) => "alive/coordinator/{term}/{node}", "the coordinator" Announces "", "this node coordinates in this term";
    Key::Certificate(_) => "wire/card/{fingerprint}", "its bearer" Answers WIRE, "the certificate by which a node seals what it says";
    Key::Knowledge(_) => "wire/knowledge/{node}", "the node" Publishes WIRE, "its record: what it says of itself";
    Key::Gossip(_) => "wire/gossip/{node}", "the node" Answers WIRE, "compares what both know, and hands over what the asker lacks";
    Key::Swim(_) => "wire/swim/{node}", "the others" Publishes WIRE, "packets of failure detection for the node";
    Key::Raft(_, RaftCall::Vote | RaftCall::Append | RaftCall::Snapshot | RaftCall::PreVote | RaftCall::TransferLeadership | RaftCall::Heartbeat) =>
        "wire/raft/{member}/{call}", "the member" Answers WIRE, "consensus: vote, append, snapshot, canvass, succeed, beat";
    Key::Bootstrap(_) => "wire/found/{node}", "nodes that may vote" Answers WIRE, "whether one may found a ledger";
    Key::Beacon => "wire/beacon", "the coordinator" Publishes WIRE, "that it coordinates, in which term, and who keeps the ledger";
    Key::Bid(_) => "wire/bid/{robot}", "the robot" Answers WIRE, "the coordinator's call for bids";
    Key::Award(_) => "wire/award/{robot}", "the robot" Answers WIRE, "that it is given a role, or is to put it down";
    Key::Report(_) => "wire/report/{node}", "the coordinator" Answers WIRE, "robots' reports, and with them the renewal of their leases";
    Key::ActiveMissions(_) => "wire/live/{node}", "the coordinator" Answers WIRE, "which missions are under way, with the plans of people";
    Key::Changed => "wire/changed", "the coordinator" Publishes WIRE, "that missions under way have changed";
    Key::Signal(..) => "wire/signal/{mission}/{role}", "robots and attendants" Publishes WIRE, "a message of the mission's plan for this role";
    Key::SignalHistory(..) => "wire/said/{mission}/{role}", "the role's holder" Answers WIRE, "which messages the role has sent";
    Key::Body(_, BodyCall::Command) => "wire/body/{robot}/command", "the host of the body" Answers WIRE, "goals for a robot's body";
    Key::Body(_, BodyCall::State) => "wire/body/{robot}/state", "the host of the body" Publishes WIRE, "telemetry, and the state of goals";
    Key::People(PeopleCall::Ask) => "wire/people/ask", "the host of people" Answers WIRE, "asks a person to do something, or dismisses one";
    Key::People(PeopleCall::Done) => "wire/people/done", "the host of people" Publishes WIRE, "what a person has done";
    Key::World => "wire/world", "the host of bodies" Answers JSON, "how its world looks; view/world passes it on";
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// Whether a key is written as a pattern says.
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
    fn every_key_is_in_the_table_as_it_is_written() {
        let mut met = BTreeSet::new();
        for key in crate::keys::tests::all() {
            let about = key.info();
            assert!(TABLE.contains(&about), "{key}");
            assert!(fits(about.pattern, &key.to_string()), "{key} is not as {}", about.pattern);
            met.insert(about.pattern);
        }
        // And nothing is in the table that is no key.
        assert_eq!(met, TABLE.iter().map(|about| about.pattern).collect());
        assert_eq!(met.len(), TABLE.len(), "no pattern stands there twice");
    }

    #[test]
    fn what_is_for_people_is_json_and_what_is_between_nodes_is_not() {
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
