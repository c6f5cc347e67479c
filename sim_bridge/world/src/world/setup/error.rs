//! Mistakes in a setup.

use crate::kinematics::KinematicsError;
use consort_protocol::ids::{ActionName, PlaceId};

/// A mistake in a setup.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SetupError {
    /// The setup names a place that is not on the map.
    #[error("{subject}: there is no place {place:?} on map {map}{hint}", place = place.as_str())]
    UnknownPlace {
        /// `robot r1`, `person Nia`, `object tray`, `obstacle trolley`, `charger`.
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
    /// A domain names an unknown system for an action.
    #[error("actions.{action}.simulate.system: there is no system {name:?}{hint}; there are: {known}")]
    UnknownActionSystem {
        /// The action.
        action: ActionName,
        /// The name as given.
        name: String,
        /// The known systems.
        known: String,
        /// Suggestion, as text; may be empty.
        hint: String,
    },
    /// The system that a domain names for an action cannot execute its goals.
    #[error("actions.{action}.{key}: {problem}")]
    ActionOfSystem {
        /// The action.
        action: ActionName,
        /// Key in the declaration of the action.
        key: String,
        /// The problem, and what is allowed.
        problem: String,
    },
    /// A system of the program has the name of another system.
    #[error("this program has a second system {name:?}; a system of its own needs a name of its own")]
    AmbiguousSystem {
        /// The name.
        name: String,
    },
    /// The program's parts of the simulator are of another type.
    #[error("the field `simulator` of the program's extensions is no consort_world::extend::SimulatorExtension")]
    NoSimulatorExtension,
    /// The program has no chassis of this name.
    #[error("{subject}: this program has no chassis {name:?}{hint}; there are: {known}")]
    UnknownChassis {
        /// `robot ada`.
        subject: String,
        /// The name as given.
        name: String,
        /// The chassis of the program.
        known: String,
        /// Suggestion, as text; may be empty.
        hint: String,
    },
    /// A chassis of the program rejects its settings.
    #[error("{subject}: chassis {name}: {problem}")]
    InvalidChassis {
        /// `robot ada`.
        subject: String,
        /// The chassis.
        name: String,
        /// The reason.
        problem: String,
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
    /// The setup exceeds [`WorldLimits::entities_max`](super::WorldLimits::entities_max).
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
