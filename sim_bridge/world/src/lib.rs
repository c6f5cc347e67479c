//! A simulated world for robots, behind the robot-actions interface.
//!
//! [`map`] is the site: places, lanes between them, walls. [`world`] simulates it as discrete
//! events on a clock that only its owner advances: robots that drive, people with samples to hand
//! over, batteries that run down. [`kinematics`] models how robots move. [`record`] writes
//! recordings. This crate contains nothing about missions, auctions or coordinators.

pub mod device;
pub mod extend;
pub mod kinematics;
pub mod map;
pub mod record;
mod shared;
pub mod space;
pub mod suggest;
pub mod swarm;
pub mod world;

pub use shared::SharedWorld;
