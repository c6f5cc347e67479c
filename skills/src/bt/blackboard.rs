//! The blackboard: typed entries that the ports of a tree share.
//!
//! Every tree of a description has its own scope. A key belongs to its tree, unless a `SubTree`
//! node remaps it to a key of the enclosing tree. Scopes are resolved when a tree is checked. A
//! port then holds the index of its entry, and two remapped keys share an entry.

use super::manifest::PortConstraint;
use super::port_value::PortValue;
use super::value::{PortType, Value, ValueError};

/// Index of an entry in its blackboard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct EntryId(pub(crate) usize);

/// Values that live as long as their tree.
#[derive(Debug, Clone, Default)]
pub(crate) struct Blackboard {
    entries: Vec<Entry>,
}

#[derive(Debug, Clone)]
struct Entry {
    key: String,
    port_type: PortType,
    constraints: Vec<PortConstraint>,
    value: Option<Value>,
}

/// An entry cannot be read or written. The blackboard is unchanged.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BlackboardError {
    /// No port of the tree uses this key.
    #[error("no port uses the key {{{key}}}; used are {known}")]
    UnknownKey {
        /// The requested key.
        key: String,
        /// The keys of the main tree, as text.
        known: String,
    },
    /// The entry was read before it was written.
    #[error("{{{key}}} is empty")]
    Empty {
        /// The key, with its sub-tree.
        key: String,
    },
    /// The value does not fit the type or the constraints of the key's ports.
    #[error("{{{key}}}: {source}")]
    Type {
        /// The key, with its sub-tree.
        key: String,
        /// Cause.
        source: ValueError,
    },
}

impl Blackboard {
    /// Adds an empty entry. `key` is for messages and need not be unique.
    pub(crate) fn add(&mut self, key: String) -> EntryId {
        self.entries.push(Entry { key, port_type: PortType::Any, constraints: Vec::new(), value: None });
        EntryId(self.entries.len() - 1)
    }

    /// Restricts an entry to the type and constraint of another port. `Err` contains the entry's
    /// type if the types conflict.
    pub(crate) fn restrict(
        &mut self,
        id: EntryId,
        port_type: PortType,
        constraint: &PortConstraint,
    ) -> Result<(), PortType> {
        let entry = &mut self.entries[id.0];
        entry.port_type = entry.port_type.join(port_type).ok_or(entry.port_type)?;
        if *constraint != PortConstraint::None && !entry.constraints.contains(constraint) {
            entry.constraints.push(constraint.clone());
        }
        Ok(())
    }

    /// Reads an entry as `T`; `None` while it is empty.
    pub(crate) fn read<T: PortValue>(&self, id: EntryId) -> Result<Option<T>, BlackboardError> {
        let entry = &self.entries[id.0];
        let Some(value) = entry.value.clone() else { return Ok(None) };
        let value = value.convert(T::TYPE).map_err(|source| entry.mistyped(source))?;
        Ok(T::from_value(value))
    }

    /// Writes an entry, converting text to the entry's type.
    pub(crate) fn write(&mut self, id: EntryId, value: Value) -> Result<(), BlackboardError> {
        let entry = &mut self.entries[id.0];
        let value = value.convert(entry.port_type).map_err(|source| entry.mistyped(source))?;
        for constraint in &entry.constraints {
            constraint.check(&value).map_err(|source| entry.mistyped(source))?;
        }
        entry.value = Some(value);
        Ok(())
    }

    /// Returns the value of an entry; `None` while it is empty.
    pub(crate) fn value(&self, id: EntryId) -> Option<&Value> {
        self.entries[id.0].value.as_ref()
    }

    pub(crate) fn key(&self, id: EntryId) -> &str {
        &self.entries[id.0].key
    }

    pub(crate) fn port_type(&self, id: EntryId) -> PortType {
        self.entries[id.0].port_type
    }

    /// Converts a value that was written before the entry's type was known.
    pub(crate) fn convert_to_entry_type(&mut self, id: EntryId) -> Result<(), BlackboardError> {
        match self.entries[id.0].value.clone() {
            Some(value) => self.write(id, value),
            None => Ok(()),
        }
    }
}

impl Entry {
    fn mistyped(&self, source: ValueError) -> BlackboardError {
        BlackboardError::Type { key: self.key.clone(), source }
    }
}
