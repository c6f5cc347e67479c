//! Bodies and people, for displays and checks.

use super::components::{Beside, Body, DrawerOpen, Who};
use super::names::{PersonName, SampleId};
use super::samples::Holder;
use super::{RobotBody, World};
use consort_protocol::ids::{PlaceId, RobotId, RoleId};
use serde::{Deserialize, Serialize};

/// What a robot's telemetry does not say of it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BodyReport {
    /// Whether its drawer stands open.
    pub drawer_open: bool,
    /// What lies in its drawer, first come first.
    pub in_drawer: Vec<SampleId>,
    /// What its arm holds.
    pub in_arm: Option<SampleId>,
    /// The person it has approached.
    pub beside_person: Option<PersonName>,
    /// Whether that person has proved who they are.
    pub authenticated: bool,
    /// The robot it has approached.
    pub beside_robot: Option<RobotId>,
}

/// A person as they are now.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PersonReport {
    /// Who.
    pub name: PersonName,
    /// The role they play.
    pub role: RoleId,
    /// Where they stay.
    pub place: PlaceId,
    /// Whether they have left it.
    pub away: bool,
    /// What they have to hand over, first come first.
    pub samples: Vec<SampleId>,
}

/// An automatic door as it is now.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DoorReport {
    /// Its name on the map.
    pub name: String,
    /// How its leaf is: `closed`, `opening`, `open` or `closing`.
    pub state: String,
}

impl World {
    /// What a robot was set up with, its discharge rate among it; `None` for one that is not here.
    pub fn setup_of(&self, robot: &RobotId) -> Option<RobotBody> {
        self.floor.robots.get(robot).map(|robot| self.floor.get::<Body>(*robot).0.clone())
    }

    /// A robot's drawer, arm and company; `None` for one that is not here.
    pub fn body(&self, robot: &RobotId) -> Option<BodyReport> {
        let robot = *self.floor.robots.get(robot)?;
        let (beside_person, authenticated, beside_robot) = match *self.floor.get::<Beside>(robot) {
            Beside::Nobody => (None, false, None),
            Beside::Person { person, .. } if !self.floor.is_present(&self.floor.get::<Who>(person).name) => {
                (None, false, None)
            }
            Beside::Person { person, authenticated } => {
                (Some(self.floor.get::<Who>(person).name.clone()), authenticated, None)
            }
            Beside::Robot { robot: other, .. } => (None, false, Some(self.floor.name(other))),
        };
        Some(BodyReport {
            drawer_open: self.floor.get::<DrawerOpen>(robot).0,
            in_drawer: self.floor.held_labels(Holder::Drawer(robot)),
            in_arm: self.floor.held_labels(Holder::Arm(robot)).into_iter().next(),
            beside_person,
            authenticated,
            beside_robot,
        })
    }

    /// All people, in the order of their names.
    pub fn people(&self) -> Vec<PersonReport> {
        let report = |person: &hecs::Entity| {
            let who = self.floor.get::<Who>(*person);
            PersonReport {
                name: who.name.clone(),
                role: who.role.clone(),
                place: self.floor.map.at(who.place).id.clone(),
                away: !self.floor.is_present(&who.name),
                samples: self.floor.held_labels(Holder::Hands(*person)),
            }
        };
        self.floor.people.values().map(report).collect()
    }

    /// All automatic doors, in the order of their names.
    pub fn doors(&self) -> Vec<DoorReport> {
        let states = self.floor.door_states().into_iter();
        states.map(|(name, state)| DoorReport { name, state: state.to_owned() }).collect()
    }
}
