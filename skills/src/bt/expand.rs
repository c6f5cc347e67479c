//! Checks a description node by node, and expands its sub-trees.

use super::blackboard::{Blackboard, EntryId};
use super::builtin::Builtin;
use super::checked_node::{CheckedNode, MAX_DEPTH, MAX_NODES, NodeImpl, TreeInput};
use super::error::{TreeError, TreeErrorKind};
use super::manifest::{NodeKind, NodeManifest, PortDirection, PortPresence, PortSpec, join_names};
use super::ports::{PortBinding, Ports};
use super::registry::Registry;
use super::spec::{NodeSpec, TreeSpec};
use super::value::Value;
use std::collections::{BTreeMap, BTreeSet};

/// State of a check.
pub(crate) struct Expansion<'a, C> {
    spec: &'a TreeSpec,
    registry: &'a Registry<C>,
    blackboard: Blackboard,
    /// Use of each entry, by its index.
    uses: Vec<Use>,
    /// From the main tree down to the current tree.
    scopes: Vec<Scope>,
    nodes: usize,
}

/// Use of an entry.
#[derive(Default)]
struct Use {
    /// A node or a fixed value writes the entry.
    is_written: bool,
    /// Error to report if the entry is never written: a required port reads it.
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

/// Result of [`Expansion::finish`]: the blackboard, the main tree's keys and its inputs.
pub(crate) type Layout = (Blackboard, BTreeMap<String, EntryId>, Vec<TreeInput>);

impl<'a, C> Expansion<'a, C> {
    pub(crate) fn new(spec: &'a TreeSpec, registry: &'a Registry<C>) -> Self {
        let main = Scope::new(&spec.main, false);
        let blackboard = Blackboard::default();
        Expansion { spec, registry, blackboard, uses: Vec::new(), scopes: vec![main], nodes: 0 }
    }

    pub(crate) fn main(&mut self, root: &NodeSpec) -> Result<CheckedNode<C>, TreeError> {
        self.node(root, 1)
    }

    /// Performs the checks that need the whole tree.
    pub(crate) fn finish(mut self) -> Result<Layout, TreeError> {
        for index in 0..self.uses.len() {
            self.blackboard.convert_to_entry_type(EntryId(index)).map_err(|error| TreeError {
                source: self.spec.source.clone(),
                line: None,
                node: None,
                kind: Box::new(TreeErrorKind::KeyValue(error)),
            })?;
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

    fn node(&mut self, node: &NodeSpec, depth: usize) -> Result<CheckedNode<C>, TreeError> {
        self.nodes += 1;
        if depth > MAX_DEPTH {
            return Err(self.error(node, TreeErrorKind::TooDeep { limit: MAX_DEPTH }));
        }
        if self.nodes > MAX_NODES {
            return Err(self.error(node, TreeErrorKind::TooLarge { limit: MAX_NODES }));
        }
        if node.kind == Some(NodeKind::SubTree) {
            return self.subtree(node, depth);
        }
        let builtin = Builtin::by_id(&node.id);
        let (manifest, implementation) = match (builtin, self.registry.leaf(&node.id)) {
            (Some(builtin), _) => (builtin.manifest(), NodeImpl::Builtin(builtin)),
            (None, Some(leaf)) => (leaf.manifest.clone(), NodeImpl::Leaf(leaf.make.clone())),
            (None, None) => {
                let problem = TreeErrorKind::UnknownNode { id: node.id.clone(), known: self.registry.node_names() };
                return Err(self.error(node, problem));
            }
        };
        if let Some(kind) = node.kind
            && kind != manifest.kind
        {
            let (written, is) = (kind.tag(), manifest.kind.tag());
            return Err(self.error(node, TreeErrorKind::WrongKind { id: node.id.clone(), written, is }));
        }
        let ports = self.ports(node, &manifest)?;
        self.count_children(node, manifest.kind)?;
        if builtin == Some(Builtin::Parallel) {
            self.check_counts(node, &ports)?;
        }
        let children = node.children.iter().map(|child| self.node(child, depth + 1)).collect::<Result<_, _>>()?;
        Ok(CheckedNode { name: node.label().to_owned(), implementation, ports, children })
    }

    fn subtree(&mut self, node: &NodeSpec, depth: usize) -> Result<CheckedNode<C>, TreeError> {
        let Some(root) = self.spec.trees.get(&node.id) else {
            let known = join_names(self.spec.trees.keys().map(String::as_str));
            return Err(self.error(node, TreeErrorKind::UnknownTree { tree: node.id.clone(), known }));
        };
        let path: Vec<&str> = self.scopes.iter().map(|scope| scope.tree.as_str()).chain([node.id.as_str()]).collect();
        if path[..path.len() - 1].contains(&node.id.as_str()) {
            return Err(self.error(node, TreeErrorKind::Recursion { path: path.join(" → ") }));
        }
        self.count_children(node, NodeKind::SubTree)?;
        let mut scope = Scope::new(&node.id, node.autoremap);
        for (port, text) in &node.ports {
            let id = match key_of(port, text) {
                Some(key) => self.entry(self.scopes.len() - 1, key),
                None => {
                    let id = self.add_entry(format!("{}/{port}", node.id));
                    self.uses[id.0].is_written = true;
                    let written = self.blackboard.write(id, Value::Text(text.clone()));
                    written.map_err(|error| self.error(node, TreeErrorKind::KeyValue(error)))?;
                    id
                }
            };
            scope.keys.insert(port.clone(), id);
        }
        self.scopes.push(scope);
        let plan = self.node(root, depth + 1);
        let scope = self.scopes.pop().expect("the scope was pushed above");
        let plan = plan?;
        match node.ports.keys().find(|port| !scope.used.contains(*port)) {
            None => Ok(plan),
            Some(port) => {
                let allowed = join_names(scope.used.iter().map(String::as_str));
                Err(self.error(node, TreeErrorKind::UnknownPort { port: port.clone(), allowed }))
            }
        }
    }

    fn count_children(&self, node: &NodeSpec, kind: NodeKind) -> Result<(), TreeError> {
        let found = node.children.len();
        let allowed = match kind {
            NodeKind::Action | NodeKind::Condition | NodeKind::SubTree if found != 0 => "none",
            NodeKind::Decorator if found != 1 => "exactly 1",
            NodeKind::Control if found == 0 => "1 or more",
            _ => return Ok(()),
        };
        Err(self.error(node, TreeErrorKind::Children { found, allowed: allowed.to_owned() }))
    }

    /// A `Parallel` cannot require more children than it has.
    fn check_counts(&self, node: &NodeSpec, ports: &Ports) -> Result<(), TreeError> {
        let found = node.children.len();
        for port in ["success_count", "failure_count"] {
            if let Some(PortBinding::Literal(Value::Integer(count))) = ports.bound.get(port)
                && count.unsigned_abs() > found as u64
            {
                let allowed = format!("{} or more, as `{port}` is {count}", count.unsigned_abs());
                return Err(self.error(node, TreeErrorKind::Children { found, allowed }));
            }
        }
        Ok(())
    }

    fn ports(&mut self, node: &NodeSpec, manifest: &NodeManifest) -> Result<Ports, TreeError> {
        if let Some(port) = node.ports.keys().find(|port| manifest.port(port).is_none()) {
            let problem = TreeErrorKind::UnknownPort { port: port.clone(), allowed: manifest.port_names() };
            return Err(self.error(node, problem));
        }
        let mut ports = Ports::default();
        for port in &manifest.ports {
            let text = match (node.ports.get(&port.name), &port.presence) {
                (Some(text), _) | (None, PortPresence::Default(text)) => text,
                (None, PortPresence::Optional) => continue,
                (None, PortPresence::Required) => {
                    let problem = TreeErrorKind::MissingPort { port: port.name.clone(), wanted: port.port_type };
                    return Err(self.error(node, problem));
                }
            };
            let binding = match (key_of(&port.name, text), port.direction) {
                (Some(key), _) => PortBinding::Entry(self.bind(node, port, key)?),
                (None, PortDirection::Input) => PortBinding::Literal(port.parse(text).map_err(|source| {
                    self.error(node, TreeErrorKind::PortValue { port: port.name.clone(), source })
                })?),
                (None, PortDirection::Output) => {
                    let problem = TreeErrorKind::FixedOutput { port: port.name.clone(), value: text.clone() };
                    return Err(self.error(node, problem));
                }
            };
            ports.bound.insert(port.name.clone(), binding);
        }
        Ok(ports)
    }

    /// Binds a port to a key of the current tree.
    fn bind(&mut self, node: &NodeSpec, port: &PortSpec, key: &str) -> Result<EntryId, TreeError> {
        let id = self.entry(self.scopes.len() - 1, key);
        if let Err(is) = self.blackboard.restrict(id, port.port_type, &port.constraint) {
            let (port, wanted) = (port.name.clone(), port.port_type);
            let key = self.blackboard.key(id).to_owned();
            return Err(self.error(node, TreeErrorKind::KeyType { port, wanted, key, is }));
        }
        let missing_error =
            || self.error(node, TreeErrorKind::NeverWritten { port: port.name.clone(), key: key.to_owned() });
        let missing_error =
            (port.direction == PortDirection::Input && port.presence != PortPresence::Optional).then(missing_error);
        let entry = &mut self.uses[id.0];
        match port.direction {
            PortDirection::Input => entry.read = true,
            PortDirection::Output => entry.is_written = true,
        }
        if entry.missing_error.is_none() {
            entry.missing_error = missing_error;
        }
        Ok(id)
    }

    /// Returns the entry of a key in the tree at `depth`.
    fn entry(&mut self, depth: usize, key: &str) -> EntryId {
        let scope = &mut self.scopes[depth];
        scope.used.insert(key.to_owned());
        if let Some(id) = scope.keys.get(key) {
            return *id;
        }
        // Keys that begin with `_` are private to their tree, as in BehaviorTree.CPP.
        let shared = scope.autoremap && !key.starts_with('_');
        let name = if depth == 0 { key.to_owned() } else { format!("{}/{key}", scope.tree) };
        let id = if shared { self.entry(depth - 1, key) } else { self.add_entry(name) };
        self.scopes[depth].keys.insert(key.to_owned(), id);
        id
    }

    fn add_entry(&mut self, key: String) -> EntryId {
        self.uses.push(Use::default());
        self.blackboard.add(key)
    }

    fn error(&self, node: &NodeSpec, problem: TreeErrorKind) -> TreeError {
        let tree = self.scopes.last().map_or("", |scope| &scope.tree);
        let implementation = match &node.name {
            Some(name) => format!("{tree}/{} ({name})", node.id),
            None => format!("{tree}/{}", node.id),
        };
        TreeError {
            source: self.spec.source.clone(),
            line: node.line,
            node: Some(implementation),
            kind: Box::new(problem),
        }
    }
}

impl Scope {
    fn new(tree: &str, autoremap: bool) -> Scope {
        Scope { tree: tree.to_owned(), autoremap, keys: BTreeMap::new(), used: BTreeSet::new() }
    }
}

/// Returns the key of a binding: `{key}`, or `{=}` for the port's own name. `None` for a fixed
/// value.
fn key_of<'t>(port: &'t str, text: &'t str) -> Option<&'t str> {
    match text.trim().strip_prefix('{')?.strip_suffix('}')? {
        "=" => Some(port),
        "" => None,
        key => Some(key),
    }
}
