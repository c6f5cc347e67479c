//! The drone swarm of thesis 5.6.1: measures how long a simulated second takes for a number of
//! drones.
//!
//! The drones stand on a field. A controller sends each to its own position on circles around the
//! centre of the field. Each drone reports a result on arrival or after a crash. Drones that have
//! arrived hover, pushed by gusts. The flight is over when all drones have reported, or when no
//! result has arrived for 15 s.
//!
//! All this runs in an ordinary [`World`](crate::world::World): drones are robots with [aerial
//! kinematics](crate::kinematics::Kinematics::Aerial), and the controller sends goals and receives
//! their results.

mod controller;
mod formation;
mod table;

pub use controller::run_swarm;
pub use formation::{Swarm, SwarmError};
pub use table::{SwarmResult, TABLE_HEADER};
