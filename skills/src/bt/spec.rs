//! Tree descriptions, read from a file or built in Rust. Not yet checked.

use super::manifest::NodeKind;
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
            autoremap: false,
            children: Vec::new(),
            line: None,
        }
    }

    /// Creates a sub-tree node: a reference to another tree of the same description, with its own
    /// scope.
    pub fn subtree(tree: &str) -> NodeSpec {
        NodeSpec { kind: Some(NodeKind::SubTree), ..NodeSpec::new(tree) }
    }

    /// Binds a port to `{key}` or to a fixed value.
    pub fn port(mut self, port: &str, binding: &str) -> NodeSpec {
        self.ports.insert(port.to_owned(), binding.to_owned());
        self
    }

    /// Adds a child.
    pub fn child(mut self, child: NodeSpec) -> NodeSpec {
        self.children.push(child);
        self
    }

    /// Adds children.
    pub fn children(mut self, children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
        self.children.extend(children);
        self
    }

    /// Sets the display name.
    pub fn named(mut self, name: &str) -> NodeSpec {
        self.name = Some(name.to_owned());
        self
    }

    /// Maps the keys of the sub-tree to those of the enclosing tree.
    pub fn autoremap(mut self) -> NodeSpec {
        self.autoremap = true;
        self
    }

    /// Returns the display name, or else the node type.
    pub fn label(&self) -> &str {
        self.name.as_deref().unwrap_or(&self.id)
    }
}

/// Executes all children in order.
pub fn sequence(children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
    NodeSpec::new("Sequence").children(children)
}

/// Executes children in order until a child succeeds.
pub fn fallback(children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
    NodeSpec::new("Fallback").children(children)
}

/// Executes all children, starting with the first at every tick.
pub fn reactive_sequence(children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
    NodeSpec::new("ReactiveSequence").children(children)
}

/// Executes children until a child succeeds, starting with the first at every tick.
pub fn reactive_fallback(children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
    NodeSpec::new("ReactiveFallback").children(children)
}

/// Executes children in parallel: succeeds when `enough` of them succeed, fails once that is out of
/// reach.
pub fn parallel(enough: u32, children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
    let node = NodeSpec::new("Parallel").children(children);
    node.port("success_count", &enough.to_string()).port("failure_count", "-1")
}

/// Inverts the child's status.
pub fn inverter(child: NodeSpec) -> NodeSpec {
    NodeSpec::new("Inverter").child(child)
}

/// Executes the child up to `attempts` times, until it succeeds.
pub fn retry(attempts: u32, child: NodeSpec) -> NodeSpec {
    NodeSpec::new("RetryUntilSuccessful").port("num_attempts", &attempts.to_string()).child(child)
}

/// Executes the child `cycles` times, while it succeeds.
pub fn repeat(cycles: u32, child: NodeSpec) -> NodeSpec {
    NodeSpec::new("Repeat").port("num_cycles", &cycles.to_string()).child(child)
}

/// Executes the child for at most `msec` milliseconds of world time.
pub fn timeout(msec: u32, child: NodeSpec) -> NodeSpec {
    NodeSpec::new("Timeout").port("msec", &msec.to_string()).child(child)
}
