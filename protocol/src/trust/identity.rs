//! What a certificate says of its bearer.

use crate::ids::{FleetId, NameError, NodeId, PersonId};
use crate::word_enum::words;
use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

/// Whose certificate it is. Written as a URI into the certificate's subject alternative names, whence it is read:
/// `consort://ward/node/ada?roles=robot,voter`, `consort://ward/person/kim?scope=submit`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Identity {
    /// Of which fleet.
    pub fleet: FleetId,
    /// Of whom.
    pub principal: Principal,
}

/// Whom a certificate is given to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Principal {
    /// A node.
    Node {
        /// Its name.
        name: NodeId,
        /// What it may be in the fleet.
        roles: BTreeSet<NodeRole>,
    },
    /// A person, or a program that a person answers for.
    Person {
        /// Who.
        name: PersonId,
        /// What the person may do.
        scope: AccessScope,
    },
}

words! {
    /// What a node may be.
    NodeRole {
        /// It bids, holds roles and drives a body.
        Robot = "robot",
        /// It may keep the ledger, and coordinate.
        Voter = "voter",
        /// It hosts bodies and people: a world, or an adapter for robots of another make.
        Host = "host",
    }
    /// What a person may do. Each may do what the ones before it may.
    AccessScope {
        /// Look in.
        Read = "read",
        /// Ask for missions and withdraw them.
        Submit = "submit",
        /// Say that something was rescued, and make nodes leave.
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
                    IdentityError(format!("{text:?} is no {}; allowed: {allowed}", $what))
                })
            }
        }
    )*};
}

read! {
    NodeRole, "role of a node";
    AccessScope, "scope";
}

/// Why a text does not say whose certificate it is.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct IdentityError(String);

impl From<NameError> for IdentityError {
    fn from(problem: NameError) -> Self {
        IdentityError(problem.to_string())
    }
}

impl fmt::Display for Principal {
    /// For people: `node ada (robot, voter)`, `person kim (submit)`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Principal::Node { name, roles } => write!(f, "node {name} ({})", listed(roles, ", ")),
            Principal::Person { name, scope } => write!(f, "person {name} ({scope})"),
        }
    }
}

fn listed(roles: &BTreeSet<NodeRole>, between: &str) -> String {
    match roles.is_empty() {
        true => "no role".to_owned(),
        false => roles.iter().map(|role| role.as_str()).collect::<Vec<_>>().join(between),
    }
}

impl fmt::Display for Identity {
    /// As it is written into a certificate.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.principal {
            Principal::Node { name, roles } => {
                let roles = roles.iter().map(|role| role.as_str()).collect::<Vec<_>>().join(",");
                write!(f, "consort://{}/node/{name}?roles={roles}", self.fleet)
            }
            Principal::Person { name, scope } => write!(f, "consort://{}/person/{name}?scope={scope}", self.fleet),
        }
    }
}

impl FromStr for Identity {
    type Err = IdentityError;

    fn from_str(text: &str) -> Result<Identity, IdentityError> {
        let form = || {
            let forms = "consort://FLEET/node/NAME?roles=robot,voter,host or consort://FLEET/person/NAME?scope=read";
            IdentityError(format!("{text:?} names no bearer; the form is {forms}"))
        };
        let (path, said) = text.strip_prefix("consort://").and_then(|rest| rest.split_once('?')).ok_or_else(form)?;
        let segments: Vec<&str> = path.split('/').collect();
        let (fleet, bearer) = match (segments.as_slice(), said.split_once('=')) {
            (&[fleet, "node", name], Some(("roles", roles))) => {
                let roles = roles.split(',').filter(|role| !role.is_empty());
                let roles = roles.map(str::parse).collect::<Result<_, _>>()?;
                (fleet, Principal::Node { name: name.parse()?, roles })
            }
            (&[fleet, "person", name], Some(("scope", scope))) => {
                (fleet, Principal::Person { name: name.parse()?, scope: scope.parse()? })
            }
            _ => return Err(form()),
        };
        Ok(Identity { fleet: fleet.parse()?, principal: bearer })
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
            "consort://ward/person/kim.lee?scope=operate",
        ] {
            assert_eq!(text.parse::<Identity>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn what_is_wrong_is_said_with_what_is_allowed() {
        let said = |text: &str| text.parse::<Identity>().unwrap_err().to_string();
        assert!(said("spiffe://ward/node/ada?roles=robot").contains("the form is consort://FLEET/node/NAME"));
        assert!(said("consort://ward/node/ada?scope=read").contains("the form is"));
        assert!(said("consort://ward/person/ada?roles=voter").contains("the form is"));
        assert!(said("consort://ward/node/a*a?roles=robot").contains("holds '*'"));
        assert_eq!(
            said("consort://ward/node/ada?roles=robot,boss"),
            "\"boss\" is no role of a node; allowed: robot, voter, host"
        );
        assert_eq!(said("consort://ward/person/kim?scope=all"), "\"all\" is no scope; allowed: read, submit, operate");
    }

    #[test]
    fn a_wider_scope_is_greater() {
        assert!(AccessScope::Read < AccessScope::Submit && AccessScope::Submit < AccessScope::Operate);
    }
}
