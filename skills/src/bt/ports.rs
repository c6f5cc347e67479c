//! Ports: what a node reads and writes, as declared where the node is defined and as bound where it is used.

use super::blackboard::{Blackboard, BlackboardError, EntryId};
use super::value::{PortType, PortValue, Value, ValueError};
use std::collections::BTreeMap;

/// Which way values pass through a port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PortDirection {
    /// Read by the node.
    Input,
    /// Written by the node.
    Output,
}

/// Whether a port must be bound.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PortPresence {
    /// A tree that leaves it out is refused.
    Required,
    /// It may be left out, or bound to a key that nobody has written.
    Optional,
    /// This text stands in when it is left out.
    Default(String),
}

/// What a port allows beyond its type.
#[derive(Debug, Clone, PartialEq)]
pub enum PortConstraint {
    /// Nothing.
    None,
    /// One of these texts.
    OneOf(Vec<String>),
    /// A number from the first to the second, both included.
    Range(f64, f64),
}

impl PortConstraint {
    pub(crate) fn check(&self, value: &Value) -> Result<(), ValueError> {
        let refuse = |allowed| Err(ValueError::NotAllowed { value: value.to_string(), allowed });
        match self {
            PortConstraint::None => Ok(()),
            PortConstraint::OneOf(texts) if texts.contains(&value.to_string()) => Ok(()),
            PortConstraint::OneOf(texts) => refuse(format!("allowed are {}", texts.join(", "))),
            PortConstraint::Range(low, high) => match value {
                Value::Integer(n) if (*low..=*high).contains(&(*n as f64)) => Ok(()),
                Value::Number(n) if (*low..=*high).contains(n) => Ok(()),
                _ => refuse(format!("allowed is {low} to {high}")),
            },
        }
    }
}

/// A port as its node declares it.
#[derive(Debug, Clone, PartialEq)]
pub struct PortSpec {
    /// Its name, which is the attribute in XML.
    pub name: String,
    /// Which way values pass.
    pub direction: PortDirection,
    /// What passes.
    pub port_type: PortType,
    /// Whether it must be bound.
    pub presence: PortPresence,
    /// What is allowed beyond the type.
    pub constraint: PortConstraint,
}

impl PortSpec {
    /// A port that the node reads and that must be bound.
    pub fn input(name: &str, port_type: PortType) -> PortSpec {
        let (direction, presence) = (PortDirection::Input, PortPresence::Required);
        PortSpec { name: name.to_owned(), direction, port_type, presence, constraint: PortConstraint::None }
    }

    /// A port that the node writes and that must be bound to a key.
    pub fn output(name: &str, port_type: PortType) -> PortSpec {
        PortSpec { direction: PortDirection::Output, ..PortSpec::input(name, port_type) }
    }

    /// The same port, which may be left out.
    pub fn optional(self) -> PortSpec {
        PortSpec { presence: PortPresence::Optional, ..self }
    }

    /// The same port with a value for when it is left out.
    pub fn with_default(self, default: &str) -> PortSpec {
        PortSpec { presence: PortPresence::Default(default.to_owned()), ..self }
    }

    /// The same port, for these texts alone.
    pub fn one_of(self, texts: &[&str]) -> PortSpec {
        PortSpec { constraint: PortConstraint::OneOf(texts.iter().map(|&t| t.to_owned()).collect()), ..self }
    }

    /// The same port, for numbers in this range alone, ends included.
    pub fn in_range(self, low: f64, high: f64) -> PortSpec {
        PortSpec { constraint: PortConstraint::Range(low, high), ..self }
    }

    /// Takes the text of a literal binding.
    pub(crate) fn parse(&self, text: &str) -> Result<Value, ValueError> {
        let value = self.port_type.parse(text)?;
        self.constraint.check(&value)?;
        Ok(value)
    }
}

/// What a node does with its children, which is also its tag in explicit XML.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NodeKind {
    /// A leaf that acts and may stay running.
    Action,
    /// A leaf that looks and never stays running.
    Condition,
    /// Has children and decides which to tick.
    Control,
    /// Has one child and changes what it answers.
    Decorator,
    /// Stands for another tree of the description.
    SubTree,
}

impl NodeKind {
    /// The tag of the explicit XML form.
    pub const fn tag(self) -> &'static str {
        match self {
            NodeKind::Action => "Action",
            NodeKind::Condition => "Condition",
            NodeKind::Control => "Control",
            NodeKind::Decorator => "Decorator",
            NodeKind::SubTree => "SubTree",
        }
    }
}

/// What a kind of node is called, is and passes.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeManifest {
    /// Its name in trees (`NavigateToPose`).
    pub id: String,
    /// What it does with children.
    pub kind: NodeKind,
    /// Its ports, in the order shown to people.
    pub ports: Vec<PortSpec>,
}

impl NodeManifest {
    /// The manifest of a node.
    pub fn new(id: &str, kind: NodeKind, ports: impl IntoIterator<Item = PortSpec>) -> NodeManifest {
        NodeManifest { id: id.to_owned(), kind, ports: ports.into_iter().collect() }
    }

    pub(crate) fn port(&self, name: &str) -> Option<&PortSpec> {
        self.ports.iter().find(|port| port.name == name)
    }

    pub(crate) fn port_names(&self) -> String {
        join_names(self.ports.iter().map(|port| port.name.as_str()))
    }
}

/// Names in words, for messages.
pub(crate) fn join_names<'a>(names: impl IntoIterator<Item = &'a str>) -> String {
    let names: Vec<&str> = names.into_iter().collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// The ports of one node as bound in its tree.
#[derive(Debug, Clone, Default)]
pub struct Ports {
    pub(crate) bound: BTreeMap<String, PortBinding>,
}

#[derive(Debug, Clone)]
pub(crate) enum PortBinding {
    Literal(Value),
    Entry(EntryId),
}

/// Why a port cannot be read or written. The blackboard is unchanged.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PortError {
    /// The tree does not bind the port, or the node has none of that name.
    #[error("port `{port}` is not bound")]
    Unbound {
        /// The port.
        port: String,
    },
    /// The port is bound to a fixed value.
    #[error("port `{port}` is bound to a fixed value and cannot be written")]
    Fixed {
        /// The port.
        port: String,
    },
    /// The fixed value is not what was asked for.
    #[error("port `{port}`: {source}")]
    Value {
        /// The port.
        port: String,
        /// What is wrong.
        source: ValueError,
    },
    /// The key behind the port refuses.
    #[error("port `{port}`: {source}")]
    Blackboard {
        /// The port.
        port: String,
        /// What is wrong.
        source: BlackboardError,
    },
}

impl Ports {
    /// Reads a port.
    ///
    /// # Errors
    /// [`PortError`] where it is not bound, holds nothing, or holds something else than `T`.
    pub fn read<T: PortValue>(&self, blackboard: &Blackboard, port: &str) -> Result<T, PortError> {
        if let Some(value) = self.read_optional(blackboard, port)? {
            return Ok(value);
        }
        Err(match self.bound.get(port) {
            Some(PortBinding::Entry(id)) => PortError::Blackboard {
                port: port.to_owned(),
                source: BlackboardError::Empty { key: blackboard.key(*id).to_owned() },
            },
            _ => PortError::Unbound { port: port.to_owned() },
        })
    }

    /// Reads a port; `None` where it is not bound or holds nothing.
    ///
    /// # Errors
    /// [`PortError`] where it holds something else than `T`.
    pub fn read_optional<T: PortValue>(&self, blackboard: &Blackboard, port: &str) -> Result<Option<T>, PortError> {
        match self.bound.get(port) {
            None => Ok(None),
            Some(PortBinding::Literal(value)) => {
                let converted = value.clone().convert(T::TYPE);
                converted.map(T::from_value).map_err(|source| PortError::Value { port: port.to_owned(), source })
            }
            Some(PortBinding::Entry(id)) => {
                blackboard.read(*id).map_err(|source| PortError::Blackboard { port: port.to_owned(), source })
            }
        }
    }

    /// Writes a port; one that the tree leaves out takes the value and drops it.
    ///
    /// # Errors
    /// [`PortError`] where it is bound to a fixed value, or its key takes another type.
    pub fn write(&self, blackboard: &mut Blackboard, port: &str, value: Value) -> Result<(), PortError> {
        match self.bound.get(port) {
            None => Ok(()),
            Some(PortBinding::Literal(_)) => Err(PortError::Fixed { port: port.to_owned() }),
            Some(PortBinding::Entry(id)) => {
                blackboard.write(*id, value).map_err(|source| PortError::Blackboard { port: port.to_owned(), source })
            }
        }
    }
}
