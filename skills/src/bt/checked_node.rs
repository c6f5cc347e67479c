//! Checked nodes: names resolved and ports bound.

use super::bound_script::BoundScript;
use super::builtin::Builtin;
use super::conditions::Conditions;
use super::decorator::MapResult;
use super::leaf::LeafNode;
use super::node::{ChildNode, Node};
use super::ports::Ports;
use super::registry::MakeLeaf;
use super::value::PortType;
use std::sync::Arc;

/// Greatest nesting depth of nodes, sub-trees included, in a file and in a tree. Ticking and
/// reading recurse once per level, which the stack must hold. A guess, several times the depth of
/// usual trees.
pub(crate) const MAX_DEPTH: usize = 100;

/// Greatest number of nodes of a tree with its sub-trees expanded: ten nested sub-trees, each used
/// twice, make a thousand nodes.
pub(crate) const MAX_NODES: usize = 10_000;

/// A key of the main tree that is read but that no node writes. The caller sets it after creating
/// the tree.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TreeInput {
    /// The key.
    pub key: String,
    /// Type of the value.
    pub port_type: PortType,
    /// True if the tree needs a value.
    pub required: bool,
}

/// A checked node.
pub(crate) struct CheckedNode<C> {
    pub(crate) name: String,
    pub(crate) implementation: NodeImpl<C>,
    pub(crate) ports: Ports,
    /// The script in the port `code`.
    pub(crate) code: Option<Arc<BoundScript>>,
    pub(crate) conditions: Option<Arc<Conditions>>,
    pub(crate) children: Vec<CheckedNode<C>>,
}

pub(crate) enum NodeImpl<C> {
    Builtin(Builtin),
    Leaf(MakeLeaf<C>),
    /// A use of a sub-tree that has conditions. Its root is the only child.
    SubTree,
}

impl<C> CheckedNode<C> {
    pub(crate) fn slot(&self, context: &C) -> ChildNode {
        let ports = self.ports.clone();
        let mut children: Vec<ChildNode> = self.children.iter().map(|child| child.slot(context)).collect();
        let node: Box<dyn Node> = match &self.implementation {
            NodeImpl::Leaf(make) => Box::new(LeafNode { name: self.name.clone(), leaf: make(context), ports }),
            NodeImpl::Builtin(builtin) => builtin.instantiate(&self.name, ports, self.code.as_ref(), children),
            NodeImpl::SubTree => {
                Box::new(MapResult::unchanged(children.pop().expect("the root of the sub-tree is its child")))
            }
        };
        ChildNode::new(node, self.conditions.clone())
    }
}
