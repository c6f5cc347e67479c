//! What happens on the floor.
//!
//! Bodies, people and samples are entities of an [entity-component store](hecs); what they are is in their components,
//! what happens to them in *systems*, each a file. A setup says which systems a world has.
//!
//! ```text
//!            start, cancel, ask_person            advance(to)
//!  skills ────────────▶ host ──▶ goals ──▶ queue ────────────▶ goals ──▶ events, in order
//!                                  │                             │
//!                               systems: steering, driving, doors, lifts, drawer, people, power …
//!                                  └──▶ floor: components, clock, what is due ◀──┘
//! ```
//!
//! **Time** only moves in [`advance`](consort_skills::actions::BodyHost::advance). Where it can be computed ahead, nothing
//! ticks: where a robot is and what its battery holds are functions of the time since it last began or ended something, and
//! the only entries in the queue are instants at which something ends. So an idle world costs nothing, and the outcome does
//! not depend on the steps in which time is let pass. Two things due at one instant happen in the order in which they were
//! arranged.
//!
//! What cannot be computed ahead (a chassis under control, drones that make way for one another) *steps*: while any such
//! thing moves, and no longer, the queue also holds the next instant of a fixed grid.
//!
//! **Chance** (how long people take) comes from a generator per person, seeded by the world's seed and the person's
//! position in the setup. Two worlds share nothing.
//!
//! **Preconditions** are checked when a goal begins and again when it ends: a drawer that was closed meanwhile, or a
//! robot that left, aborts it, and nothing has changed.
//!
//! ```
//! use consort_protocol::ids::RobotId;
//! use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond, WorldTime};
//! use consort_sim::map;
//! use consort_sim::world::{RobotBody, World, WorldSetup};
//! use consort_skills::actions::{BodyHost, Goal, GoalId, GoalStatus};
//!
//! let ada = RobotId::new("ada")?;
//! let (speed, discharge) = (MetresPerSecond::new(0.5)?, SharePerSecond::new(0.001)?);
//! let body = RobotBody::carrier(ada.clone(), "Dock".parse()?, speed, BatteryShare::FULL, discharge);
//! let mut world = World::new(WorldSetup::new(map::shipped("hospital")?, 7).robot(body))?;
//!
//! let place = "Crossing".parse()?;
//! let pose = world.map().topology().places[&place];
//! world.start(&ada, GoalId(1), Goal::NavigateToPose { pose, place: Some(place) });
//! while let Some(due) = world.next_due() {
//!     world.advance(due);
//! }
//! let told = world.telemetry(&ada).expect("she is here");
//! assert_eq!((world.status(&ada, GoalId(1)), told.place.as_str()), (Some(GoalStatus::Succeeded), "Crossing"));
//! assert!(told.time > WorldTime::ZERO && told.battery < BatteryShare::FULL);
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

/// A world. Made by [`World::new`], driven through [`BodyHost`](consort_skills::actions::BodyHost).
pub struct World {
    state: SimState,
    systems: Vec<&'static dyn System>,
}

/// One of a world's systems, by its place among them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct SystemIndex(usize);

impl World {
    /// The floor.
    pub fn map(&self) -> &Map {
        &self.state.map
    }

    fn system_indices(&self) -> impl Iterator<Item = SystemIndex> + use<> {
        (0..self.systems.len()).map(SystemIndex)
    }

    /// Has one of the systems do something.
    fn run_system<T>(&mut self, chosen: SystemIndex, work: impl FnOnce(&dyn System, &mut SimState) -> T) -> T {
        let system = self.systems[chosen.0];
        self.state.run_as_system(chosen.0, system, |floor| work(system, floor))
    }

    /// Has all systems do something, one after the other.
    fn for_each_system(&mut self, mut work: impl FnMut(&dyn System, &mut SimState)) {
        for chosen in self.system_indices() {
            self.run_system(chosen, &mut work);
        }
    }

    /// Has a system do something on behalf of the outside, if it is one of this world's.
    fn run_as(&mut self, named: &dyn System, work: impl FnOnce(&mut SimState)) {
        if let Some(place) = self.systems.iter().position(|system| system.name() == named.name()) {
            self.run_system(SystemIndex(place), |_, floor| work(floor));
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
