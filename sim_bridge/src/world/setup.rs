//! How a world is set up.

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

/// All that a world begins with. Equal setups run alike.
#[derive(Debug, Clone, PartialEq)]
pub struct WorldSetup {
    /// The floor.
    pub map: Map,
    /// The robots on it.
    pub robots: Vec<RobotSetup>,
    /// The people on it.
    pub people: Vec<PersonSetup>,
    /// Things that lie on tables at first.
    pub objects: Vec<ObjectSetup>,
    /// Doors of the map that are not as usual.
    pub doors: Vec<DoorSetup>,
    /// What stands in the way, and when.
    pub obstacles: Vec<Obstacle>,
    /// What chance comes from.
    pub seed: u64,
    /// How long things take.
    pub durations: Durations,
    /// How much the world remembers and holds.
    pub limits: WorldLimits,
    /// What happens there: the names of the systems, in the order in which they hear of things.
    pub systems: Vec<String>,
    /// Time between two instants at which what cannot be computed ahead is brought up to date, in seconds; see
    /// [`default_step_s`].
    pub step_s: f64,
    /// Gusts that push at what hovers; none in a hall.
    pub gusts: Option<WindSettings>,
}

/// Between two steps of a world: 0.05 s. Longer steps are quicker to compute, and collisions are seen later.
pub const fn default_step_s() -> f64 {
    0.05
}

/// Gusts: at equal intervals each hovering body may be pushed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct WindSettings {
    /// From one to the next, in seconds.
    pub every_s: f64,
    /// How likely it is that a body is pushed, from 0 to 1.
    pub chance: f64,
    /// By how much its velocity changes at most, in metres per second.
    pub strength_mps: f64,
}

impl Default for WindSettings {
    /// Those of the published swarm: every second one in five is pushed by up to 0.5 m/s.
    fn default() -> Self {
        Self { every_s: 1.0, chance: 0.2, strength_mps: 0.5 }
    }
}

impl WorldSetup {
    /// An empty floor with default durations and limits.
    pub fn new(map: Map, seed: u64) -> Self {
        let (durations, limits) = (Durations::default(), WorldLimits::default());
        let systems = systems::system_names().map(str::to_owned).collect();
        let (robots, people, objects) = (Vec::new(), Vec::new(), Vec::new());
        let (doors, obstacles) = (Vec::new(), Vec::new());
        let (step_s, gusts) = (default_step_s(), None);
        Self { map, robots, people, objects, doors, obstacles, seed, durations, limits, systems, step_s, gusts }
    }

    /// The same with one more robot.
    #[must_use]
    pub fn robot(mut self, robot: RobotSetup) -> Self {
        self.robots.push(robot);
        self
    }

    /// The same with one more person.
    #[must_use]
    pub fn person(mut self, person: PersonSetup) -> Self {
        self.people.push(person);
        self
    }
}

/// A robot's body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RobotSetup {
    /// Its name.
    pub id: RobotId,
    /// Where it stands at first.
    pub place: PlaceId,
    /// How fast it drives, in metres per second.
    #[serde(rename = "speed_mps")]
    pub speed: MetresPerSecond,
    /// Charge it has at first, as a share.
    pub battery: BatteryShare,
    /// What it loses in a second while a goal is under way, as a share: the rate that its estimator is to reckon with too.
    #[serde(rename = "discharge_share_per_s")]
    pub discharge: SharePerSecond,
    /// What it loses otherwise, as a part of `discharge`: 0 to 1, by default 0.1 as in the published rig.
    #[serde(default = "default_idle_factor")]
    pub idle_factor: f64,
    /// What it gains in a second while it is docked at a charger; what it loses meanwhile goes off that. By default 0.0005 /s, a guess:
    /// full in somewhat more than half an hour.
    #[serde(rename = "charging_share_per_s", default = "default_charging")]
    pub charging: SharePerSecond,
    /// Whether it can drive.
    #[serde(default = "yes")]
    pub mobile: bool,
    /// Whether it has a drawer that people and arms reach into.
    #[serde(default)]
    pub has_drawer: bool,
    /// Whether it has an arm that holds one thing at a time.
    #[serde(default)]
    pub has_arm: bool,
    /// What the arm lifts, in kilograms. By default 2, a guess.
    #[serde(default = "two_kilograms")]
    pub payload_max_kg: f64,
    /// How far the arm reaches from where the robot stands, in metres. By default 1, a guess.
    #[serde(default = "one_metre")]
    pub reach_m: f64,
    /// From its middle to its outermost part, in metres.
    #[serde(default = "default_radius_m")]
    pub radius_m: f64,
    /// How it moves. Without this it drives in straight lines that are computed ahead, which costs nothing while it is under
    /// way, and passes through whatever stands there.
    #[serde(default)]
    pub kinematics: Option<Kinematics>,
    /// What it perceives with.
    #[serde(default)]
    pub sensors: Vec<Sensor>,
}

/// From the middle of a robot to its outermost part: 0.25 m, about that of a small hospital robot.
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

    /// An arm that stays where it is, on mains power.
    pub fn arm(id: RobotId, place: PlaceId) -> Self {
        let speed = MetresPerSecond::new(1.0).expect("1 m/s is a speed");
        let discharge = SharePerSecond::new(0.0).expect("0 /s is a rate");
        let carrier = Self::carrier(id, place, speed, BatteryShare::FULL, discharge);
        Self { mobile: false, has_drawer: false, has_arm: true, ..carrier }
    }

    /// What its battery loses, at work or idle.
    pub fn rate(&self, working: bool) -> SharePerSecond {
        if working {
            return self.discharge;
        }
        SharePerSecond::new(self.discharge.get() * self.idle_factor).unwrap_or(self.discharge)
    }
}

/// A person, who waits at her place for a robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PersonSetup {
    /// Her name.
    pub name: PersonName,
    /// The role she plays in missions.
    pub role: RoleId,
    /// Where she stays.
    pub place: PlaceId,
    /// What she has to hand over, in this order.
    #[serde(default)]
    pub samples: Vec<SampleId>,
    /// What may come over her. By default nothing: she waits, and does what she is asked.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub mood: Vec<SpontaneousAction>,
}

/// How long things take, in seconds of world time. The defaults are those of the published estimates: 2 s for each
/// step that is not driving. People take from 2 to 4 s; patience and memory of robots are guesses too.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Durations {
    /// Coming within reach of a person.
    pub approach_person_s: f64,
    /// Having a person prove who they are.
    pub authenticate_person_s: f64,
    /// Opening or closing a drawer.
    pub operate_drawer_s: f64,
    /// Coming within reach of a robot.
    pub approach_robot_s: f64,
    /// Taking from a drawer.
    pub pick_up_s: f64,
    /// Putting down.
    pub deposit_s: f64,
    /// Connecting to a charger, or disconnecting.
    pub dock_s: f64,
    /// The quickest a person hands something over.
    pub person_min_s: f64,
    /// The slowest a person hands something over.
    pub person_max_s: f64,
    /// How long a robot waits before a door that lets nobody in, until it takes the way to be blocked.
    pub door_patience_s: f64,
    /// How long a robot takes a way to be closed that it found closed, before it tries it again.
    pub closure_remembered_s: f64,
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
            door_patience_s: 120.0,
            closure_remembered_s: 300.0,
        }
    }
}

/// How much a world holds and remembers. More costs memory, nothing else.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct WorldLimits {
    /// Robots, and people, and samples.
    pub entities_max: usize,
    /// Asks of people that have not ended. As many that have ended are told from new ones.
    pub asks_max: usize,
    /// Samples in one drawer.
    pub drawer_slots: usize,
    /// Ended goals of one robot whose status can still be asked for.
    pub ended_kept: usize,
    /// Changes of hands remembered of one sample, and entries of the journal until it is drained; the oldest go first.
    pub history_kept: usize,
}

impl Default for WorldLimits {
    fn default() -> Self {
        Self { entities_max: 10_000, asks_max: 10_000, drawer_slots: 1, ended_kept: 64, history_kept: 4_096 }
    }
}

/// One thing that is wrong with a setup.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SetupError {
    /// A robot, a person or a thing at a place that is not on the map.
    #[error("{who}: there is no place {place:?} on map {map}{hint}", place = place.as_str())]
    UnknownPlace {
        /// `robot r1`, `person Nia`, `object tray`, `obstacle trolley`.
        who: String,
        /// The place as given.
        place: PlaceId,
        /// The map.
        map: String,
        /// The place probably meant, in words; may be empty.
        hint: String,
    },
    /// Two of one name.
    #[error("{who} stands more than once")]
    Duplicate {
        /// `robot r1`, `person Nia`, `sample s1`.
        who: String,
    },
    /// A person, object or sample whose name is not one.
    #[error("{what} {name:?}: a name has 1 to 64 characters, none of them a control character")]
    InvalidName {
        /// `person`, `object` or `sample`.
        what: &'static str,
        /// The name as given.
        name: String,
    },
    /// A number that makes no sense.
    #[error("{who}: {field} is {value}, allowed is {allowed}")]
    InvalidNumber {
        /// `robot r1`, `durations`, `limits`.
        who: String,
        /// The field.
        field: &'static str,
        /// The number.
        value: f64,
        /// The range, in words.
        allowed: &'static str,
    },
    /// A number of a robot's kinematics that makes no sense.
    #[error("{who}, kinematics: {problem}")]
    Kinematics {
        /// `robot r1`.
        who: String,
        /// What is wrong.
        problem: KinematicsError,
    },
    /// A robot with kinematics in a world that does not know what to do with them.
    #[error("{who} has kinematics, so the systems must name driving and steering; they are: {systems}")]
    MissingSystems {
        /// `robot r1`.
        who: String,
        /// The world's systems.
        systems: String,
    },
    /// A system that there is not.
    #[error("there is no system {name:?}{hint}; there are: {known}")]
    UnknownSystem {
        /// The name as given.
        name: String,
        /// Those that there are.
        known: String,
        /// The one probably meant, in words; may be empty.
        hint: String,
    },
    /// Something that cannot come over a person at that moment.
    #[error("{who}: it may come over her at {allowed}")]
    InvalidTrigger {
        /// `person Nia: mood`.
        who: String,
        /// When it may, in words.
        allowed: &'static str,
    },
    /// A door that is not on the map.
    #[error("there is no door {name:?} on map {map}{hint}")]
    UnknownDoor {
        /// The name as given.
        name: String,
        /// The map.
        map: String,
        /// The door probably meant, in words; may be empty.
        hint: String,
    },
    /// Something in a way that is none.
    #[error("{who}: map {map} has no lane between {:?} and {:?}", a.as_str(), b.as_str())]
    UnknownLane {
        /// `obstacle trolley`.
        who: String,
        /// One end.
        a: PlaceId,
        /// The other end.
        b: PlaceId,
        /// The map.
        map: String,
    },
    /// More than [`WorldLimits::entities_max`].
    #[error("{count} {what} are more than the {max} allowed")]
    TooMany {
        /// `robots`, `people`, `samples`.
        what: &'static str,
        /// How many there are.
        count: usize,
        /// How many there may be.
        max: usize,
    },
}

/// All that is wrong with a setup, in its order. Ordinary with hand-written ones; there is no world.
#[derive(Debug, Clone, PartialEq)]
pub struct SetupErrors(pub Vec<SetupError>);

impl std::fmt::Display for SetupErrors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let lines: Vec<String> = self.0.iter().map(ToString::to_string).collect();
        f.write_str(&lines.join("\n"))
    }
}

impl std::error::Error for SetupErrors {}
