//! Environment descriptors: knowledge of the place that estimators and skills need (thesis 3.5).
//!
//! A descriptor of a skill names the kinds it needs; they are resolved once, when a node starts. [`Routes`] is the one
//! for driving: shortest ways on a topological map.

mod map;
mod routes;

pub use map::{Edge, MapProblem, TopologicalMap};
pub use routes::{NoRoute, Route, Routes};

use std::collections::BTreeSet;
use std::fmt;
use std::sync::Arc;

/// A kind of environment descriptor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum EnvironmentKind {
    /// Ways between places.
    Routes,
}

impl fmt::Display for EnvironmentKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            EnvironmentKind::Routes => f.write_str("routes (a map)"),
        }
    }
}

/// The environment descriptors that a node has.
#[derive(Debug, Clone, Default)]
pub struct Environment {
    routes: Option<Arc<Routes>>,
}

impl Environment {
    /// Adds the ways between places.
    #[must_use]
    pub fn with_routes(mut self, routes: Arc<Routes>) -> Environment {
        self.routes = Some(routes);
        self
    }

    /// The ways between places.
    pub fn routes(&self) -> Option<&Arc<Routes>> {
        self.routes.as_ref()
    }

    /// The kinds that are here.
    pub fn kinds(&self) -> BTreeSet<EnvironmentKind> {
        self.routes.iter().map(|_| EnvironmentKind::Routes).collect()
    }
}
