//! What entities are made of, where no system has a file of its own for it.

use super::names::{PersonName, SampleId};
use super::setup::RobotBody;
use crate::map::PlaceIndex;
use consort_protocol::ids::RoleId;
use hecs::Entity;
use rand_chacha::ChaCha8Rng;

/// A robot: what it was set up with. Its discharge rate here is the only one there is.
pub(super) struct Body(pub(super) RobotBody);

/// Who a robot is beside, and has come within reach of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Beside {
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
pub(super) struct Departures(pub(super) u64);

/// Whether a robot's drawer stands open. What is in it is known by the samples.
pub(super) struct DrawerOpen(pub(super) bool);

/// A person: who they are and where they stay.
pub(super) struct Who {
    pub(super) name: PersonName,
    pub(super) role: RoleId,
    pub(super) place: PlaceIndex,
}

/// A person's hands are at work for an ask.
pub(super) struct HandsBusy(pub(super) bool);

/// A person's own source of chance.
pub(super) struct Pace(pub(super) ChaCha8Rng);

/// A sample's label.
pub(super) struct Label(pub(super) SampleId);
