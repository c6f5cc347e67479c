//! A world for robots to act in, behind the robot-actions interface.
//!
//! [`map`] is the floor: places, lanes between them, walls. [`world`] is what happens on it: robots that drive, people
//! who hand things over, samples that change hands, batteries that run down, all as discrete events on a clock that only
//! moves when its owner lets it. [`kinematics`] is how bodies move. [`experiment`] is the arithmetic of the evaluation. Nothing here knows missions, auctions or who coordinates whom.

pub mod experiment;
pub mod kinematics;
pub mod map;
pub mod space;
mod suggest;
pub mod swarm;
pub mod world;
