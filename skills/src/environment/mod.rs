//! Environment descriptors: knowledge of the place that estimators and skills need (thesis 3.5.1).
//!
//! The set is open: whoever writes a skill descriptor that needs to know of lifts or doors adds a type that implements
//! [`EnvironmentDescriptor`] and puts a value of it into the [`Environment`] when the node starts.

mod map;
mod passages;
mod reference;
mod routes;

pub use map::{Edge, MapError, TopologicalMap};
pub use passages::{Passage, Passages};
pub use reference::ReferenceMapError;
pub use routes::{Route, RouteError, Routes};

use std::any::Any;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A kind of knowledge of the place.
pub trait EnvironmentDescriptor: Any + Send + Sync {
    /// Its name, for messages; two kinds never share one.
    const KIND: &'static str;
}

/// The knowledge of the place that a node has: at most one descriptor of each kind. Cheap to clone: the descriptors
/// are shared.
#[derive(Clone, Default)]
pub struct Environment {
    descriptors: BTreeMap<&'static str, Arc<dyn Any + Send + Sync>>,
}

/// The environment lacks a descriptor that is needed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the environment has no descriptor of kind `{kind}`; it has {known}")]
pub struct MissingDescriptor {
    /// The kind needed.
    pub kind: &'static str,
    /// What there is, in words.
    pub known: String,
}

impl Environment {
    /// Knowledge of nothing.
    pub fn new() -> Environment {
        Environment::default()
    }

    /// The same environment with `descriptor`, in place of any of its kind.
    pub fn with<D: EnvironmentDescriptor>(mut self, descriptor: D) -> Environment {
        self.descriptors.insert(D::KIND, Arc::new(descriptor));
        self
    }

    /// The descriptor of a kind.
    ///
    /// # Errors
    /// [`MissingDescriptor`] names the kind and those there are.
    pub fn get<D: EnvironmentDescriptor>(&self) -> Result<&D, MissingDescriptor> {
        let found = self.descriptors.get(D::KIND).and_then(|descriptor| descriptor.downcast_ref());
        found.ok_or_else(|| self.missing(D::KIND))
    }

    /// The descriptor of a kind, for whoever can do without.
    pub fn find<D: EnvironmentDescriptor>(&self) -> Option<&D> {
        self.get().ok()
    }

    /// Whether there is a descriptor of a kind.
    pub fn contains(&self, kind: &str) -> bool {
        self.descriptors.contains_key(kind)
    }

    /// The kinds there are, in the order of their names.
    pub fn kinds(&self) -> impl Iterator<Item = &'static str> {
        self.descriptors.keys().copied()
    }

    fn missing(&self, kind: &'static str) -> MissingDescriptor {
        MissingDescriptor { kind, known: crate::bt::join_names(self.kinds()) }
    }
}

impl std::fmt::Debug for Environment {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_set().entries(self.descriptors.keys()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Lifts(u32);
    impl EnvironmentDescriptor for Lifts {
        const KIND: &'static str = "lifts";
    }
    struct Doors;
    impl EnvironmentDescriptor for Doors {
        const KIND: &'static str = "doors";
    }

    #[test]
    fn a_descriptor_is_found_by_its_type_and_a_missing_one_is_named() {
        let environment = Environment::new().with(Lifts(1)).with(Lifts(2));
        assert_eq!(environment.get::<Lifts>().unwrap().0, 2);
        let error = environment.get::<Doors>().err().unwrap().to_string();
        assert_eq!(error, "the environment has no descriptor of kind `doors`; it has lifts");
    }
}
