//! A checked description: sub-trees put in their places, ports bound to entries, every name known.

use super::blackboard::{Blackboard, EntryId};
use super::builtin::Builtin;
use super::error::{Problem, TreeError};
use super::expand::Expansion;
use super::leaf::Bound;
use super::node::Slot;
use super::ports::Ports;
use super::registry::{MakeLeaf, Registry};
use super::spec::TreeSpec;
use super::tick::Notes;
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
    root: Plan<C>,
    blackboard: Blackboard,
    keys: BTreeMap<String, EntryId>,
    inputs: Vec<Input>,
}

/// A key of the main tree that is read and that no node writes: whoever starts the tree sets it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Input {
    /// The key.
    pub key: String,
    /// What it takes.
    pub port_type: PortType,
    /// Whether the tree cannot do without.
    pub required: bool,
}

/// A node, checked.
pub(crate) struct Plan<C> {
    pub(crate) name: String,
    pub(crate) what: What<C>,
    pub(crate) ports: Ports,
    pub(crate) children: Vec<Plan<C>>,
}

pub(crate) enum What<C> {
    Builtin(Builtin),
    Leaf(MakeLeaf<C>),
}

impl<C> Blueprint<C> {
    /// Checks a description: [`Registry::check`].
    pub(crate) fn of(spec: &TreeSpec, registry: &Registry<C>) -> Result<Blueprint<C>, TreeError> {
        let Some(root) = spec.trees.get(&spec.main) else {
            let known = super::ports::listed(spec.trees.keys().map(String::as_str));
            let problem = Box::new(Problem::UnknownTree { tree: spec.main.clone(), known });
            return Err(TreeError { source: spec.source.clone(), line: None, node: None, problem });
        };
        let mut expansion = Expansion::new(spec, registry);
        let root = expansion.main(root)?;
        let (blackboard, keys, inputs) = expansion.finish()?;
        Ok(Blueprint { root, blackboard, keys, inputs })
    }

    /// What must or may be set before the first tick, in the order of the keys.
    pub fn inputs(&self) -> &[Input] {
        &self.inputs
    }

    /// Puts a tree to work, with leaves made from `context`.
    pub fn start(&self, context: &C) -> Tree {
        Tree {
            root: self.root.slot(context),
            blackboard: self.blackboard.clone(),
            keys: self.keys.clone(),
            notes: Notes::default(),
        }
    }
}

impl<C> Plan<C> {
    fn slot(&self, context: &C) -> Slot {
        let ports = self.ports.clone();
        Slot::new(match &self.what {
            What::Leaf(make) => Box::new(Bound { name: self.name.clone(), leaf: make(context), ports }),
            What::Builtin(builtin) => {
                let children = self.children.iter().map(|child| child.slot(context)).collect();
                builtin.node(&self.name, ports, children)
            }
        })
    }
}
