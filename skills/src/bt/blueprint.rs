//! A checked description: sub-trees expanded, ports bound to entries, all names resolved.

use super::blackboard::{Blackboard, EntryId};
use super::builtin::Builtin;
use super::error::{TreeError, TreeErrorKind};
use super::expand::Expansion;
use super::leaf::LeafNode;
use super::node::ChildNode;
use super::ports::Ports;
use super::registry::{MakeLeaf, Registry};
use super::spec::TreeSpec;
use super::tick::TreeState;
use super::tree::Tree;
use super::value::PortType;
use std::collections::BTreeMap;

/// Greatest nesting depth of nodes, sub-trees included, in a file and in a tree. Ticking and
/// reading recurse once per level, which the stack must hold. A guess, several times the depth of
/// usual trees.
pub const MAX_DEPTH: usize = 100;

/// Greatest number of nodes of a tree with its sub-trees expanded: ten nested sub-trees, each used
/// twice, make a thousand nodes.
pub const MAX_NODES: usize = 10_000;

/// A checked tree, from which any number of trees can be created.
pub struct Blueprint<C = ()> {
    root: CheckedNode<C>,
    blackboard: Blackboard,
    keys: BTreeMap<String, EntryId>,
    inputs: Vec<TreeInput>,
}

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
    pub(crate) children: Vec<CheckedNode<C>>,
}

pub(crate) enum NodeImpl<C> {
    Builtin(Builtin),
    Leaf(MakeLeaf<C>),
}

impl<C> Blueprint<C> {
    /// Checks a description: see [`Registry::check`].
    pub(crate) fn check(spec: &TreeSpec, registry: &Registry<C>) -> Result<Blueprint<C>, TreeError> {
        let Some(root) = spec.trees.get(&spec.main) else {
            let known = super::ports::join_names(spec.trees.keys().map(String::as_str));
            let problem = Box::new(TreeErrorKind::UnknownTree { tree: spec.main.clone(), known });
            return Err(TreeError { source: spec.source.clone(), line: None, node: None, kind: problem });
        };
        let mut expansion = Expansion::new(spec, registry);
        let root = expansion.main(root)?;
        let (blackboard, keys, inputs) = expansion.finish()?;
        Ok(Blueprint { root, blackboard, keys, inputs })
    }

    /// The keys to set before the first tick, required or optional, in order.
    pub fn inputs(&self) -> &[TreeInput] {
        &self.inputs
    }

    /// Creates a tree. Its leaves are made from `context`.
    pub fn instantiate(&self, context: &C) -> Tree {
        Tree {
            root: self.root.slot(context),
            blackboard: self.blackboard.clone(),
            keys: self.keys.clone(),
            state: TreeState::default(),
        }
    }
}

impl<C> CheckedNode<C> {
    fn slot(&self, context: &C) -> ChildNode {
        let ports = self.ports.clone();
        ChildNode::new(match &self.implementation {
            NodeImpl::Leaf(make) => Box::new(LeafNode { name: self.name.clone(), leaf: make(context), ports }),
            NodeImpl::Builtin(builtin) => {
                let children = self.children.iter().map(|child| child.slot(context)).collect();
                builtin.instantiate(&self.name, ports, children)
            }
        })
    }
}
