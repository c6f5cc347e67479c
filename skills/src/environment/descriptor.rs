//! The set of descriptors of a site.

use crate::names::join_names;
use std::any::Any;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A kind of knowledge about the site.
pub trait EnvironmentDescriptor: Any + Send + Sync {
    /// Name for messages, unique among all kinds.
    const KIND: &'static str;
}

/// A node's knowledge about the site: at most a single descriptor of each kind. Cheap to clone: the
/// descriptors are shared.
#[derive(Clone, Default)]
pub struct Environment {
    descriptors: BTreeMap<&'static str, Arc<dyn Any + Send + Sync>>,
}

/// The environment lacks a required descriptor.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the environment has no descriptor of kind `{kind}`; it has {known}")]
pub struct MissingDescriptor {
    /// The required kind.
    pub kind: &'static str,
    /// The existing kinds, as text.
    pub known: String,
}

impl Environment {
    /// Creates an empty environment.
    pub fn new() -> Environment {
        Environment::default()
    }

    /// Adds `descriptor`, replacing any of its kind.
    pub fn with<D: EnvironmentDescriptor>(mut self, descriptor: D) -> Environment {
        self.descriptors.insert(D::KIND, Arc::new(descriptor));
        self
    }

    /// Returns the descriptor of a kind.
    ///
    /// # Errors
    /// [`MissingDescriptor`] with the kind and the existing kinds.
    pub fn get<D: EnvironmentDescriptor>(&self) -> Result<&D, MissingDescriptor> {
        let found = self.descriptors.get(D::KIND).and_then(|descriptor| descriptor.downcast_ref());
        found.ok_or_else(|| self.missing(D::KIND))
    }

    /// Returns the descriptor of a kind, if it exists.
    pub fn find<D: EnvironmentDescriptor>(&self) -> Option<&D> {
        self.get().ok()
    }

    /// Checks whether a descriptor of a kind exists.
    pub fn contains(&self, kind: &str) -> bool {
        self.descriptors.contains_key(kind)
    }

    /// The existing kinds, in the order of their names.
    pub(crate) fn kinds(&self) -> impl Iterator<Item = &'static str> {
        self.descriptors.keys().copied()
    }

    fn missing(&self, kind: &'static str) -> MissingDescriptor {
        MissingDescriptor { kind, known: join_names(self.kinds()) }
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
    fn get_finds_a_descriptor_by_type_and_names_a_missing_kind() {
        let environment = Environment::new().with(Lifts(1)).with(Lifts(2));
        assert_eq!(environment.get::<Lifts>().unwrap().0, 2);
        let error = environment.get::<Doors>().err().unwrap().to_string();
        assert_eq!(error, "the environment has no descriptor of kind `doors`; it has lifts");
    }
}
