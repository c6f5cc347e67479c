//! What entities are made of, where no system has a file of its own for it.

use super::names::{PersonName, SampleId};
use super::setup::RobotSetup;
use crate::map::PlaceIndex;
use consort_protocol::ids::RoleId;
use hecs::Entity;
use rand_chacha::ChaCha8Rng;

/// A robot: what it was set up with. Its discharge rate here is the only one there is.
pub(crate) struct SimRobot(pub(crate) RobotSetup);

/// Who a robot is beside, and has come within reach of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CoPresence {
    None,
    Person {
        person: Entity,
        authenticated: bool,
    },
    Robot {
        robot: Entity,
        /// How often that robot had departed by then: once it leaves, the two are no longer beside one another.
        departures: u64,
    },
}

/// How often a robot has left where it stood.
pub(crate) struct DepartureCount(pub(crate) u64);

/// Whether a robot's drawer stands open. What is in it is known by the samples.
pub(crate) struct DrawerOpen(pub(crate) bool);

/// A person: who they are and where they stay.
pub(crate) struct PersonInfo {
    pub(crate) name: PersonName,
    pub(crate) role: RoleId,
    pub(crate) place: PlaceIndex,
}

/// A person's hands are at work for an ask.
pub(crate) struct HandsBusy(pub(crate) bool);

/// A person's own source of chance.
pub(crate) struct HandoverRng(pub(crate) ChaCha8Rng);

/// A sample's label.
pub(crate) struct SampleLabel(pub(crate) SampleId);
