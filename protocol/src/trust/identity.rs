//! Identity of a principal, as contained in its certificate.

use super::mission_rights::{MissionRights, MissionRightsError};
use super::served_name::ServedName;
use crate::ids::{FleetId, NameError, NodeId, PersonId, TaskId};
use crate::word_enum::words;
use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

/// Identity in a certificate. Stored as a URI in the certificate's subject alternative names:
/// `consort://ward/node/ada?roles=robot,voter`, `consort://ward/node/world?roles=host&serves=ada,bo`,
/// `consort://ward/person/kim?scope=submit`, `consort://ward/person/lee?scope=submit&missions=deliveries`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Identity {
    /// Fleet of the principal.
    pub fleet: FleetId,
    /// The principal.
    pub principal: Principal,
}

/// Owner of a certificate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Principal {
    /// A node.
    Node {
        /// Name of the node.
        name: NodeId,
        /// Roles that it may have in the fleet.
        roles: BTreeSet<NodeRole>,
        /// Robots, and roles of people, that it serves as a `host`.
        serves: BTreeSet<ServedName>,
    },
    /// A person, or a program that a person is responsible for.
    Person {
        /// Name of the person.
        name: PersonId,
        /// Permissions of the person.
        scope: AccessScope,
        /// Missions that the person may submit.
        missions: MissionRights,
    },
}

words! {
    /// Role of a node in the fleet.
    NodeRole {
        /// The node bids, holds mission roles and drives a robot.
        Robot = "robot",
        /// The node may be a voter of the ledger, and coordinate.
        Voter = "voter",
        /// The node runs driver servers: a simulated world, with its people, or an adapter for robots of
        /// another make.
        Host = "host",
        /// The node serves a dashboard, and forwards requests with the tokens of its visitors.
        Dashboard = "dashboard",
    }
    /// Permissions of a person. Each scope includes the preceding scopes.
    AccessScope {
        /// Read views and events.
        Read = "read",
        /// Submit and cancel missions.
        Submit = "submit",
        /// Resolve interventions, and make nodes leave.
        Operate = "operate",
    }
}

macro_rules! read {
    ($($name:ident, $what:literal;)*) => {$(
        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(self.as_str())
            }
        }

        impl FromStr for $name {
            type Err = IdentityError;
            fn from_str(text: &str) -> Result<Self, IdentityError> {
                $name::parse(text).ok_or_else(|| {
                    let allowed = $name::ALL.iter().map(|known| known.as_str()).collect::<Vec<_>>().join(", ");
                    IdentityError(format!("{text:?} is not a {}; allowed: {allowed}", $what))
                })
            }
        }
    )*};
}

read! {
    NodeRole, "role of a node";
    AccessScope, "scope";
}

/// Error: a text is not an identity.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct IdentityError(String);

impl From<MissionRightsError> for IdentityError {
    fn from(problem: MissionRightsError) -> Self {
        IdentityError(problem.to_string())
    }
}

impl From<NameError> for IdentityError {
    fn from(problem: NameError) -> Self {
        IdentityError(problem.to_string())
    }
}

impl Identity {
    /// Checks whether it is the node with this name.
    pub fn is_node(&self, node: &str) -> bool {
        matches!(&self.principal, Principal::Node { name, .. } if name.as_str() == node)
    }

    /// Checks whether it is a driver server of this robot, or of the people with this role.
    pub fn serves(&self, served: &str) -> bool {
        match &self.principal {
            Principal::Node { roles, serves, .. } => {
                roles.contains(&NodeRole::Host) && serves.iter().any(|name| name.includes(served))
            }
            Principal::Person { .. } => false,
        }
    }
}

impl Principal {
    /// Returns the name of the node or person.
    pub fn name(&self) -> &str {
        match self {
            Principal::Node { name, .. } => name.as_str(),
            Principal::Person { name, .. } => name.as_str(),
        }
    }
}

impl fmt::Display for Principal {
    /// Writes the principal for people: `node ada (robot, voter)`, `person kim (submit)`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Principal::Node { name, roles, serves } => {
                write!(f, "node {name} ({})", listed(roles.iter().map(|role| role.as_str())))?;
                match serves.is_empty() {
                    true => Ok(()),
                    false => write!(f, " of {}", listed(serves)),
                }
            }
            Principal::Person { name, scope, missions: MissionRights::All } => write!(f, "person {name} ({scope})"),
            Principal::Person { name, scope, missions } => write!(f, "person {name} ({scope}; missions: {missions})"),
        }
    }
}

fn listed(words: impl IntoIterator<Item = impl ToString>) -> String {
    let words: Vec<String> = words.into_iter().map(|word| word.to_string()).collect();
    match words.is_empty() {
        true => "no role".to_owned(),
        false => words.join(", "),
    }
}

impl fmt::Display for Identity {
    /// Writes the identity as in a certificate.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.principal {
            Principal::Node { name, roles, serves } => {
                let roles = roles.iter().map(|role| role.as_str()).collect::<Vec<_>>().join(",");
                write!(f, "consort://{}/node/{name}?roles={roles}", self.fleet)?;
                match serves.is_empty() {
                    true => Ok(()),
                    false => {
                        let serves = serves.iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
                        write!(f, "&serves={serves}")
                    }
                }
            }
            Principal::Person { name, scope, missions } => {
                write!(f, "consort://{}/person/{name}?scope={scope}", self.fleet)?;
                match missions {
                    MissionRights::All => Ok(()),
                    MissionRights::Named(names) => {
                        let names = names.iter().map(TaskId::as_str).collect::<Vec<_>>().join(",");
                        write!(f, "&missions={names}")
                    }
                }
            }
        }
    }
}

/// Parses the elements of a list with commas; an empty text is an empty list.
fn elements<T: FromStr<Err: Into<IdentityError>> + Ord>(list: &str) -> Result<BTreeSet<T>, IdentityError> {
    let elements = list.split(',').filter(|element| !element.is_empty());
    elements.map(|element| element.parse().map_err(Into::into)).collect()
}

impl FromStr for Identity {
    type Err = IdentityError;

    fn from_str(text: &str) -> Result<Identity, IdentityError> {
        let form = || {
            let forms = "consort://FLEET/node/NAME?roles=robot,voter,host,dashboard&serves=NAMES or consort://FLEET/person/NAME?scope=read&missions=NAMES";
            IdentityError(format!("{text:?} is not an identity; the form is {forms}"))
        };
        let (path, query) = text.strip_prefix("consort://").and_then(|rest| rest.split_once('?')).ok_or_else(form)?;
        let segments: Vec<&str> = path.split('/').collect();
        let (fleet, principal) = match (segments.as_slice(), query.split_once('=')) {
            (&[fleet, "node", name], Some(("roles", roles))) => {
                let (roles, serves) = roles.split_once("&serves=").unwrap_or((roles, ""));
                let (roles, serves) = (elements(roles)?, elements(serves)?);
                (fleet, Principal::Node { name: name.parse()?, roles, serves })
            }
            (&[fleet, "person", name], Some(("scope", scope))) => {
                let (scope, missions) = scope.split_once("&missions=").unwrap_or((scope, "*"));
                (fleet, Principal::Person { name: name.parse()?, scope: scope.parse()?, missions: missions.parse()? })
            }
            _ => return Err(form()),
        };
        Ok(Identity { fleet: fleet.parse()?, principal })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_identity_reads_back_as_what_was_written() {
        for text in [
            "consort://ward/node/ada?roles=robot,voter",
            "consort://ward/node/lab-1?roles=",
            "consort://ward/node/world?roles=host,dashboard&serves=ada,drone-*",
            "consort://ward/node/world?roles=host&serves=*",
            "consort://ward/person/kim.lee?scope=operate",
            "consort://ward/person/kim?scope=submit&missions=deliveries,rounds",
            "consort://ward/person/kim?scope=submit&missions=",
        ] {
            assert_eq!(text.parse::<Identity>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn an_invalid_identity_is_rejected_with_the_allowed_forms() {
        let error = |text: &str| text.parse::<Identity>().unwrap_err().to_string();
        assert!(error("spiffe://ward/node/ada?roles=robot").contains("the form is consort://FLEET/node/NAME"));
        assert!(error("consort://ward/node/ada?scope=read").contains("the form is"));
        assert!(error("consort://ward/person/ada?roles=voter").contains("the form is"));
        assert!(error("consort://ward/node/a*a?roles=robot").contains("contains '*'"));
        assert!(error("consort://ward/node/world?roles=host&serves=a*a").contains("contains '*'"));
        assert_eq!(
            error("consort://ward/node/ada?roles=robot,boss"),
            "\"boss\" is not a role of a node; allowed: robot, voter, host, dashboard"
        );
        assert_eq!(
            error("consort://ward/person/kim?scope=all"),
            "\"all\" is not a scope; allowed: read, submit, operate"
        );
    }

    #[test]
    fn a_driver_server_serves_the_names_in_its_certificate() {
        let serves = |query: &str, name: &str| {
            format!("consort://ward/node/world?{query}").parse::<Identity>().unwrap().serves(name)
        };
        assert!(serves("roles=host&serves=ada,drone-*", "ada") && serves("roles=host&serves=*", "ada"));
        assert!(serves("roles=host&serves=ada,drone-*", "drone-7"));
        for query in ["roles=host", "roles=robot&serves=ada", "roles=host&serves=ada2,ad,bo*"] {
            assert!(!serves(query, "ada"), "{query}");
        }
        assert!(!"consort://ward/person/ada?scope=operate".parse::<Identity>().unwrap().serves("ada"));
    }

    #[test]
    fn a_wider_scope_is_greater() {
        assert!(AccessScope::Read < AccessScope::Submit && AccessScope::Submit < AccessScope::Operate);
    }
}
