//! Setup of a whole world.

use super::environment::{DoorSetup, ObjectSetup, Obstacle};
use super::limits::{Durations, WorldLimits};
use super::person::PersonSetup;
use super::program_parts::ProgramParts;
use super::robot::RobotSetup;
use crate::map::Map;
use consort_protocol::charging_curve::ChargingCurve;
use consort_protocol::ids::{ActionName, PlaceId, TaskType};
use consort_protocol::units::Watts;
use consort_skills::domain_file::{ActionForm, DomainFile, ReadingForm};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::num::NonZeroUsize;

/// Initial state of a world. Equal setups run alike.
#[derive(Debug, Clone, PartialEq)]
pub struct WorldSetup {
    /// The map.
    pub map: Map,
    /// Robots.
    pub robots: Vec<RobotSetup>,
    /// People.
    pub people: Vec<PersonSetup>,
    /// Objects on tables at the start.
    pub objects: Vec<ObjectSetup>,
    /// Places where robots charge, besides the chargers of the map, with their powers. A robot whose capacity or
    /// whose charger's power is unknown charges at its own rate.
    pub chargers: BTreeMap<PlaceId, Option<Watts>>,
    /// Charging curve of all batteries.
    pub charging_curve: ChargingCurve,
    /// Doors with settings other than the defaults.
    pub doors: Vec<DoorSetup>,
    /// Obstacles, with their times.
    pub obstacles: Vec<Obstacle>,
    /// Seed of all random generators.
    pub seed: u64,
    /// Durations of actions.
    pub durations: Durations,
    /// Actions that domain files declare.
    pub actions: BTreeMap<ActionName, ActionForm>,
    /// Task types that domain files declare, each with the action that a person plays.
    pub tasks: BTreeMap<TaskType, ActionForm>,
    /// Readings that domain files declare: every robot has them.
    pub readings: BTreeMap<String, ReadingForm>,
    /// Limits of memory and numbers.
    pub limits: WorldLimits,
    /// Names of the systems, in the order in which they receive events.
    pub systems: Vec<String>,
    /// Step of the time grid for state that cannot be computed ahead, in seconds; see
    /// [`default_step_s`].
    pub step_s: f64,
    /// Greatest number of threads that move robots with kinematics. A world uses more than one only while
    /// more than a thousand such robots move. The result does not depend on it.
    pub threads: NonZeroUsize,
    /// Gusts that push hovering drones; `None` indoors.
    pub wind: Option<WindSettings>,
    /// Systems and chassis of the program itself.
    pub program: ProgramParts,
}

/// Default time between two steps of a world: 0.05 s. Longer steps are quicker to compute, but
/// detect collisions later.
pub const fn default_step_s() -> f64 {
    0.05
}

/// Gusts: at equal intervals each hovering drone may be pushed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct WindSettings {
    /// Interval, in seconds.
    pub interval_s: f64,
    /// Probability that a drone is pushed, from 0 to 1.
    pub probability: f64,
    /// Greatest change of velocity, in metres per second.
    pub max_speed_change_mps: f64,
}

impl Default for WindSettings {
    /// The gusts of the published swarm: every second, a fifth of the drones is pushed by up to 0.5
    /// m/s.
    fn default() -> Self {
        Self { interval_s: 1.0, probability: 0.2, max_speed_change_mps: 0.5 }
    }
}

impl WorldSetup {
    /// Adds the actions, the task types and the readings of a domain.
    #[must_use]
    pub fn domain(mut self, domain: &DomainFile) -> Self {
        self.actions.extend(domain.simulated_actions());
        self.tasks.extend(domain.simulated_tasks());
        self.readings.extend(domain.reading_forms().map(|(name, form)| (name.clone(), form.clone())));
        self
    }

    /// Adds a robot.
    #[must_use]
    pub fn robot(mut self, robot: RobotSetup) -> Self {
        self.robots.push(robot);
        self
    }

    /// Adds a person.
    #[must_use]
    pub fn person(mut self, person: PersonSetup) -> Self {
        self.people.push(person);
        self
    }
}
