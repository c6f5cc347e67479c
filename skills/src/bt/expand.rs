//! Checks a description node by node, and expands its sub-trees.

use super::blackboard::EntryId;
use super::bound_script::BoundScript;
use super::builtin::Builtin;
use super::checked_node::{CheckedNode, MAX_DEPTH, MAX_NODES, NodeImpl};
use super::conditions::Conditions;
use super::error::{Place, TreeError, TreeErrorKind};
use super::manifest::{NodeKind, NodeManifest, PortDirection, PortPresence, PortSpec};
use super::ports::{PortBinding, Ports};
use super::registry::Registry;
use super::scopes::{Layout, Scopes};
use super::script::{Script, ScriptError};
use super::spec::{NodeSpec, TreeSpec};
use super::value::Value;
use crate::names::join_names;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The port of `Script` and `ScriptCondition`.
const CODE: &str = "code";

/// State of a check.
pub(crate) struct Expansion<'a, C> {
    spec: &'a TreeSpec,
    registry: &'a Registry<C>,
    scopes: Scopes,
    /// Compiled scripts by text, conditions apart: a sub-tree may be used many times.
    compiled: BTreeMap<(String, bool), Arc<Script>>,
    nodes: usize,
}

impl<'a, C> Expansion<'a, C> {
    pub(crate) fn new(spec: &'a TreeSpec, registry: &'a Registry<C>) -> Self {
        Expansion { spec, registry, scopes: Scopes::new(&spec.main), compiled: BTreeMap::new(), nodes: 0 }
    }

    pub(crate) fn main(&mut self, root: &NodeSpec) -> Result<CheckedNode<C>, TreeError> {
        self.node(root, 1)
    }

    /// Performs the checks that need the whole tree.
    pub(crate) fn finish(self) -> Result<Layout, TreeError> {
        self.scopes.finish(&Place { source: self.spec.source.clone(), line: None, node: None })
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
                let problem =
                    TreeErrorKind::UnknownNode { id: node.id.clone(), known: join_names(self.registry.node_ids()) };
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
        self.count_children(node, manifest.kind, builtin)?;
        if builtin == Some(Builtin::Parallel) || builtin == Some(Builtin::ParallelAll) {
            self.check_counts(node, &ports)?;
        }
        let code = match (builtin, node.ports.get(CODE)) {
            (Some(Builtin::Script | Builtin::ScriptCondition), Some(text)) => {
                let is_condition = builtin == Some(Builtin::ScriptCondition);
                Some(Arc::new(self.script(node, CODE, text, is_condition)?))
            }
            _ => None,
        };
        let conditions = self.conditions(node)?;
        let children = node.children.iter().map(|child| self.node(child, depth + 1)).collect::<Result<_, _>>()?;
        Ok(CheckedNode { name: node.label().to_owned(), implementation, ports, code, conditions, children })
    }

    fn subtree(&mut self, node: &NodeSpec, depth: usize) -> Result<CheckedNode<C>, TreeError> {
        let Some(root) = self.spec.trees.get(&node.id) else {
            let known = join_names(self.spec.trees.keys().map(String::as_str));
            return Err(self.error(node, TreeErrorKind::UnknownTree { tree: node.id.clone(), known }));
        };
        let path: Vec<&str> = self.scopes.path().chain([node.id.as_str()]).collect();
        if path[..path.len() - 1].contains(&node.id.as_str()) {
            return Err(self.error(node, TreeErrorKind::Recursion { path: path.join(" → ") }));
        }
        self.count_children(node, NodeKind::SubTree, None)?;
        // The scripts of the node belong to the enclosing tree.
        let conditions = self.conditions(node)?;
        let mut keys = BTreeMap::new();
        for (port, text) in &node.ports {
            let id = match key_of(port, text) {
                Some(key) => self.scopes.entry(key),
                None => {
                    let fixed = self.scopes.fixed(format!("{}/{port}", node.id), text);
                    fixed.map_err(|error| self.error(node, TreeErrorKind::KeyValue(error)))?
                }
            };
            keys.insert(port.clone(), id);
        }
        self.scopes.enter(&node.id, node.autoremap, keys);
        let root = self.node(root, depth + 1);
        let used = self.scopes.leave();
        let root = root?;
        if let Some(port) = node.ports.keys().find(|port| !used.contains(*port)) {
            let allowed = join_names(used.iter().map(String::as_str));
            return Err(self.error(node, TreeErrorKind::UnknownPort { port: port.clone(), allowed }));
        }
        if conditions.is_none() {
            return Ok(root);
        }
        let (implementation, children) = (NodeImpl::SubTree, vec![root]);
        let (ports, code) = (Ports::default(), None);
        Ok(CheckedNode { name: node.label().to_owned(), implementation, ports, code, conditions, children })
    }

    fn count_children(&self, node: &NodeSpec, kind: NodeKind, builtin: Option<Builtin>) -> Result<(), TreeError> {
        let found = node.children.len();
        let allowed = match (kind, builtin) {
            (NodeKind::Action | NodeKind::Condition | NodeKind::SubTree, _) if found != 0 => "none".to_owned(),
            (NodeKind::Decorator, _) if found != 1 => "exactly 1".to_owned(),
            (_, Some(Builtin::IfThenElse | Builtin::WhileDoElse)) if found != 2 && found != 3 => "2 or 3".to_owned(),
            (_, Some(Builtin::Switch(cases))) if found != usize::from(cases) + 1 => {
                format!("exactly {}: one for each case, then the default", cases + 1)
            }
            (NodeKind::Control, _) if found == 0 => "1 or more".to_owned(),
            _ => return Ok(()),
        };
        Err(self.error(node, TreeErrorKind::Children { found, allowed }))
    }

    /// A parallel node cannot require more children than it has.
    fn check_counts(&self, node: &NodeSpec, ports: &Ports) -> Result<(), TreeError> {
        let found = node.children.len();
        for port in ["success_count", "failure_count", "max_failures"] {
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
        for [first, second] in &manifest.pairs {
            let (bound, missing) = match [first, second].map(|port| node.ports.contains_key(port)) {
                [true, false] => (first.clone(), second.clone()),
                [false, true] => (second.clone(), first.clone()),
                [true, true] | [false, false] => continue,
            };
            return Err(self.error(node, TreeErrorKind::HalfPair { bound, missing }));
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
        let id = self.scopes.entry(key);
        if let Err((key, is)) = self.scopes.restrict(id, port.port_type, &port.constraint) {
            let (port, wanted) = (port.name.clone(), port.port_type);
            return Err(self.error(node, TreeErrorKind::KeyType { port, wanted, key, is }));
        }
        match port.direction {
            PortDirection::Output => self.scopes.note_write(id),
            PortDirection::Input => {
                let required = port.presence != PortPresence::Optional;
                let missing = required.then(|| self.never_written(node, &port.name, key));
                self.scopes.note_read(id, missing);
            }
        }
        Ok(id)
    }

    /// Compiles and binds the script attributes of a node.
    fn conditions(&mut self, node: &NodeSpec) -> Result<Option<Arc<Conditions>>, TreeError> {
        if node.scripts.is_empty() {
            return Ok(None);
        }
        let scripts = node.scripts.iter().map(|(attribute, text)| {
            Ok((*attribute, self.script(node, attribute.name(), text, attribute.is_condition())?))
        });
        Ok(Some(Arc::new(Conditions { scripts: scripts.collect::<Result<_, TreeError>>()? })))
    }

    /// Compiles a script, and binds its names to keys of the current tree.
    fn script(
        &mut self,
        node: &NodeSpec,
        attribute: &'static str,
        text: &str,
        is_condition: bool,
    ) -> Result<BoundScript, TreeError> {
        let place = self.place(node);
        let reject =
            |source: ScriptError| place.error(TreeErrorKind::Script { attribute: attribute.to_owned(), source });
        let script = match self.compiled.get(&(text.to_owned(), is_condition)) {
            Some(script) => script.clone(),
            None => {
                let compile = if is_condition { Script::compile_condition } else { Script::compile };
                let script = Arc::new(compile(text).map_err(reject)?);
                self.compiled.insert((text.to_owned(), is_condition), script.clone());
                script
            }
        };
        let mut entries = BTreeMap::new();
        for key in script.reads() {
            let id = self.scopes.entry(key);
            let missing = self.never_written(node, attribute, key);
            self.scopes.note_read(id, Some(missing));
            entries.insert(key.to_owned(), id);
        }
        for key in script.declares() {
            let id = self.scopes.entry(key);
            self.scopes.note_write(id);
            entries.insert(key.to_owned(), id);
        }
        Ok(BoundScript { script, attribute, entries: entries.into_iter().collect(), place })
    }

    fn never_written(&self, node: &NodeSpec, port: &str, key: &str) -> TreeError {
        self.error(node, TreeErrorKind::NeverWritten { port: port.to_owned(), key: key.to_owned() })
    }

    fn place(&self, node: &NodeSpec) -> Place {
        let tree = self.scopes.tree();
        let label = match &node.name {
            Some(name) => format!("{tree}/{} ({name})", node.id),
            None => format!("{tree}/{}", node.id),
        };
        Place { source: self.spec.source.clone(), line: node.line, node: Some(label) }
    }

    fn error(&self, node: &NodeSpec, problem: TreeErrorKind) -> TreeError {
        self.place(node).error(problem)
    }
}

/// Returns the key of a binding: `{key}`, or `{=}` for the port's own name. `None` for a fixed
/// value.
pub(crate) fn key_of<'t>(port: &'t str, text: &'t str) -> Option<&'t str> {
    match text.trim().strip_prefix('{')?.strip_suffix('}')? {
        "=" => Some(port),
        "" | "@" => None,
        key => Some(key),
    }
}
