//! Capabilities of robots and their costs.
//!
//! Skills are behavior trees over the [robot-actions interface](actions). Skill descriptors price
//! them with the knowledge about the site in environment descriptors. This crate contains nothing
//! about coordination.

pub mod actions;
pub mod bt;
pub mod descriptor;
pub mod environment;
pub mod library;
pub mod skill;
pub mod xml;
