//! Keys of the trees during a check: scopes, entries and their use.

use super::blackboard::{Blackboard, BlackboardError, EntryId};
use super::checked_node::TreeInput;
use super::error::{Place, TreeError, TreeErrorKind};
use super::manifest::PortConstraint;
use super::value::{PortType, Value};
use std::collections::{BTreeMap, BTreeSet};

/// Scopes from the main tree down to the current tree, and the entries of all trees.
pub(crate) struct Scopes {
    blackboard: Blackboard,
    /// Use of each entry, by its index.
    uses: Vec<Use>,
    scopes: Vec<Scope>,
}

/// Use of an entry.
#[derive(Default)]
struct Use {
    /// A node, a script or a fixed value writes the entry.
    is_written: bool,
    /// Error to report if the entry is never written: something needs its value.
    missing_error: Option<TreeError>,
    read: bool,
}

/// Keys of an instance of a tree.
struct Scope {
    tree: String,
    autoremap: bool,
    keys: BTreeMap<String, EntryId>,
    used: BTreeSet<String>,
}

/// Result of [`Scopes::finish`]: the blackboard, the main tree's keys and its inputs.
pub(crate) type Layout = (Blackboard, BTreeMap<String, EntryId>, Vec<TreeInput>);

impl Scopes {
    /// Creates the scope of the main tree.
    pub(crate) fn new(main: &str) -> Scopes {
        let scope = Scope { tree: main.to_owned(), autoremap: false, keys: BTreeMap::new(), used: BTreeSet::new() };
        Scopes { blackboard: Blackboard::default(), uses: Vec::new(), scopes: vec![scope] }
    }

    /// Names of the trees from the main tree to the current one.
    pub(crate) fn path(&self) -> impl Iterator<Item = &str> {
        self.scopes.iter().map(|scope| scope.tree.as_str())
    }

    /// Name of the current tree.
    pub(crate) fn tree(&self) -> &str {
        self.scopes.last().map_or("", |scope| &scope.tree)
    }

    /// Enters a sub-tree. `keys` are its remapped keys with their entries.
    pub(crate) fn enter(&mut self, tree: &str, autoremap: bool, keys: BTreeMap<String, EntryId>) {
        self.scopes.push(Scope { tree: tree.to_owned(), autoremap, keys, used: BTreeSet::new() });
    }

    /// Leaves a sub-tree and returns the keys that it uses.
    pub(crate) fn leave(&mut self) -> BTreeSet<String> {
        self.scopes.pop().expect("a sub-tree was entered").used
    }

    /// Returns the entry of a key in the current tree. `@key` is the key of the main tree.
    pub(crate) fn entry(&mut self, key: &str) -> EntryId {
        match key.strip_prefix('@') {
            Some(key) => self.entry_at(0, key),
            None => self.entry_at(self.scopes.len() - 1, key),
        }
    }

    fn entry_at(&mut self, depth: usize, key: &str) -> EntryId {
        let scope = &mut self.scopes[depth];
        scope.used.insert(key.to_owned());
        if let Some(id) = scope.keys.get(key) {
            return *id;
        }
        // Keys that begin with `_` are private to their tree, as in BehaviorTree.CPP.
        let shared = scope.autoremap && !key.starts_with('_');
        let name = if depth == 0 { key.to_owned() } else { format!("{}/{key}", scope.tree) };
        let id = if shared { self.entry_at(depth - 1, key) } else { self.add(name) };
        self.scopes[depth].keys.insert(key.to_owned(), id);
        id
    }

    fn add(&mut self, key: String) -> EntryId {
        self.uses.push(Use::default());
        self.blackboard.add(key)
    }

    /// Adds an entry with a fixed value.
    pub(crate) fn fixed(&mut self, key: String, text: &str) -> Result<EntryId, BlackboardError> {
        let id = self.add(key);
        self.uses[id.0].is_written = true;
        self.blackboard.write(id, Value::Text(text.to_owned()))?;
        Ok(id)
    }

    /// Restricts an entry to the type and constraint of another port. `Err` contains the key and
    /// its type if the types conflict.
    pub(crate) fn restrict(
        &mut self,
        id: EntryId,
        port_type: PortType,
        constraint: &PortConstraint,
    ) -> Result<(), (String, PortType)> {
        let restricted = self.blackboard.restrict(id, port_type, constraint);
        restricted.map_err(|is| (self.blackboard.key(id).to_owned(), is))
    }

    /// Records that something writes an entry.
    pub(crate) fn note_write(&mut self, id: EntryId) {
        self.uses[id.0].is_written = true;
    }

    /// Records that something reads an entry. `missing_error` is reported if nothing writes it;
    /// `None` if the entry may be empty.
    pub(crate) fn note_read(&mut self, id: EntryId, missing_error: Option<TreeError>) {
        let entry = &mut self.uses[id.0];
        entry.read = true;
        if entry.missing_error.is_none() {
            entry.missing_error = missing_error;
        }
    }

    /// Performs the checks that need the whole tree. `place` is that of the file.
    pub(crate) fn finish(mut self, place: &Place) -> Result<Layout, TreeError> {
        for index in 0..self.uses.len() {
            let converted = self.blackboard.convert_to_entry_type(EntryId(index));
            converted.map_err(|error| place.error(TreeErrorKind::KeyValue(error)))?;
        }
        let keys = self.scopes.swap_remove(0).keys;
        let given: BTreeSet<EntryId> = keys.values().copied().collect();
        for (index, entry) in self.uses.iter_mut().enumerate() {
            if !entry.is_written
                && !given.contains(&EntryId(index))
                && let Some(error) = entry.missing_error.take()
            {
                return Err(error);
            }
        }
        let inputs =
            keys.iter().filter(|(_, id)| self.uses[id.0].read && !self.uses[id.0].is_written).map(|(key, id)| {
                let required = self.uses[id.0].missing_error.is_some();
                TreeInput { key: key.clone(), port_type: self.blackboard.port_type(*id), required }
            });
        let inputs = inputs.collect();
        Ok((self.blackboard, keys, inputs))
    }
}
