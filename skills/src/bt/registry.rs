//! The registry of leaves for trees.

use super::builtin::Builtin;
use super::leaf::{Leaf, SyncLeaf};
use super::manifest::{NodeKind, NodeManifest, PortSpec};
use super::tick::{Cause, LeafContext};
use std::collections::BTreeMap;
use std::sync::Arc;

pub(crate) type MakeLeaf<C> = Arc<dyn Fn(&C) -> Box<dyn Leaf> + Send + Sync>;

/// Leaf types by name, each with a factory. `C` is the context that factories receive when a tree
/// is created.
pub struct Registry<C = ()> {
    leaves: BTreeMap<String, Registered<C>>,
}

pub(crate) struct Registered<C> {
    pub(crate) manifest: NodeManifest,
    pub(crate) make: MakeLeaf<C>,
}

/// A leaf type was rejected. The registry is unchanged.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RegistryError {
    /// The name is already in use.
    #[error("a node `{id}` is already registered")]
    DuplicateName {
        /// The name.
        id: String,
    },
    /// Only actions and conditions can be registered.
    #[error("`{id}` is of kind <{kind}>; allowed are <Action> and <Condition>")]
    NotALeaf {
        /// The name.
        id: String,
        /// The kind in the manifest.
        kind: &'static str,
    },
}

impl<C> Default for Registry<C> {
    fn default() -> Self {
        Registry { leaves: BTreeMap::new() }
    }
}

impl<C> Registry<C> {
    /// Creates a registry that contains only the built-in nodes.
    pub fn new() -> Registry<C> {
        Registry::default()
    }

    /// Registers a leaf type.
    ///
    /// # Errors
    /// [`RegistryError`] if the name is in use or the manifest is not that of a leaf.
    pub fn register(
        &mut self,
        manifest: NodeManifest,
        make: impl Fn(&C) -> Box<dyn Leaf> + Send + Sync + 'static,
    ) -> Result<(), RegistryError> {
        let id = manifest.id.clone();
        if self.leaves.contains_key(&id) || Builtin::by_id(&id).is_some() {
            return Err(RegistryError::DuplicateName { id });
        }
        if !matches!(manifest.kind, NodeKind::Action | NodeKind::Condition) {
            return Err(RegistryError::NotALeaf { id, kind: manifest.kind.tag() });
        }
        self.leaves.insert(id, Registered { manifest, make: Arc::new(make) });
        Ok(())
    }

    /// Registers a condition made of a function.
    ///
    /// # Errors
    /// [`RegistryError`] if the name is in use.
    pub fn register_condition(
        &mut self,
        id: &str,
        ports: impl IntoIterator<Item = PortSpec>,
        check: impl Fn(&mut LeafContext<'_, '_>) -> Result<bool, Cause> + Send + Sync + Clone + 'static,
    ) -> Result<(), RegistryError> {
        let manifest = NodeManifest::new(id, NodeKind::Condition, ports);
        self.register(manifest, move |_| Box::new(SyncLeaf(check.clone())))
    }

    /// Manifests of the registered leaves, without the built-in nodes.
    pub(crate) fn manifests(&self) -> impl Iterator<Item = &NodeManifest> {
        self.leaves.values().map(|leaf| &leaf.manifest)
    }

    pub(crate) fn leaf(&self, id: &str) -> Option<&Registered<C>> {
        self.leaves.get(id)
    }

    /// All node names: first those of the built-in nodes.
    pub(crate) fn node_ids(&self) -> impl Iterator<Item = &str> {
        Builtin::ALL.map(Builtin::id).into_iter().chain(self.leaves.keys().map(String::as_str))
    }
}
