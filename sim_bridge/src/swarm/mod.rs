//! The drone swarm of thesis 5.6.1: how long a second of simulation takes, for so many drones.
//!
//! Drones stand on a field. A controller sends each to a place of its own on circles around the middle of the field, and
//! each answers when it is there, or when it has crashed. Who has arrived hovers, pushed by gusts. It is over when all have
//! answered, or when for 15 s nobody has.
//!
//! It all happens in an ordinary [`World`](crate::world::World): drones are robots with
//! [aerial kinematics](crate::kinematics::Aerial), the controller sends goals and listens to what comes of them.

mod controller;
mod formation;
mod table;

pub use controller::{RESULT_TIMEOUT_S, SwarmError, run_swarm};
pub use formation::{Swarm, circles};
pub use table::{SwarmResult, TABLE_HEADER};
