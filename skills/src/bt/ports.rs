//! Ports: inputs and outputs of a node, as declared in its manifest and as bound in a tree.

use super::blackboard::{Blackboard, BlackboardError, EntryId};
use super::value::{PortType, PortValue, Value, ValueError};
use std::collections::BTreeMap;

/// Direction of a port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PortDirection {
    /// Read by the node.
    Input,
    /// Written by the node.
    Output,
}

/// Presence requirement of a port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PortPresence {
    /// A tree that omits the port is rejected.
    Required,
    /// The port may be omitted, or bound to a key that has not been written.
    Optional,
    /// This text is used if the port is omitted.
    Default(String),
}

/// Constraint of a port beyond its type.
#[derive(Debug, Clone, PartialEq)]
pub enum PortConstraint {
    /// No constraint.
    None,
    /// One of these texts.
    OneOf(Vec<String>),
    /// A number from the first to the second, both included.
    Range(f64, f64),
}

impl PortConstraint {
    pub(crate) fn check(&self, value: &Value) -> Result<(), ValueError> {
        let reject = |allowed| Err(ValueError::NotAllowed { value: value.to_string(), allowed });
        match self {
            PortConstraint::None => Ok(()),
            PortConstraint::OneOf(texts) if texts.contains(&value.to_string()) => Ok(()),
            PortConstraint::OneOf(texts) => reject(format!("allowed are {}", texts.join(", "))),
            PortConstraint::Range(low, high) => match value {
                Value::Integer(n) if (*low..=*high).contains(&(*n as f64)) => Ok(()),
                Value::Number(n) if (*low..=*high).contains(n) => Ok(()),
                _ => reject(format!("allowed is {low} to {high}")),
            },
        }
    }
}

/// A port as declared by its node.
#[derive(Debug, Clone, PartialEq)]
pub struct PortSpec {
    /// Name, which is also the attribute in XML.
    pub name: String,
    /// Direction.
    pub direction: PortDirection,
    /// Type of the value.
    pub port_type: PortType,
    /// Presence requirement.
    pub presence: PortPresence,
    /// Constraint beyond the type.
    pub constraint: PortConstraint,
}

impl PortSpec {
    /// A required input port.
    pub fn input(name: &str, port_type: PortType) -> PortSpec {
        let (direction, presence) = (PortDirection::Input, PortPresence::Required);
        PortSpec { name: name.to_owned(), direction, port_type, presence, constraint: PortConstraint::None }
    }

    /// A required output port, which must be bound to a key.
    pub fn output(name: &str, port_type: PortType) -> PortSpec {
        PortSpec { direction: PortDirection::Output, ..PortSpec::input(name, port_type) }
    }

    /// Makes the port optional.
    pub fn optional(self) -> PortSpec {
        PortSpec { presence: PortPresence::Optional, ..self }
    }

    /// Sets the value for an omitted port.
    pub fn with_default(self, default: &str) -> PortSpec {
        PortSpec { presence: PortPresence::Default(default.to_owned()), ..self }
    }

    /// Restricts the port to these texts.
    pub fn one_of(self, texts: &[&str]) -> PortSpec {
        PortSpec { constraint: PortConstraint::OneOf(texts.iter().map(|&t| t.to_owned()).collect()), ..self }
    }

    /// Restricts the port to numbers in this range, ends included.
    pub fn in_range(self, low: f64, high: f64) -> PortSpec {
        PortSpec { constraint: PortConstraint::Range(low, high), ..self }
    }

    /// Parses the text of a fixed value.
    pub(crate) fn parse(&self, text: &str) -> Result<Value, ValueError> {
        let value = self.port_type.parse(text)?;
        self.constraint.check(&value)?;
        Ok(value)
    }
}

/// Kind of a node, which is also its tag in explicit XML.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NodeKind {
    /// A leaf that acts and may stay running.
    Action,
    /// A leaf that checks a condition and never stays running.
    Condition,
    /// A node with children that decides which of them to tick.
    Control,
    /// A node that changes the status or the execution of its single child.
    Decorator,
    /// A reference to another tree of the description.
    SubTree,
}

impl NodeKind {
    /// The tag in explicit XML.
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

/// Declaration of a node type: name, kind and ports.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeManifest {
    /// Name in trees (`NavigateToPose`).
    pub id: String,
    /// Kind of the node.
    pub kind: NodeKind,
    /// Ports, in the order of display.
    pub ports: Vec<PortSpec>,
}

impl NodeManifest {
    /// Creates the manifest of a node.
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

/// Joins names for messages.
pub(crate) fn join_names<'a>(names: impl IntoIterator<Item = &'a str>) -> String {
    let names: Vec<&str> = names.into_iter().collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// The ports of a node as bound in its tree.
#[derive(Debug, Clone, Default)]
pub struct Ports {
    pub(crate) bound: BTreeMap<String, PortBinding>,
}

#[derive(Debug, Clone)]
pub(crate) enum PortBinding {
    Literal(Value),
    Entry(EntryId),
}

/// A port cannot be read or written. The blackboard is unchanged.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PortError {
    /// The tree does not bind the port, or the node has no such port.
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
    /// The fixed value has another type than requested.
    #[error("port `{port}`: {source}")]
    Value {
        /// The port.
        port: String,
        /// Cause.
        source: ValueError,
    },
    /// The entry cannot be read or written.
    #[error("port `{port}`: {source}")]
    Blackboard {
        /// The port.
        port: String,
        /// Cause.
        source: BlackboardError,
    },
}

impl Ports {
    /// Reads a port.
    ///
    /// # Errors
    /// [`PortError`] if the port is not bound, is empty, or contains another type than `T`.
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

    /// Reads a port; `None` if it is not bound or empty.
    ///
    /// # Errors
    /// [`PortError`] if the port contains another type than `T`.
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

    /// Writes a port. A value for a port that the tree omits is dropped.
    ///
    /// # Errors
    /// [`PortError`] if the port is bound to a fixed value, or its key has another type.
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
