//! The blackboard: typed entries that the ports of one tree share.
//!
//! Every tree of a description has a scope of its own: its keys are its own unless a `SubTree` node remaps them to
//! keys of the tree around it. Scopes are resolved when a tree is checked, so a port holds the entry's number, and two
//! remapped keys are one entry.

use super::ports::PortConstraint;
use super::value::{PortType, PortValue, Value, ValueError};

/// Position of an entry on its blackboard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct EntryId(pub(crate) usize);

/// Values that live as long as their tree.
#[derive(Debug, Clone, Default)]
pub struct Blackboard {
    entries: Vec<Entry>,
}

#[derive(Debug, Clone)]
struct Entry {
    key: String,
    port_type: PortType,
    constraints: Vec<PortConstraint>,
    value: Option<Value>,
}

/// Why an entry cannot be read or written. The blackboard is unchanged.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BlackboardError {
    /// No port of the tree names this key.
    #[error("no port uses the key {{{key}}}; used are {known}")]
    UnknownKey {
        /// The key asked for.
        key: String,
        /// The keys of the main tree, in words.
        known: String,
    },
    /// Read before anything was written.
    #[error("{{{key}}} holds nothing yet")]
    Empty {
        /// The key, with the sub-tree it belongs to.
        key: String,
    },
    /// The value is not what the key's ports take.
    #[error("{{{key}}}: {source}")]
    Type {
        /// The key, with the sub-tree it belongs to.
        key: String,
        /// What is wrong.
        source: ValueError,
    },
}

impl Blackboard {
    /// Adds an empty entry. `key` is for messages; it need not be unique.
    pub(crate) fn add(&mut self, key: String) -> EntryId {
        self.entries.push(Entry { key, port_type: PortType::Any, constraints: Vec::new(), value: None });
        EntryId(self.entries.len() - 1)
    }

    /// Narrows an entry to what one more port takes; `Err` with the type it already has if they do not go together.
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

    pub(crate) fn key(&self, id: EntryId) -> &str {
        &self.entries[id.0].key
    }

    pub(crate) fn port_type(&self, id: EntryId) -> PortType {
        self.entries[id.0].port_type
    }

    /// Converts a value written before the entry's type was known.
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
