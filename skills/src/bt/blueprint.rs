//! A checked description: sub-trees put in their places, ports bound to entries, every name known.

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

/// Deepest nesting of nodes, sub-trees included, in a file as in a tree: what ticks and reads a tree calls itself once
/// a level, and a stack must hold that. A guess, several times what people draw.
pub const MAX_DEPTH: usize = 100;

/// Most nodes of one tree with its sub-trees expanded: ten sub-trees of two each are a thousand nodes already.
pub const MAX_NODES: usize = 10_000;

/// A checked tree, from which any number of trees can be started.
pub struct Blueprint<C = ()> {
    root: CheckedNode<C>,
    blackboard: Blackboard,
    keys: BTreeMap<String, EntryId>,
    inputs: Vec<TreeInput>,
}

/// A key of the main tree that is read and that no node writes: whoever starts the tree sets it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TreeInput {
    /// The key.
    pub key: String,
    /// What it takes.
    pub port_type: PortType,
    /// Whether the tree cannot do without.
    pub required: bool,
}

/// A node, checked.
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
    /// Checks a description: [`Registry::check`].
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

    /// What must or may be set before the first tick, in the order of the keys.
    pub fn inputs(&self) -> &[TreeInput] {
        &self.inputs
    }

    /// Puts a tree to work, with leaves made from `context`.
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
