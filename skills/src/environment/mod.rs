//! Environment descriptors: knowledge about the site that estimators and skills need (thesis
//! 3.5.1).
//!
//! The set is open. A skill descriptor that needs further knowledge, for instance about lifts or
//! doors, brings a type that implements [`EnvironmentDescriptor`]. A value of it is added to the
//! [`Environment`] when the node starts.

mod descriptor;
mod map;
mod passages;
mod reference;
mod routes;
mod speed_limits;

pub use descriptor::{Environment, EnvironmentDescriptor, MissingDescriptor};
pub use map::{Edge, MapError, TopologicalMap};
pub use passages::{Passage, Passages};
pub use reference::ReferenceMapError;
pub use routes::{Route, RouteError, Routes};
pub use speed_limits::SpeedLimits;
