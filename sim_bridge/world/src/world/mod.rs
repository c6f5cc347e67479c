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
//! use consort_skills::actions::{Goal, GoalId, GoalStatus, RobotBackend};
//!
//! let ada = RobotId::new("ada")?;
//! let (speed, discharge) = (MetresPerSecond::new(0.5)?, SharePerSecond::new(0.001)?);
//! let robot = RobotSetup::carrier(ada.clone(), "Dock".parse()?, speed, BatteryShare::FULL, discharge);
//! let mut world = World::new(WorldSetup::new(map::shipped("hospital")?, 7).robot(robot))?;
//!
//! let place = "Crossing".parse()?;
//! let pose = world.map().topology().places[&place];
//! world.start(&ada, GoalId(1), Goal::NavigateToPose { pose, place: Some(place) });
//! while let Some(due) = world.next_due() {
//!     world.advance(due);
//! }
//! let telemetry = world.telemetry(&ada).expect("ada is in this world");
//! assert_eq!((world.status(&ada, GoalId(1)), telemetry.place.as_str()), (Some(GoalStatus::Succeeded), "Crossing"));
//! assert!(telemetry.time > WorldTime::ZERO && telemetry.battery < BatteryShare::FULL);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod backend;
mod build;
mod components;
mod drive_progress;
mod environment_setup;
mod event_log;
mod event_queue;
mod goals;
mod location;
mod motion_state;
mod names;
mod preconditions;
mod report;
mod routing;
mod samples;
mod sensing;
mod setup;
mod shared;
mod sim_state;
mod speed;
mod spontaneous_action;
mod system;
mod systems;
#[cfg(test)]
mod tests;

pub use environment_setup::{DoorSetup, ObjectSetup, Obstacle};
pub use event_log::{LoggedEvent, WorldEvent};
pub(crate) use motion_state::{MotionState, MotionSummary};
pub use names::{PersonName, SampleId};
pub(crate) use preconditions::goal_name;
pub use report::{DoorReport, PersonReport, RobotReport};
pub use samples::{SampleHolder, SampleReport};
pub use sensing::{DetectedObject, Detection, SensorReading};
pub use setup::{
    Durations, PersonSetup, RobotSetup, SetupError, SetupErrors, WindSettings, WorldLimits, WorldSetup,
    default_radius_m, default_step_s,
};
pub use shared::SharedWorld;
pub use spontaneous_action::{PersonAction, PersonTrigger, SpontaneousAction};
pub use systems::power::{STOPPING_SHARE, default_idle_factor};
pub use systems::system_names;

use crate::map::Map;
use sim_state::SimState;
use system::System;

/// A simulated world. Created by [`World::new`], driven through
/// [`RobotBackend`](consort_skills::actions::RobotBackend).
pub struct World {
    state: SimState,
    systems: Vec<&'static dyn System>,
}

/// Index of a system in a world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct SystemIndex(usize);

impl World {
    /// The map.
    pub fn map(&self) -> &Map {
        &self.state.map
    }

    fn system_indices(&self) -> impl Iterator<Item = SystemIndex> + use<> {
        (0..self.systems.len()).map(SystemIndex)
    }

    /// Runs `run` as the system with this index.
    fn run_system<T>(&mut self, index: SystemIndex, run: impl FnOnce(&dyn System, &mut SimState) -> T) -> T {
        let system = self.systems[index.0];
        self.state.run_as_system(index.0, system, |state| run(system, state))
    }

    /// Runs `run` as each of the systems in turn.
    fn for_each_system(&mut self, mut run: impl FnMut(&dyn System, &mut SimState)) {
        for index in self.system_indices() {
            self.run_system(index, &mut run);
        }
    }

    /// Runs `run` as a given system on behalf of a caller from outside, if the system is part of
    /// this world.
    fn run_as(&mut self, caller: &dyn System, run: impl FnOnce(&mut SimState)) {
        if let Some(place) = self.systems.iter().position(|system| system.name() == caller.name()) {
            self.run_system(SystemIndex(place), |_, state| run(state));
            self.process_commands_and_defer();
        }
    }
}

impl std::fmt::Debug for World {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("World")
            .field("map", &self.state.map.name())
            .field("now", &self.state.now)
            .field("robots", &self.state.robots.len())
            .field("people", &self.state.people.len())
            .field("due", &self.state.queue.len())
            .finish_non_exhaustive()
    }
}
