//! Setup of a world: its robots, people, doors, obstacles and objects, with durations and limits.

pub(super) mod environment;
mod error;
mod limits;
mod person;
mod program_parts;
mod robot;
mod world;

pub use environment::{DoorSetup, ObjectSetup, Obstacle};
pub use error::{SetupError, SetupErrors};
pub use limits::{Durations, WorldLimits};
pub use person::{PersonAction, PersonSetup, PersonTrigger, SpontaneousAction};
pub use program_parts::ProgramParts;
pub use robot::RobotSetup;
pub use world::{WindSettings, WorldSetup, default_step_s};
