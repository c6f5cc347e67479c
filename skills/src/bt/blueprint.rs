//! A checked description: sub-trees expanded, ports bound to entries, all names resolved.

use super::blackboard::{Blackboard, EntryId};
use super::checked_node::{CheckedNode, TreeInput};
use super::error::{TreeError, TreeErrorKind};
use super::expand::Expansion;
use super::registry::Registry;
use super::spec::TreeSpec;
use super::tick::TreeState;
use super::tree::Tree;
use std::collections::BTreeMap;

/// A checked tree, from which any number of trees can be created.
pub struct Blueprint<C = ()> {
    root: CheckedNode<C>,
    blackboard: Blackboard,
    keys: BTreeMap<String, EntryId>,
    inputs: Vec<TreeInput>,
}

impl<C> Registry<C> {
    /// Checks a description against the registered nodes.
    ///
    /// # Errors
    /// [`TreeError`] for the first mistake, with its position and the allowed values.
    pub fn check(&self, spec: &TreeSpec) -> Result<Blueprint<C>, TreeError> {
        Blueprint::check(spec, self)
    }
}

impl<C> Blueprint<C> {
    fn check(spec: &TreeSpec, registry: &Registry<C>) -> Result<Blueprint<C>, TreeError> {
        let Some(root) = spec.trees.get(&spec.main) else {
            let known = crate::names::join_names(spec.trees.keys().map(String::as_str));
            let problem = Box::new(TreeErrorKind::UnknownTree { tree: spec.main.clone(), known });
            return Err(TreeError { source: spec.source.clone(), line: None, node: None, kind: problem });
        };
        let mut expansion = Expansion::new(spec, registry);
        let root = expansion.main(root)?;
        let (blackboard, keys, inputs) = expansion.finish()?;
        Ok(Blueprint { root, blackboard, keys, inputs })
    }

    /// The keys to set before the first tick, required or optional, in order.
    pub(crate) fn inputs(&self) -> &[TreeInput] {
        &self.inputs
    }

    /// Creates a tree. Its leaves are made from `context`.
    pub(crate) fn instantiate(&self, context: &C) -> Tree {
        Tree {
            root: self.root.slot(context),
            blackboard: self.blackboard.clone(),
            keys: self.keys.clone(),
            state: TreeState::default(),
        }
    }
}
