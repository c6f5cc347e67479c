//! A tree as a description: what stands in a file, or is put together in Rust. Not yet checked.

use super::ports::NodeKind;
use std::collections::BTreeMap;

/// One or more trees, of which one is the main one and the others are its sub-trees.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TreeSpec {
    /// Where it was read from, for messages.
    pub source: String,
    /// The name of the main tree.
    pub main: String,
    /// Every tree by name.
    pub trees: BTreeMap<String, NodeSpec>,
}

/// A node of a description.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeSpec {
    /// The kind of node (`Sequence`, `NavigateToPose`), or the name of the tree for a sub-tree.
    pub id: String,
    /// What the description says it is; `None` where it leaves that to the registry (compact XML).
    pub kind: Option<NodeKind>,
    /// The name that people gave to this use of it.
    pub name: Option<String>,
    /// What its ports are bound to: `{key}` is a key of the blackboard, anything else a fixed value.
    pub ports: BTreeMap<String, String>,
    /// For a sub-tree: whether keys that are not remapped stand for the same keys of the tree around it.
    pub autoremap: bool,
    /// Its children, in order.
    pub children: Vec<NodeSpec>,
    /// The line it was read from, counted from 1.
    pub line: Option<u32>,
}

impl TreeSpec {
    /// A description with one tree.
    pub fn single(name: &str, root: NodeSpec) -> TreeSpec {
        TreeSpec { source: name.to_owned(), main: name.to_owned(), trees: BTreeMap::from([(name.to_owned(), root)]) }
    }

    /// The same description with one more tree, for sub-trees to name.
    pub fn with(mut self, name: &str, root: NodeSpec) -> TreeSpec {
        self.trees.insert(name.to_owned(), root);
        self
    }
}

impl NodeSpec {
    /// A node without ports and children.
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

    /// A sub-tree: another tree of the same description, with a scope of its own.
    pub fn subtree(tree: &str) -> NodeSpec {
        NodeSpec { kind: Some(NodeKind::SubTree), ..NodeSpec::new(tree) }
    }

    /// The same node with a port bound to `{key}` or to a fixed value.
    pub fn port(mut self, port: &str, binding: &str) -> NodeSpec {
        self.ports.insert(port.to_owned(), binding.to_owned());
        self
    }

    /// The same node with one more child.
    pub fn child(mut self, child: NodeSpec) -> NodeSpec {
        self.children.push(child);
        self
    }

    /// The same node with more children.
    pub fn children(mut self, children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
        self.children.extend(children);
        self
    }

    /// The same node with a name for people.
    pub fn named(mut self, name: &str) -> NodeSpec {
        self.name = Some(name.to_owned());
        self
    }

    /// The same sub-tree with its keys standing for those of the tree around it.
    pub fn autoremap(mut self) -> NodeSpec {
        self.autoremap = true;
        self
    }

    /// The name for people, else the kind of node.
    pub fn label(&self) -> &str {
        self.name.as_deref().unwrap_or(&self.id)
    }
}

/// All of the children, in order.
pub fn sequence(children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
    NodeSpec::new("Sequence").children(children)
}

/// The first child that succeeds.
pub fn fallback(children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
    NodeSpec::new("Fallback").children(children)
}

/// All of the children, asked anew at every tick.
pub fn reactive_sequence(children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
    NodeSpec::new("ReactiveSequence").children(children)
}

/// The first child that succeeds, asked anew at every tick.
pub fn reactive_fallback(children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
    NodeSpec::new("ReactiveFallback").children(children)
}

/// Children side by side: success when `enough` of them succeed, failure once that is out of reach.
pub fn parallel(enough: u32, children: impl IntoIterator<Item = NodeSpec>) -> NodeSpec {
    let node = NodeSpec::new("Parallel").children(children);
    node.port("success_count", &enough.to_string()).port("failure_count", "-1")
}

/// The child's answer turned round.
pub fn inverter(child: NodeSpec) -> NodeSpec {
    NodeSpec::new("Inverter").child(child)
}

/// The child up to `attempts` times, until it succeeds.
pub fn retry(attempts: u32, child: NodeSpec) -> NodeSpec {
    NodeSpec::new("RetryUntilSuccessful").port("num_attempts", &attempts.to_string()).child(child)
}

/// The child `cycles` times, while it succeeds.
pub fn repeat(cycles: u32, child: NodeSpec) -> NodeSpec {
    NodeSpec::new("Repeat").port("num_cycles", &cycles.to_string()).child(child)
}

/// The child for at most `msec` milliseconds of world time.
pub fn timeout(msec: u32, child: NodeSpec) -> NodeSpec {
    NodeSpec::new("Timeout").port("msec", &msec.to_string()).child(child)
}
