//! Bodies and people, for displays and checks.

use super::components::{CoPresence, DrawerOpen, PersonInfo, SimRobot};
use super::names::{PersonName, SampleId};
use super::samples::HolderEntity;
use super::{RobotSetup, World};
use consort_protocol::ids::{PlaceId, RobotId, RoleId};
use serde::{Deserialize, Serialize};

/// What a robot's telemetry does not say of it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotReport {
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
    pub fn robot_setup(&self, robot: &RobotId) -> Option<RobotSetup> {
        self.state.robots.get(robot).map(|robot| self.state.get::<SimRobot>(*robot).0.clone())
    }

    /// A robot's drawer, arm and company; `None` for one that is not here.
    pub fn robot_report(&self, robot: &RobotId) -> Option<RobotReport> {
        let robot = *self.state.robots.get(robot)?;
        let (beside_person, authenticated, beside_robot) = match *self.state.get::<CoPresence>(robot) {
            CoPresence::None => (None, false, None),
            CoPresence::Person { person, .. } if !self.state.is_present(&self.state.get::<PersonInfo>(person).name) => {
                (None, false, None)
            }
            CoPresence::Person { person, authenticated } => {
                (Some(self.state.get::<PersonInfo>(person).name.clone()), authenticated, None)
            }
            CoPresence::Robot { robot: other, .. } => (None, false, Some(self.state.robot_id(other))),
        };
        Some(RobotReport {
            drawer_open: self.state.get::<DrawerOpen>(robot).0,
            in_drawer: self.state.held_labels(HolderEntity::Drawer(robot)),
            in_arm: self.state.held_labels(HolderEntity::Arm(robot)).into_iter().next(),
            beside_person,
            authenticated,
            beside_robot,
        })
    }

    /// All people, in the order of their names.
    pub fn people(&self) -> Vec<PersonReport> {
        let report = |person: &hecs::Entity| {
            let who = self.state.get::<PersonInfo>(*person);
            PersonReport {
                name: who.name.clone(),
                role: who.role.clone(),
                place: self.state.map.place_at(who.place).id.clone(),
                away: !self.state.is_present(&who.name),
                samples: self.state.held_labels(HolderEntity::Hands(*person)),
            }
        };
        self.state.people.values().map(report).collect()
    }

    /// All automatic doors, in the order of their names.
    pub fn doors(&self) -> Vec<DoorReport> {
        let states = self.state.door_states().into_iter();
        states.map(|(name, state)| DoorReport { name, state: state.to_owned() }).collect()
    }
}
