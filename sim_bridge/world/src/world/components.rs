//! Components that belong to no single system.

use super::names::{PersonName, SampleId};
use super::setup::RobotSetup;
use crate::map::PlaceIndex;
use consort_protocol::ids::RoleId;
use hecs::Entity;
use rand_chacha::ChaCha8Rng;

/// A robot: its setup. Its discharge rate here is the only rate used.
pub(crate) struct SimRobot(pub(crate) RobotSetup);

/// The person or robot that a robot has approached.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CoPresence {
    None,
    Person {
        person: Entity,
        authenticated: bool,
    },
    Robot {
        robot: Entity,
        /// Departure count of that robot at the approach. Once it departs, the two are no longer
        /// next to each other.
        departures: u64,
    },
}

/// Number of times a robot has departed from its position.
pub(crate) struct DepartureCount(pub(crate) u64);

/// True while a robot's drawer is open. Its content is stored with the samples.
pub(crate) struct DrawerOpen(pub(crate) bool);

/// A person: identity and place.
pub(crate) struct PersonInfo {
    pub(crate) name: PersonName,
    pub(crate) role: RoleId,
    pub(crate) place: PlaceIndex,
    /// The person comes to robots at other places.
    pub(crate) on_call: bool,
}

/// True while a person hands something over or does another task.
pub(crate) struct HandsBusy(pub(crate) bool);

/// Random generator for the times and the results of a person's tasks.
pub(crate) struct PersonRng(pub(crate) ChaCha8Rng);

/// A sample's label.
pub(crate) struct SampleLabel(pub(crate) SampleId);
