//! Declaration of nodes: kind, and ports with their types and constraints.

use super::value::{PortType, Value, ValueError};
use crate::names::join_names;
use consort_protocol::ensemble::ExchangedValue;

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
    /// A text of this list.
    OneOf(Vec<String>),
    /// A number from the first to the second, both included.
    Range(f64, f64),
    /// The name of a value that members of an ensemble exchange.
    ExchangedValue,
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
            PortConstraint::ExchangedValue if ExchangedValue::try_from(value.to_string()).is_ok() => Ok(()),
            PortConstraint::ExchangedValue => reject("allowed are attributes.NAME and readings.NAME".to_owned()),
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
    pub(crate) fn optional(self) -> PortSpec {
        PortSpec { presence: PortPresence::Optional, ..self }
    }

    /// Sets the value for an omitted port.
    pub(crate) fn with_default(self, default: &str) -> PortSpec {
        PortSpec { presence: PortPresence::Default(default.to_owned()), ..self }
    }

    /// Restricts the port to these texts.
    pub(crate) fn one_of(self, texts: &[&str]) -> PortSpec {
        PortSpec { constraint: PortConstraint::OneOf(texts.iter().map(|&t| t.to_owned()).collect()), ..self }
    }

    /// Restricts the port to numbers in this range, ends included.
    pub(crate) fn in_range(self, low: f64, high: f64) -> PortSpec {
        PortSpec { constraint: PortConstraint::Range(low, high), ..self }
    }

    /// Restricts the port to names of values that members of an ensemble exchange.
    pub(crate) fn exchanged_value(self) -> PortSpec {
        PortSpec { constraint: PortConstraint::ExchangedValue, ..self }
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
    pub(crate) const fn tag(self) -> &'static str {
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
    /// Pairs of optional ports. A tree binds both ports of a pair or neither.
    pub(crate) pairs: Vec<[String; 2]>,
}

impl NodeManifest {
    /// Creates the manifest of a node.
    pub fn new(id: &str, kind: NodeKind, ports: impl IntoIterator<Item = PortSpec>) -> NodeManifest {
        NodeManifest { id: id.to_owned(), kind, ports: ports.into_iter().collect(), pairs: vec![] }
    }

    /// Adds a pair of optional ports.
    pub(crate) fn with_pair(mut self, first: &str, second: &str) -> NodeManifest {
        self.pairs.push([first.to_owned(), second.to_owned()]);
        self
    }

    pub(crate) fn port(&self, name: &str) -> Option<&PortSpec> {
        self.ports.iter().find(|port| port.name == name)
    }

    pub(crate) fn port_names(&self) -> String {
        join_names(self.ports.iter().map(|port| port.name.as_str()))
    }
}
