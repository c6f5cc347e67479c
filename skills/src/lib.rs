//! Capabilities of robots and their costs.
//!
//! Skills are behavior trees over the [robot-actions interface](actions). Skill descriptors price
//! them with the knowledge about the site in environment descriptors. The [standard domain](domain)
//! declares the task types of the skills, and the [shipped missions](missions) use them. [Domain
//! files](domain_file) add actions and task types as data. This crate
//! contains nothing about coordination.

pub mod actions;
pub mod bt;
pub mod descriptor;
pub mod domain;
pub mod domain_file;
pub mod environment;
pub mod extensions;
pub mod library;
pub mod missions;
mod names;
pub mod skill;
mod waypoints;
pub mod workload;
pub mod xml;
