//! Coming within reach of people and robots, and having people prove who they are.

use crate::world::components::{Beside, Body, Departures, Who};
use crate::world::floor::Floor;
use crate::world::journal::Happening;
use crate::world::reach::refused;
use crate::world::setup::RobotBody;
use crate::world::system::{Kind, System, kinds};
use crate::world::systems::moods::Minds;
use crate::world::whereabouts::Whereabouts;
use consort_protocol::ids::{RobotId, RoleId};
use consort_skills::actions::{ActionError, ErrorCode, Goal};
use hecs::Entity;

/// See the [module](self).
pub(crate) struct Company;

impl System for Company {
    fn name(&self) -> &'static str {
        "company"
    }

    fn reads(&self) -> Vec<Kind> {
        kinds![Body, Departures, Minds, Whereabouts, Who]
    }

    fn writes(&self) -> Vec<Kind> {
        kinds![Beside]
    }

    fn equip(&self, floor: &mut Floor, robot: Entity, _body: &RobotBody) {
        floor.give(robot, Beside::Nobody);
    }

    fn begin(&self, floor: &mut Floor, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let takes = match goal {
            Goal::ApproachPerson { .. } => floor.durations.approach_person_s,
            Goal::AuthenticatePerson { .. } => floor.durations.authenticate_person_s,
            Goal::ApproachRobot { .. } => floor.durations.approach_robot_s,
            _ => return None,
        };
        Some(floor.company(robot, goal).map(|_| floor.now + takes))
    }

    fn finish(&self, floor: &mut Floor, robot: Entity, goal: &Goal) -> Result<(), ActionError> {
        let beside = floor.company(robot, goal)?;
        *floor.get_mut::<Beside>(robot) = beside;
        if let Beside::Person { person, authenticated } = beside {
            let person = floor.get::<Who>(person).name.clone();
            floor.note(Happening::Approached { robot: floor.name(robot), person, authenticated });
        }
        Ok(())
    }
}

impl Floor {
    /// Whom the robot would be beside if the goal ended now.
    fn company(&self, robot: Entity, goal: &Goal) -> Result<Beside, ActionError> {
        match goal {
            Goal::ApproachPerson { role } => self.approach_person(robot, role),
            Goal::AuthenticatePerson { role } => self.authenticate_person(robot, role),
            Goal::ApproachRobot { robot: other } => self.approach_robot(robot, other),
            _ => Ok(*self.get::<Beside>(robot)),
        }
    }

    fn approach_person(&self, robot: Entity, role: &RoleId) -> Result<Beside, ActionError> {
        let place = self.standing_place(robot)?;
        let is_here = |person: &&Entity| {
            let who = self.get::<Who>(**person);
            who.role == *role && who.place == place && self.is_present(&who.name)
        };
        match self.people.values().find(is_here) {
            Some(person) => Ok(Beside::Person { person: *person, authenticated: false }),
            None => {
                let message = format!("{}: no {role} is at {}", self.name(robot), self.map.at(place).id);
                Err(refused(ErrorCode::OutOfReach, message))
            }
        }
    }

    fn authenticate_person(&self, robot: Entity, role: &RoleId) -> Result<Beside, ActionError> {
        let Beside::Person { person, .. } = *self.get::<Beside>(robot) else {
            let message = format!("{} has not approached a {role}", self.name(robot));
            return Err(refused(ErrorCode::OutOfReach, message));
        };
        let who = self.get::<Who>(person);
        if who.role != *role {
            let message = format!("{}: {} is a {}, not a {role}", self.name(robot), who.name, who.role);
            return Err(refused(ErrorCode::NotAuthenticated, message));
        }
        if !self.is_present(&who.name) {
            return Err(refused(ErrorCode::OutOfReach, format!("{}: {} has walked away", self.name(robot), who.name)));
        }
        Ok(Beside::Person { person, authenticated: true })
    }

    fn approach_robot(&self, robot: Entity, other: &RobotId) -> Result<Beside, ActionError> {
        let other = self.other_robot(robot, other)?;
        self.same_place(robot, other)?;
        Ok(Beside::Robot { robot: other, departures: self.get::<Departures>(other).0 })
    }
}
