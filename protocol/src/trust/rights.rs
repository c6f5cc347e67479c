//! What the bearer of a certificate may say on which key, and whether it says it in its own name.
//!
//! | key | publishes | asks | answers |
//! |---|---|---|---|
//! | `wire/knowledge/{node}` | that node, of itself | – | – |
//! | `wire/swim/{node}` | any node | – | – |
//! | `wire/gossip/{node}` | – | any node | that node |
//! | `wire/card/{fingerprint}` | – | (unsealed) | (unsealed: what is answered proves itself) |
//! | `wire/raft/{member}/{call}` | – | voters | voters |
//! | `wire/found/{node}` | – | voters, in their own name | that node, if a voter |
//! | `wire/beacon`, `wire/changed` | voters, in their own name | – | – |
//! | `wire/bid/{robot}` | – | voters | that robot, in its own name |
//! | `wire/award/{robot}` | – | voters | that robot |
//! | `wire/report/{node}` | – | robots, of themselves; hosts, for people | that node, if a voter |
//! | `wire/live/{node}` | – | any node | that node, if a voter |
//! | `wire/signal/{mission}/{role}` | robots and hosts | – | – |
//! | `wire/said/{mission}/{role}` | – | any node | robots and hosts |
//! | `wire/body/{robot}/command` | – | that robot | hosts |
//! | `wire/body/{robot}/state` | hosts | – | – |
//! | `wire/people/ask` | – | hosts | hosts |
//! | `wire/people/done` | hosts | – | – |
//! | `wire/world` | – | any node | hosts |
//! | `events/{node}` | that node, of what happened there | – | – |
//! | `view/**`, `api/{call}/help`, `api/{call}` that changes nothing | – | (by the links) | any node |
//! | `seen/{node}/**`, `api/leave/{node}` | – | (by the links) | that node |
//! | `api/{call}` of the coordinator's | – | (by the links) | voters |
//!
//! Persons publish and answer nothing. What this cannot tell: whether a robot holds the role for which it signals (hearers
//! compare the epoch), whether a voter leads (terms and majorities do), and what a node hands on of a third one's knowledge.

use super::identity::{Identity, NodeRole, Principal};
use crate::auction::BidResponse;
use crate::codec;
use crate::ids::NodeId;
use crate::keys::ApiCall;
use crate::message::{Beacon, BootstrapRequest, ClusterEnvelope, MissionsChanged, RecordUpdate, Report};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeSet;

#[cfg(test)]
mod tests;

/// What is done on a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Operation {
    /// Something is published.
    Publish,
    /// Something is asked.
    Query,
    /// Something is answered.
    Reply,
}

impl Operation {
    fn word(self) -> &'static str {
        match self {
            Operation::Publish => "publish on",
            Operation::Query => "ask",
            Operation::Reply => "answer on",
        }
    }
}

/// Why somebody may not say what was said. Whoever hears it takes no notice of the message.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AccessDenied {
    /// The bearer may not do this there at all.
    #[error("{bearer} may not {act} {key}")]
    Operation {
        /// Who.
        bearer: String,
        /// What, in words.
        act: &'static str,
        /// Where, below the fleet's prefix.
        key: String,
    },
    /// It was said in somebody else's name.
    #[error("{bearer} speaks on {key} in the name of {name}")]
    Impersonation {
        /// Who.
        bearer: String,
        /// Where, below the fleet's prefix.
        key: String,
        /// Whose name it used.
        name: String,
    },
    /// It cannot be read, so nobody knows in whose name it is.
    #[error("what {bearer} says on {key} cannot be read: {problem}")]
    Unreadable {
        /// Who.
        bearer: String,
        /// Where, below the fleet's prefix.
        key: String,
        /// What is wrong with it.
        problem: String,
    },
}

/// Whether the bearer may do this on a key (below the fleet's prefix: `wire/bid/*`) and with this payload.
///
/// # Errors
/// [`Denied`] says why not.
pub fn authorize(who: &Identity, act: Operation, key: &str, payload: &[u8]) -> Result<(), AccessDenied> {
    let claim = Claim { who, key, payload };
    let Principal::Node { name, roles } = &who.principal else { return Err(claim.denied(act)) };
    let bearer = Node { name, roles };
    match claimed_name(&bearer, act, key) {
        None => Err(claim.denied(act)),
        Some(Says::Anything) => Ok(()),
        Some(Says::Statement) => {
            let said =
                codec::decode_any_version(claim.payload).map_err(|problem| claim.unreadable(problem.to_string()))?;
            claim.is_own(
                name,
                match said {
                    RecordUpdate::Record(record) => Some(record.owner.to_string()),
                    RecordUpdate::Refresh { .. } => None,
                },
            )
        }
        Some(Says::Founder) => claim.named(name, |said: &BootstrapRequest| Some(said.node.to_string())),
        Some(Says::Beacon) => claim.named_within(name, |said: &Beacon| Some(said.node.to_string())),
        Some(Says::Changed) => claim.named_within(name, |said: &MissionsChanged| Some(said.node.to_string())),
        Some(Says::Report) => claim.named_within(name, |said: &Report| Some(said.robot.to_string())),
        Some(Says::Event) => claim.is_own(name, Some(claim.teller()?.to_string())),
        Some(Says::Tender) => claim.named(name, |said: &BidResponse| Some(said.robot.to_string())),
    }
}

/// What is said there, as far as it names its author.
enum Says {
    Anything,
    Statement,
    Founder,
    Beacon,
    Changed,
    Report,
    Tender,
    Event,
}

struct Node<'a> {
    name: &'a NodeId,
    roles: &'a BTreeSet<NodeRole>,
}

impl Node<'_> {
    fn is(&self, role: NodeRole) -> bool {
        self.roles.contains(&role)
    }

    fn called(&self, name: &str) -> bool {
        self.name.as_str() == name
    }
}

/// What the node may say there, if anything.
fn claimed_name(node: &Node<'_>, act: Operation, key: &str) -> Option<Says> {
    use NodeRole::{Host, Robot, Voter};
    use Operation::{Publish, Query, Reply};
    let segments: Vec<&str> = key.split('/').collect();
    let anything = |may: bool| may.then_some(Says::Anything);
    match (segments.as_slice(), act) {
        (&["wire", "knowledge", name], Publish) => node.called(name).then_some(Says::Statement),
        (&["wire", "swim", _], Publish) => anything(true),
        (&["wire", "gossip", _], Ask) => anything(true),
        (&["wire", "gossip", name], Answer) => anything(node.called(name)),
        (&["wire", "raft", _, _], Query | Reply) => anything(node.is(Voter)),
        (&["wire", "found", _], Ask) => node.is(Voter).then_some(Says::Founder),
        (&["wire", "found", name], Answer) => anything(node.is(Voter) && node.called(name)),
        (&["wire", "beacon"], Publish) => node.is(Voter).then_some(Says::Beacon),
        (&["wire", "changed"], Publish) => node.is(Voter).then_some(Says::Changed),
        (&["wire", "bid" | "award", _], Ask) => anything(node.is(Voter)),
        (&["wire", "bid", name], Answer) => (node.is(Robot) && node.called(name)).then_some(Says::Tender),
        (&["wire", "award", name], Answer) => anything(node.is(Robot) && node.called(name)),
        (&["wire", "report", _], Ask) if node.is(Host) => anything(true),
        (&["wire", "report", _], Ask) => node.is(Robot).then_some(Says::Report),
        (&["wire", "report" | "live", name], Answer) => anything(node.is(Voter) && node.called(name)),
        (&["wire", "live", _] | &["wire", "said", _, _] | &["wire", "world"], Ask) => anything(true),
        (&["wire", "signal", _, _], Publish) | (&["wire", "said", _, _], Reply) => {
            anything(node.is(Robot) || node.is(Host))
        }
        (&["wire", "body", name, "command"], Ask) => anything(node.is(Robot) && node.called(name)),
        (&["wire", "body", _, "command"] | &["wire", "world"], Answer) => anything(node.is(Host)),
        (&["wire", "body", _, "state"] | &["wire", "people", "done"], Publish) => anything(node.is(Host)),
        (&["wire", "people", "ask"], Query | Reply) => anything(node.is(Host)),
        (&["events", name], Publish) => node.called(name).then_some(Says::Event),
        (&["view", ..] | &["api", _, "help"], Answer) => anything(true),
        (&["seen", name, ..] | &["api", "leave", name], Answer) => anything(node.called(name)),
        (&["api", call], Answer) => anything(ApiCall::parse(call)?.is_read_only() || node.is(Voter)),
        _ => None,
    }
}

/// An event, as far as it says where it happened.
#[derive(Deserialize)]
struct Teller {
    node: NodeId,
}

/// Something said by somebody.
struct Claim<'a> {
    who: &'a Identity,
    key: &'a str,
    payload: &'a [u8],
}

impl Claim<'_> {
    fn denied(&self, act: Operation) -> AccessDenied {
        AccessDenied::Operation { bearer: self.who.principal.to_string(), act: act.word(), key: self.key.to_owned() }
    }

    fn named<T: DeserializeOwned>(
        &self,
        own: &NodeId,
        name: impl FnOnce(&T) -> Option<String>,
    ) -> Result<(), AccessDenied> {
        let said: T = self.read(self.payload)?;
        self.is_own(own, name(&said))
    }

    /// The same of what is said within a cluster.
    fn named_within<T: DeserializeOwned>(
        &self,
        own: &NodeId,
        name: impl FnOnce(&T) -> Option<String>,
    ) -> Result<(), AccessDenied> {
        let within: ClusterEnvelope = self.read(self.payload)?;
        let said: T = self.read(&within.payload)?;
        self.is_own(own, name(&said))
    }

    fn read<T: DeserializeOwned>(&self, bytes: &[u8]) -> Result<T, AccessDenied> {
        codec::decode(bytes).map_err(|problem| self.unreadable(problem.to_string()))
    }

    /// Where an event says that it happened.
    fn teller(&self) -> Result<NodeId, AccessDenied> {
        let told = serde_json::from_slice::<Teller>(self.payload);
        told.map(|told| told.node).map_err(|problem| self.unreadable(problem.to_string()))
    }

    fn unreadable(&self, problem: String) -> AccessDenied {
        AccessDenied::Unreadable { bearer: self.who.principal.to_string(), key: self.key.to_owned(), problem }
    }

    fn is_own(&self, own: &NodeId, name: Option<String>) -> Result<(), AccessDenied> {
        match name {
            Some(name) if name != own.as_str() => Err(AccessDenied::Impersonation {
                bearer: self.who.principal.to_string(),
                key: self.key.to_owned(),
                name,
            }),
            _ => Ok(()),
        }
    }
}
