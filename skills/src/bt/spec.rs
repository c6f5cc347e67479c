//! Tree descriptions, read from a file or built in Rust. Not yet checked.

use super::manifest::NodeKind;
use super::script_attribute::ScriptAttribute;
use std::collections::BTreeMap;

/// A main tree and its sub-trees.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TreeSpec {
    /// Origin of the description, for messages.
    pub source: String,
    /// Name of the main tree.
    pub main: String,
    /// All trees by name.
    pub trees: BTreeMap<String, NodeSpec>,
}

/// A node of a description.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeSpec {
    /// The node type (`Sequence`, `NavigateToPose`), or the name of the tree for a sub-tree.
    pub id: String,
    /// The kind in the description; `None` for compact XML, where the registry determines it.
    pub kind: Option<NodeKind>,
    /// A display name for this use of the node.
    pub name: Option<String>,
    /// Bindings of the ports: `{key}` is a key of the blackboard, any other text a fixed value.
    pub ports: BTreeMap<String, String>,
    /// Scripts of the pre- and postconditions.
    pub scripts: BTreeMap<ScriptAttribute, String>,
    /// For a sub-tree: true if keys that are not remapped refer to the same keys of the enclosing
    /// tree.
    pub autoremap: bool,
    /// Children, in order.
    pub children: Vec<NodeSpec>,
    /// Line in the file, from 1.
    pub line: Option<u32>,
}

impl TreeSpec {
    /// Creates a description with a single tree.
    pub fn single(name: &str, root: NodeSpec) -> TreeSpec {
        TreeSpec { source: name.to_owned(), main: name.to_owned(), trees: BTreeMap::from([(name.to_owned(), root)]) }
    }

    /// Adds a tree, for sub-trees to refer to.
    pub fn with(mut self, name: &str, root: NodeSpec) -> TreeSpec {
        self.trees.insert(name.to_owned(), root);
        self
    }
}

impl NodeSpec {
    /// Creates a node without ports and children.
    pub fn new(id: &str) -> NodeSpec {
        NodeSpec {
            id: id.to_owned(),
            kind: None,
            name: None,
            ports: BTreeMap::new(),
            scripts: BTreeMap::new(),
            autoremap: false,
            children: Vec::new(),
            line: None,
        }
    }

    /// Creates a sub-tree node: a reference to another tree of the same description, with its own
    /// scope.
    #[cfg(test)]
    pub(crate) fn subtree(tree: &str) -> NodeSpec {
        NodeSpec { kind: Some(NodeKind::SubTree), ..NodeSpec::new(tree) }
    }

    /// Binds a port to `{key}` or to a fixed value.
    pub fn port(mut self, port: &str, binding: &str) -> NodeSpec {
        self.ports.insert(port.to_owned(), binding.to_owned());
        self
    }

    /// Sets the script of a pre- or postcondition.
    pub fn script(mut self, attribute: ScriptAttribute, script: &str) -> NodeSpec {
        self.scripts.insert(attribute, script.to_owned());
        self
    }

    /// Adds a child.
    pub(crate) fn child(mut self, child: NodeSpec) -> NodeSpec {
        self.children.push(child);
        self
    }

    /// Adds children.
    pub(crate) fn children(mut self, children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
        self.children.extend(children);
        self
    }

    /// Sets the display name.
    pub fn named(mut self, name: &str) -> NodeSpec {
        self.name = Some(name.to_owned());
        self
    }

    /// Maps the keys of the sub-tree to those of the enclosing tree.
    #[cfg(test)]
    pub(crate) fn autoremap(mut self) -> NodeSpec {
        self.autoremap = true;
        self
    }

    /// Returns the display name, or else the node type.
    pub(crate) fn label(&self) -> &str {
        self.name.as_deref().unwrap_or(&self.id)
    }
}

/// Executes all children in order.
pub fn sequence(children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
    NodeSpec::new("Sequence").children(children)
}

/// Executes the child for at most `msec` milliseconds of world time.
pub fn timeout(msec: u32, child: NodeSpec) -> NodeSpec {
    NodeSpec::new("Timeout").port("msec", &msec.to_string()).child(child)
}
