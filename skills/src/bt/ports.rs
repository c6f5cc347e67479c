//! Ports: inputs and outputs of a node, as bound in a tree.

use super::blackboard::{Blackboard, BlackboardError, EntryId};
use super::port_value::PortValue;
use super::value::{Value, ValueError};
use std::collections::BTreeMap;

/// The ports of a node as bound in its tree.
#[derive(Debug, Clone, Default)]
pub(crate) struct Ports {
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
    pub(crate) fn read<T: PortValue>(&self, blackboard: &Blackboard, port: &str) -> Result<T, PortError> {
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
    pub(crate) fn read_optional<T: PortValue>(
        &self,
        blackboard: &Blackboard,
        port: &str,
    ) -> Result<Option<T>, PortError> {
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
    pub(crate) fn write(&self, blackboard: &mut Blackboard, port: &str, value: Value) -> Result<(), PortError> {
        match self.bound.get(port) {
            None => Ok(()),
            Some(PortBinding::Literal(_)) => Err(PortError::Fixed { port: port.to_owned() }),
            Some(PortBinding::Entry(id)) => {
                blackboard.write(*id, value).map_err(|source| PortError::Blackboard { port: port.to_owned(), source })
            }
        }
    }
}
