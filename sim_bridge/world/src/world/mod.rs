//! The simulated world.
//!
//! Robots, people and samples are entities of an [entity-component store](hecs). Components hold
//! their state, and *systems* change it, each in its own file. A setup lists the systems of a
//! world.
//!
//! ```text
//!            start, cancel, request_person        advance(to)
//!  skills ────────────▶ backend ──▶ goals ──▶ queue ────────────▶ goals ──▶ events, in order
//!                                     │                             │
//!                                  systems: steering, driving, doors, lifts, drawer, people, power …
//!                                     └──▶ SimState: components, clock, event queue ◀──┘
//! ```
//!
//! **Time** only moves in [`advance`](consort_skills::actions::RobotBackend::advance). State that
//! can be computed ahead is not ticked: a robot's position and charge are functions of the time
//! since its last change, and the queue contains only the instants at which something ends. An idle
//! world therefore costs nothing, and the result does not depend on the steps in which time is
//! advanced. Two entries for the same instant are processed in the order in which they were
//! scheduled.
//!
//! State that cannot be computed ahead (a chassis under control, drones that avoid each other)
//! *steps*: while such a robot moves, the queue also contains the next instant of a fixed grid.
//!
//! **Randomness** (how long people take) comes from a generator per person, seeded by the world's
//! seed and the person's position in the setup. Two worlds share nothing.
//!
//! **Preconditions** are checked when a goal starts and again when it ends: if a drawer was closed
//! in the meantime, or a robot left, the goal is aborted and nothing has changed.
//!
//! ```
//! use consort_protocol::ids::RobotId;
//! use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond, WorldTime};
//! use consort_world::map;
//! use consort_world::world::{RobotSetup, World, WorldSetup};
//! use consort_skills::actions::{Goal, GoalId, GoalStatus, NavigateToPose, RobotBackend};
//!
//! let ada = RobotId::new("ada")?;
//! let (speed, discharge) = (MetresPerSecond::new(0.5)?, SharePerSecond::new(0.001)?);
//! let robot = RobotSetup::carrier(ada.clone(), "Dock".parse()?, speed, BatteryShare::FULL, discharge);
//! let mut world = World::new(WorldSetup::new(map::shipped("hospital")?, 7).robot(robot))?;
//!
//! let place = "Crossing".parse()?;
//! let pose = world.map().topology().places[&place];
//! world.start(&ada, GoalId(1), Goal::from(NavigateToPose::to(pose, Some(place))));
//! while let Some(due) = world.next_due() {
//!     world.advance(due);
//! }
//! let telemetry = world.telemetry(&ada).expect("ada is in this world");
//! assert_eq!((world.status(&ada, GoalId(1)), telemetry.place.as_str()), (Some(GoalStatus::succeeded()), "Crossing"));
//! assert!(telemetry.time > WorldTime::ZERO && telemetry.battery < BatteryShare::FULL);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod action_systems;
pub mod actions;
mod backend;
mod build;
mod components;
mod declared_moves;
mod drive_progress;
mod event;
mod event_queue;
mod goal_history;
mod goals;
mod location;
mod motion_state;
mod names;
mod own_parts;
mod preconditions;
mod report;
mod routing;
mod samples;
mod sensing;
mod setup;
mod sim_state;
mod simulated_actions;
mod simulation;
mod speed;
mod steered;
mod system;
mod system_access;
mod systems;
#[cfg(test)]
mod tests;

pub use event::{LoggedEvent, SampleHolder, WorldEvent};
pub(crate) use motion_state::{MotionState, MotionSummary};
pub use names::{PersonName, SampleId};
pub use own_parts::SimulatorExtension;
pub use report::{DoorReport, PersonReport, RobotReport, WorldReport};
pub use samples::SampleReport;
pub use sensing::{DetectedObject, Detection, RangeReading, SensorReading};
pub use setup::{
    DoorSetup, Durations, ObjectSetup, Obstacle, PersonAction, PersonSetup, PersonTrigger, ProgramParts, RobotSetup,
    SetupError, SetupErrors, SpontaneousAction, WindSettings, WorldLimits, WorldSetup, default_step_s,
};
pub use sim_state::SimState;
pub use simulated_actions::check_simulated_actions;
pub use simulation::World;
pub use system::{END_UNKNOWN, System};
pub use system_access::{ComponentType, SystemTimer};
pub use systems::power::STOPPING_SHARE;
pub use systems::system_names;
