//! Setup of a world.

use super::environment_setup::{DoorSetup, ObjectSetup, Obstacle};
use super::names::{PersonName, SampleId};
use super::spontaneous_action::SpontaneousAction;
use super::systems;
use super::systems::power::default_idle_factor;
use crate::kinematics::{Kinematics, KinematicsError};
use crate::map::Map;
use crate::space::Sensor;
use consort_protocol::ids::{PlaceId, RobotId, RoleId};
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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
    /// Doors with settings other than the defaults.
    pub doors: Vec<DoorSetup>,
    /// Obstacles, with their times.
    pub obstacles: Vec<Obstacle>,
    /// Seed of all random generators.
    pub seed: u64,
    /// Durations of actions.
    pub durations: Durations,
    /// Limits of memory and numbers.
    pub limits: WorldLimits,
    /// Names of the systems, in the order in which they receive events.
    pub systems: Vec<String>,
    /// Step of the time grid for state that cannot be computed ahead, in seconds; see
    /// [`default_step_s`].
    pub step_s: f64,
    /// Gusts that push hovering drones; `None` indoors.
    pub wind: Option<WindSettings>,
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
    /// An empty world with default durations and limits.
    pub fn new(map: Map, seed: u64) -> Self {
        let (durations, limits) = (Durations::default(), WorldLimits::default());
        let systems = systems::system_names().map(str::to_owned).collect();
        let (robots, people, objects) = (Vec::new(), Vec::new(), Vec::new());
        let (doors, obstacles) = (Vec::new(), Vec::new());
        let (step_s, wind) = (default_step_s(), None);
        Self { map, robots, people, objects, doors, obstacles, seed, durations, limits, systems, step_s, wind }
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

/// Setup of a robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RobotSetup {
    /// Name.
    pub id: RobotId,
    /// Place at the start.
    pub place: PlaceId,
    /// Driving speed, in metres per second.
    #[serde(rename = "speed_mps")]
    pub speed: MetresPerSecond,
    /// State of charge at the start, 0 to 1.
    pub battery: BatteryShare,
    /// Discharge per second while a goal is active, as a share. The robot's estimator must use the
    /// same rate.
    #[serde(rename = "discharge_share_per_s")]
    pub discharge: SharePerSecond,
    /// Discharge without an active goal, as a fraction of `discharge`: 0 to 1, default 0.1 as in
    /// the published rig.
    #[serde(default = "default_idle_factor")]
    pub idle_factor: f64,
    /// Charge per second while docked at a charger; the discharge is subtracted from it. Default:
    /// 0.0005 /s, a guess: full in somewhat more than half an hour.
    #[serde(rename = "charging_share_per_s", default = "default_charging")]
    pub charging: SharePerSecond,
    /// True if the robot can drive.
    #[serde(default = "yes")]
    pub mobile: bool,
    /// True if the robot has a drawer that people and arms can reach into.
    #[serde(default)]
    pub has_drawer: bool,
    /// True if the robot has an arm, which holds a single object.
    #[serde(default)]
    pub has_arm: bool,
    /// Greatest payload of the arm, in kilograms. Default: 2, a guess.
    #[serde(default = "two_kilograms")]
    pub payload_max_kg: f64,
    /// Reach of the arm from the robot's position, in metres. Default: 1, a guess.
    #[serde(default = "one_metre")]
    pub reach_m: f64,
    /// Distance from the centre to the outermost part, in metres.
    #[serde(default = "default_radius_m")]
    pub radius_m: f64,
    /// Kinematics. Without it the robot drives in straight lines that are computed ahead, which
    /// costs nothing while it drives, and passes through every body in its way.
    #[serde(default)]
    pub kinematics: Option<Kinematics>,
    /// Sensors.
    #[serde(default)]
    pub sensors: Vec<Sensor>,
}

/// Default radius of a robot: 0.25 m, about that of a small hospital robot.
pub const fn default_radius_m() -> f64 {
    0.25
}

fn default_charging() -> SharePerSecond {
    SharePerSecond::new(0.0005).expect("0.0005 /s is a rate")
}

fn two_kilograms() -> f64 {
    2.0
}

fn one_metre() -> f64 {
    1.0
}

fn yes() -> bool {
    true
}

impl RobotSetup {
    /// A mobile robot with a drawer.
    pub fn carrier(
        id: RobotId,
        place: PlaceId,
        speed: MetresPerSecond,
        battery: BatteryShare,
        discharge: SharePerSecond,
    ) -> Self {
        Self {
            id,
            place,
            speed,
            battery,
            discharge,
            idle_factor: default_idle_factor(),
            charging: default_charging(),
            mobile: true,
            has_drawer: true,
            has_arm: false,
            payload_max_kg: two_kilograms(),
            reach_m: one_metre(),
            radius_m: default_radius_m(),
            kinematics: None,
            sensors: Vec::new(),
        }
    }

    /// A stationary arm on mains power.
    pub fn arm(id: RobotId, place: PlaceId) -> Self {
        let speed = MetresPerSecond::new(1.0).expect("1 m/s is a speed");
        let discharge = SharePerSecond::new(0.0).expect("0 /s is a rate");
        let carrier = Self::carrier(id, place, speed, BatteryShare::FULL, discharge);
        Self { mobile: false, has_drawer: false, has_arm: true, ..carrier }
    }

    /// Returns the discharge rate with or without an active goal.
    pub fn rate(&self, working: bool) -> SharePerSecond {
        if working {
            return self.discharge;
        }
        SharePerSecond::new(self.discharge.get() * self.idle_factor).unwrap_or(self.discharge)
    }
}

/// A person at a place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PersonSetup {
    /// Name.
    pub name: PersonName,
    /// Role in missions.
    pub role: RoleId,
    /// Place of the person.
    pub place: PlaceId,
    /// Samples to hand over, in order.
    #[serde(default)]
    pub samples: Vec<SampleId>,
    /// Unrequested actions of the person. Default: none, so the person waits and does every
    /// requested task.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub spontaneous_actions: Vec<SpontaneousAction>,
}

/// Durations of actions, in seconds of world time. The defaults are those of the published
/// estimates: 2 s for each step that is not a drive. People take from 2 to 4 s. The timeouts and
/// the memory of robots are guesses too.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Durations {
    /// Approaching a person.
    pub approach_person_s: f64,
    /// Authenticating a person.
    pub authenticate_person_s: f64,
    /// Opening or closing a drawer.
    pub operate_drawer_s: f64,
    /// Approaching a robot.
    pub approach_robot_s: f64,
    /// Taking an object from a drawer.
    pub pick_up_s: f64,
    /// Putting an object down.
    pub deposit_s: f64,
    /// Connecting to a charger, or disconnecting.
    pub dock_s: f64,
    /// Shortest handover by a person.
    pub person_min_s: f64,
    /// Longest handover by a person.
    pub person_max_s: f64,
    /// Time for which a robot waits before a door that admits no robot. After it, the robot regards
    /// the lane as blocked.
    pub door_timeout_s: f64,
    /// Time for which a robot remembers a blocked lane. After it, the robot tries the lane again.
    pub closure_memory_s: f64,
}

impl Default for Durations {
    fn default() -> Self {
        Self {
            approach_person_s: 2.0,
            authenticate_person_s: 2.0,
            operate_drawer_s: 2.0,
            approach_robot_s: 2.0,
            pick_up_s: 2.0,
            deposit_s: 2.0,
            dock_s: 2.0,
            person_min_s: 2.0,
            person_max_s: 4.0,
            door_timeout_s: 120.0,
            closure_memory_s: 300.0,
        }
    }
}

/// Limits of a world's memory and numbers. Larger limits cost only memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct WorldLimits {
    /// Greatest number of robots, of people, and of samples.
    pub entities_max: usize,
    /// Greatest number of open person requests. As many ended requests are kept to recognise
    /// repetitions.
    pub person_requests_max: usize,
    /// Capacity of a drawer, in samples.
    pub drawer_slots: usize,
    /// Number of ended goals kept per robot, with their status.
    pub ended_goals_kept: usize,
    /// Number of transfers kept per sample, and of entries in the event log until it is drained.
    /// The oldest are dropped first.
    pub history_kept: usize,
}

impl Default for WorldLimits {
    fn default() -> Self {
        Self {
            entities_max: 10_000,
            person_requests_max: 10_000,
            drawer_slots: 1,
            ended_goals_kept: 64,
            history_kept: 4_096,
        }
    }
}

/// A mistake in a setup.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SetupError {
    /// The setup names a place that is not on the map.
    #[error("{subject}: there is no place {place:?} on map {map}{hint}", place = place.as_str())]
    UnknownPlace {
        /// `robot r1`, `person Nia`, `object tray`, `obstacle trolley`.
        subject: String,
        /// The place as given.
        place: PlaceId,
        /// The map.
        map: String,
        /// Suggestion, as text; may be empty.
        hint: String,
    },
    /// Two items have the same name.
    #[error("{subject} is defined more than once")]
    Duplicate {
        /// `robot r1`, `person Nia`, `sample s1`.
        subject: String,
    },
    /// The name of a person, object or sample is invalid.
    #[error("{what} {name:?}: a name has 1 to 64 characters, none of them a control character")]
    InvalidName {
        /// `person`, `object` or `sample`.
        what: &'static str,
        /// The name as given.
        name: String,
    },
    /// A number is out of range.
    #[error("{subject}: {field} is {value}, allowed is {allowed}")]
    InvalidNumber {
        /// `robot r1`, `durations`, `limits`.
        subject: String,
        /// The field.
        field: &'static str,
        /// The number.
        value: f64,
        /// The allowed range, as text.
        allowed: &'static str,
    },
    /// A number of a robot's kinematics is out of range.
    #[error("{subject}, kinematics: {error}")]
    Kinematics {
        /// `robot r1`.
        subject: String,
        /// The invalid setting.
        error: KinematicsError,
    },
    /// A robot has kinematics, but the world lacks the systems for it.
    #[error("{subject} has kinematics, so the systems must include driving and steering; they are: {systems}")]
    MissingSystems {
        /// `robot r1`.
        subject: String,
        /// The world's systems.
        systems: String,
    },
    /// The setup names an unknown system.
    #[error("there is no system {name:?}{hint}; there are: {known}")]
    UnknownSystem {
        /// The name as given.
        name: String,
        /// The known systems.
        known: String,
        /// Suggestion, as text; may be empty.
        hint: String,
    },
    /// A person's action does not fit its trigger.
    #[error("{subject}: the trigger does not fit the action; allowed is {allowed}")]
    InvalidTrigger {
        /// `person Nia: spontaneous action`.
        subject: String,
        /// The triggers that fit, as text.
        allowed: &'static str,
    },
    /// The setup names a door that is not on the map.
    #[error("there is no door {name:?} on map {map}{hint}")]
    UnknownDoor {
        /// The name as given.
        name: String,
        /// The map.
        map: String,
        /// Suggestion, as text; may be empty.
        hint: String,
    },
    /// The setup names a lane that is not on the map.
    #[error("{subject}: map {map} has no lane between {:?} and {:?}", a.as_str(), b.as_str())]
    UnknownLane {
        /// `obstacle trolley`.
        subject: String,
        /// First end.
        a: PlaceId,
        /// Second end.
        b: PlaceId,
        /// The map.
        map: String,
    },
    /// The setup exceeds [`WorldLimits::entities_max`].
    #[error("{count} {what} are more than the {max} allowed")]
    TooMany {
        /// `robots`, `people`, `samples`.
        what: &'static str,
        /// The number in the setup.
        count: usize,
        /// The greatest allowed number.
        max: usize,
    },
}

/// All mistakes in a setup, in its order. Common with hand-written setups. No world was created.
#[derive(Debug, Clone, PartialEq)]
pub struct SetupErrors(pub Vec<SetupError>);

impl std::fmt::Display for SetupErrors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let lines: Vec<String> = self.0.iter().map(ToString::to_string).collect();
        f.write_str(&lines.join("\n"))
    }
}

impl std::error::Error for SetupErrors {}
