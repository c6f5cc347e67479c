//! Parts of the simulator that a program adds: systems with their components, and chassis.
//!
//! A program of a user is `consort` or `consort-lab` itself, with
//! [`Extensions`](consort_skills::extensions::Extensions) whose field `simulator` is a
//! [`SimulatorExtension`]: see `docs/tutorials/simulator.md`.
//!
//! - A [`System`] simulates an aspect of the world, with components of its own. An action whose domain names
//!   the system (`simulate: { system: NAME }`) is played by it. A sensor is a system that sets a
//!   reading ([`SimState::set_reading`]).
//! - A [`Chassis`] moves a robot whose setup names it: `kinematics = { kind = "own", name = NAME }`.

pub use crate::component_types;
pub use crate::kinematics::{Chassis, ChassisBuilder, ChassisSettings, NamedChassis};
pub use crate::world::{ComponentType, END_UNKNOWN, SimState, SimulatorExtension, System, SystemTimer};
pub use hecs::{Component, Entity};
pub use nalgebra;
