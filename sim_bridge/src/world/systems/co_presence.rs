//! Coming within reach of people and robots, and having people prove who they are.

use crate::world::components::{CoPresence, DepartureCount, PersonInfo, SimRobot};
use crate::world::event_log::WorldEvent;
use crate::world::location::RobotLocation;
use crate::world::preconditions::action_error;
use crate::world::setup::RobotSetup;
use crate::world::sim_state::SimState;
use crate::world::system::{ComponentType, System, kinds};
use crate::world::systems::spontaneous_actions::PersonStates;
use consort_protocol::ids::{RobotId, RoleId};
use consort_skills::actions::{ActionError, ErrorCode, Goal};
use hecs::Entity;

/// See the [module](self).
pub(crate) struct CoPresenceSystem;

impl System for CoPresenceSystem {
    fn name(&self) -> &'static str {
        "company"
    }

    fn reads(&self) -> Vec<ComponentType> {
        kinds![SimRobot, DepartureCount, PersonStates, RobotLocation, PersonInfo]
    }

    fn writes(&self) -> Vec<ComponentType> {
        kinds![CoPresence]
    }

    fn init_robot(&self, floor: &mut SimState, robot: Entity, _body: &RobotSetup) {
        floor.insert(robot, CoPresence::None);
    }

    fn begin_goal(&self, floor: &mut SimState, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let takes = match goal {
            Goal::ApproachPerson { .. } => floor.durations.approach_person_s,
            Goal::AuthenticatePerson { .. } => floor.durations.authenticate_person_s,
            Goal::ApproachRobot { .. } => floor.durations.approach_robot_s,
            _ => return None,
        };
        Some(floor.company(robot, goal).map(|_| floor.now + takes))
    }

    fn finish_goal(&self, floor: &mut SimState, robot: Entity, goal: &Goal) -> Result<(), ActionError> {
        let beside = floor.company(robot, goal)?;
        *floor.get_mut::<CoPresence>(robot) = beside;
        if let CoPresence::Person { person, authenticated } = beside {
            let person = floor.get::<PersonInfo>(person).name.clone();
            floor.log_event(WorldEvent::Approached { robot: floor.robot_id(robot), person, authenticated });
        }
        Ok(())
    }
}

impl SimState {
    /// Whom the robot would be beside if the goal ended now.
    fn company(&self, robot: Entity, goal: &Goal) -> Result<CoPresence, ActionError> {
        match goal {
            Goal::ApproachPerson { role } => self.approach_person(robot, role),
            Goal::AuthenticatePerson { role } => self.authenticate_person(robot, role),
            Goal::ApproachRobot { robot: other } => self.approach_robot(robot, other),
            _ => Ok(*self.get::<CoPresence>(robot)),
        }
    }

    fn approach_person(&self, robot: Entity, role: &RoleId) -> Result<CoPresence, ActionError> {
        let place = self.require_place(robot)?;
        let is_here = |person: &&Entity| {
            let who = self.get::<PersonInfo>(**person);
            who.role == *role && who.place == place && self.is_present(&who.name)
        };
        match self.people.values().find(is_here) {
            Some(person) => Ok(CoPresence::Person { person: *person, authenticated: false }),
            None => {
                let message = format!("{}: no {role} is at {}", self.robot_id(robot), self.map.place_at(place).id);
                Err(action_error(ErrorCode::OutOfReach, message))
            }
        }
    }

    fn authenticate_person(&self, robot: Entity, role: &RoleId) -> Result<CoPresence, ActionError> {
        let CoPresence::Person { person, .. } = *self.get::<CoPresence>(robot) else {
            let message = format!("{} has not approached a {role}", self.robot_id(robot));
            return Err(action_error(ErrorCode::OutOfReach, message));
        };
        let who = self.get::<PersonInfo>(person);
        if who.role != *role {
            let message = format!("{}: {} is a {}, not a {role}", self.robot_id(robot), who.name, who.role);
            return Err(action_error(ErrorCode::NotAuthenticated, message));
        }
        if !self.is_present(&who.name) {
            return Err(action_error(
                ErrorCode::OutOfReach,
                format!("{}: {} has walked away", self.robot_id(robot), who.name),
            ));
        }
        Ok(CoPresence::Person { person, authenticated: true })
    }

    fn approach_robot(&self, robot: Entity, other: &RobotId) -> Result<CoPresence, ActionError> {
        let other = self.require_other_robot(robot, other)?;
        self.check_same_place(robot, other)?;
        Ok(CoPresence::Robot { robot: other, departures: self.get::<DepartureCount>(other).0 })
    }
}
