//! Permissions of a principal on each key, and the check that it publishes only in its own name.
//!
//! | key | publishes | queries | replies |
//! |---|---|---|---|
//! | `wire/knowledge/{node}` | that node, of itself | – | – |
//! | `wire/motion/{node}` | that node | – | – |
//! | `wire/swim/{node}` | any node | – | – |
//! | `wire/gossip/{node}` | – | any node | that node |
//! | `wire/certificate/{fingerprint}` | – | (unsigned) | (unsigned: the certificate proves itself) |
//! | `wire/certificate/{fingerprint}/known` | – | (unsigned) | (unsigned) |
//! | `wire/raft/{member}/{call}` | – | voters | voters |
//! | `wire/bootstrap/{node}` | – | voters, in their own name | that node, if a voter |
//! | `wire/beacon` | voters, in their own name | – | – |
//! | `wire/bid/{robot}` | – | voters | that robot, in its own name |
//! | `wire/award/{robot}` | – | voters | that robot |
//! | `wire/report/{node}` | – | robots, in their own name | that node, if a voter |
//! | `wire/clock/{node}` | – | voters | that node, if a voter |
//! | `wire/leader/{node}` | – | robots | that node, if a voter |
//! | `wire/signal/{mission}/{role}` | robots and voters | – | – |
//! | `wire/signal_history/{mission}/{role}` | – | any node | robots |
//! | `wire/ensemble/{ensemble}/{robot}` | that robot | – | – |
//! | `wire/driver/{robot}/command` | – | that robot | hosts that serve it |
//! | `wire/driver/{robot}/state` | hosts that serve it | – | – |
//! | `wire/people/ask` | – | voters | hosts |
//! | `wire/people/done` | hosts | – | – |
//! | `wire/world` | – | any node | hosts |
//! | `events/{node}` | that node, of what happened there | – | – |
//! | `view/**`, `api/{call}/help`, `api/{call}` that changes nothing | – | (by the links) | any node |
//! | `seen/{node}/**`, `api/leave/{node}` | – | (by the links) | that node |
//! | `api/{call}` of the coordinator's | – | (by the links) | voters |
//!
//! The nodes that may reply to a query may also refuse it. Persons publish nothing and reply to
//! nothing. Not checked here, but by the receivers, which learn the verified author of each message:
//! that a robot holds the role for which it reports or signals; that a host serves the person for
//! whom it replies; that a voter leads (terms and majorities ensure it, and robots query the other voters); and the
//! content of a third node's record that a node passes on.

use crate::auction::BidResponse;
use crate::codec;
use crate::ids::NodeId;
use crate::keys::ApiCall;
use crate::message::{Beacon, BootstrapRequest, ClusterEnvelope, RecordUpdate, Report};
use crate::trust::{Identity, NodeRole, Principal};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeSet;

#[cfg(test)]
mod tests;

/// Operation on a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Operation {
    /// Publication.
    Publish,
    /// Query.
    Query,
    /// Reply.
    Reply,
    /// Refusal of a query, on the query's key: permitted to the nodes that may reply to the query.
    Refuse,
}

impl Operation {
    fn as_str(self) -> &'static str {
        match self {
            Operation::Publish => "publish on",
            Operation::Query => "query",
            Operation::Reply => "reply on",
            Operation::Refuse => "refuse",
        }
    }
}

/// Error: a message is not permitted. The receiver ignores it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AccessDenied {
    /// The principal may not perform this operation on the key.
    #[error("{principal} may not {operation} {key}")]
    Operation {
        /// Principal.
        principal: String,
        /// Operation, as text.
        operation: &'static str,
        /// Key, below the fleet's prefix.
        key: String,
    },
    /// The message names another node as its author.
    #[error("{principal} may not send on {key} in the name of {name}")]
    Impersonation {
        /// Principal.
        principal: String,
        /// Key, below the fleet's prefix.
        key: String,
        /// Name of the author in the message.
        name: String,
    },
    /// The message cannot be decoded, so its author cannot be checked.
    #[error("message of {principal} on {key} cannot be decoded: {problem}")]
    Unreadable {
        /// Principal.
        principal: String,
        /// Key, below the fleet's prefix.
        key: String,
        /// Error of the decoder.
        problem: String,
    },
}

/// Checks whether the principal may perform the operation on a key (below the fleet's prefix:
/// `wire/bid/*`) with this payload.
///
/// # Errors
/// [`AccessDenied`] with the reason.
pub fn authorize(identity: &Identity, operation: Operation, key: &str, payload: &[u8]) -> Result<(), AccessDenied> {
    let request = Request { identity, key, payload };
    let Principal::Node { name, roles, .. } = &identity.principal else { return Err(request.denied(operation)) };
    let node = Node { identity, name, roles };
    if operation == Operation::Refuse {
        let own_key = key.replace('*', name.as_str());
        return permitted_content(&node, Operation::Reply, &own_key)
            .map(|_| ())
            .ok_or_else(|| request.denied(operation));
    }
    match permitted_content(&node, operation, key) {
        None => Err(request.denied(operation)),
        Some(NamedContent::None) => Ok(()),
        Some(NamedContent::RecordUpdate) => {
            let message = codec::decode_any_version(request.payload)
                .map_err(|problem| request.unreadable(problem.to_string()))?;
            request.is_own(
                name,
                match message {
                    RecordUpdate::Record(record) => Some(record.owner.to_string()),
                    RecordUpdate::Refresh { .. } => None,
                },
            )
        }
        Some(NamedContent::BootstrapRequest) => {
            request.check_author(name, |message: &BootstrapRequest| Some(message.node.to_string()))
        }
        Some(NamedContent::Beacon) => {
            request.check_author_in_envelope(name, |message: &Beacon| Some(message.node.to_string()))
        }
        Some(NamedContent::Report) => {
            request.check_author_in_envelope(name, |message: &Report| Some(message.robot.to_string()))
        }
        Some(NamedContent::Event) => request.is_own(name, Some(request.event_author()?.to_string())),
        Some(NamedContent::BidResponse) => {
            request.check_author(name, |message: &BidResponse| Some(message.robot.to_string()))
        }
    }
}

/// Content of a message, as far as it names its author.
enum NamedContent {
    None,
    RecordUpdate,
    BootstrapRequest,
    Beacon,
    Report,
    BidResponse,
    Event,
}

struct Node<'a> {
    identity: &'a Identity,
    name: &'a NodeId,
    roles: &'a BTreeSet<NodeRole>,
}

impl Node<'_> {
    fn is(&self, role: NodeRole) -> bool {
        self.roles.contains(&role)
    }

    fn is_named(&self, name: &str) -> bool {
        self.name.as_str() == name
    }
}

/// Returns the content that the node may send with this operation on the key, or `None` if it may
/// not.
fn permitted_content(node: &Node<'_>, operation: Operation, key: &str) -> Option<NamedContent> {
    use NodeRole::{Host, Robot, Voter};
    use Operation::{Publish, Query, Reply};
    let segments: Vec<&str> = key.split('/').collect();
    let unnamed = |permitted: bool| permitted.then_some(NamedContent::None);
    match (segments.as_slice(), operation) {
        (&["wire", "knowledge", name], Publish) => node.is_named(name).then_some(NamedContent::RecordUpdate),
        (&["wire", "motion", name], Publish) => unnamed(node.is_named(name)),
        (&["wire", "swim", _], Publish) => unnamed(true),
        (&["wire", "gossip", _], Query) => unnamed(true),
        (&["wire", "gossip", name], Reply) => unnamed(node.is_named(name)),
        (&["wire", "raft", _, _], Query | Reply) => unnamed(node.is(Voter)),
        (&["wire", "bootstrap", _], Query) => node.is(Voter).then_some(NamedContent::BootstrapRequest),
        (&["wire", "bootstrap", name], Reply) => unnamed(node.is(Voter) && node.is_named(name)),
        (&["wire", "beacon"], Publish) => node.is(Voter).then_some(NamedContent::Beacon),
        (&["wire", "bid" | "award" | "clock", _], Query) => unnamed(node.is(Voter)),
        (&["wire", "bid", name], Reply) => (node.is(Robot) && node.is_named(name)).then_some(NamedContent::BidResponse),
        (&["wire", "award", name], Reply) => unnamed(node.is(Robot) && node.is_named(name)),
        (&["wire", "report", _], Query) => node.is(Robot).then_some(NamedContent::Report),
        (&["wire", "leader", _], Query) => unnamed(node.is(Robot)),
        (&["wire", "report" | "clock" | "leader", name], Reply) => unnamed(node.is(Voter) && node.is_named(name)),
        (&["wire", "signal_history", _, _] | &["wire", "world"], Query) => unnamed(true),
        (&["wire", "signal", _, _], Publish) => unnamed(node.is(Robot) || node.is(Voter)),
        (&["wire", "ensemble", _, name], Publish) => unnamed(node.is(Robot) && node.is_named(name)),
        (&["wire", "signal_history", _, _], Reply) => unnamed(node.is(Robot)),
        (&["wire", "driver", name, "command"], Query) => unnamed(node.is(Robot) && node.is_named(name)),
        (&["wire", "driver", name, "command"], Reply) | (&["wire", "driver", name, "state"], Publish) => {
            unnamed(node.identity.serves(name))
        }
        (&["wire", "world"], Reply) | (&["wire", "people", "done"], Publish) => unnamed(node.is(Host)),
        (&["wire", "people", "ask"], Query) => unnamed(node.is(Voter)),
        (&["wire", "people", "ask"], Reply) => unnamed(node.is(Host)),
        (&["events", name], Publish) => node.is_named(name).then_some(NamedContent::Event),
        (&["view", ..] | &["api", _, "help"], Reply) => unnamed(true),
        (&["seen", name, ..] | &["api", "leave", name], Reply) => unnamed(node.is_named(name)),
        (&["api", call], Reply) => unnamed(ApiCall::parse(call)?.is_read_only() || node.is(Voter)),
        _ => None,
    }
}

/// Author of an event.
#[derive(Deserialize)]
struct EventAuthor {
    node: NodeId,
}

/// Message of a principal on a key.
struct Request<'a> {
    identity: &'a Identity,
    key: &'a str,
    payload: &'a [u8],
}

impl Request<'_> {
    fn denied(&self, operation: Operation) -> AccessDenied {
        AccessDenied::Operation {
            principal: self.identity.principal.to_string(),
            operation: operation.as_str(),
            key: self.key.to_owned(),
        }
    }

    fn check_author<T: DeserializeOwned>(
        &self,
        own: &NodeId,
        name: impl FnOnce(&T) -> Option<String>,
    ) -> Result<(), AccessDenied> {
        let message: T = self.read(self.payload)?;
        self.is_own(own, name(&message))
    }

    /// Does the same for a message in a cluster envelope.
    fn check_author_in_envelope<T: DeserializeOwned>(
        &self,
        own: &NodeId,
        name: impl FnOnce(&T) -> Option<String>,
    ) -> Result<(), AccessDenied> {
        let within: ClusterEnvelope = self.read(self.payload)?;
        let message: T = self.read(&within.payload)?;
        self.is_own(own, name(&message))
    }

    fn read<T: DeserializeOwned>(&self, bytes: &[u8]) -> Result<T, AccessDenied> {
        codec::decode(bytes).map_err(|problem| self.unreadable(problem.to_string()))
    }

    /// Returns the node that an event names as its author.
    fn event_author(&self) -> Result<NodeId, AccessDenied> {
        let event = serde_json::from_slice::<EventAuthor>(self.payload);
        event.map(|event| event.node).map_err(|problem| self.unreadable(problem.to_string()))
    }

    fn unreadable(&self, problem: String) -> AccessDenied {
        AccessDenied::Unreadable { principal: self.identity.principal.to_string(), key: self.key.to_owned(), problem }
    }

    fn is_own(&self, own: &NodeId, name: Option<String>) -> Result<(), AccessDenied> {
        match name {
            Some(name) if name != own.as_str() => Err(AccessDenied::Impersonation {
                principal: self.identity.principal.to_string(),
                key: self.key.to_owned(),
                name,
            }),
            _ => Ok(()),
        }
    }
}
