//! What entities are made of, where no system has a file of its own for it.

use super::names::{PersonName, SampleId};
use super::setup::RobotBody;
use crate::map::PlaceIndex;
use consort_protocol::ids::RoleId;
use hecs::Entity;
use rand_chacha::ChaCha8Rng;

/// A robot: what it was set up with. Its discharge rate here is the only one there is.
pub(crate) struct Body(pub(crate) RobotBody);

/// Who a robot is beside, and has come within reach of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Beside {
    Nobody,
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
pub(crate) struct Departures(pub(crate) u64);

/// Whether a robot's drawer stands open. What is in it is known by the samples.
pub(crate) struct DrawerOpen(pub(crate) bool);

/// A person: who they are and where they stay.
pub(crate) struct Who {
    pub(crate) name: PersonName,
    pub(crate) role: RoleId,
    pub(crate) place: PlaceIndex,
}

/// A person's hands are at work for an ask.
pub(crate) struct HandsBusy(pub(crate) bool);

/// A person's own source of chance.
pub(crate) struct Pace(pub(crate) ChaCha8Rng);

/// A sample's label.
pub(crate) struct Label(pub(crate) SampleId);
