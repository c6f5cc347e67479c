//! What a robot can do and what it costs.
//!
//! Skills are behavior trees over the [robot-actions interface](actions); skill descriptors price them with knowledge of
//! the place that environment descriptors hold. Nothing here knows who coordinates whom.

pub mod actions;
pub mod bt;
pub mod descriptor;
pub mod environment;
pub mod library;
pub mod skill;
pub mod xml;
