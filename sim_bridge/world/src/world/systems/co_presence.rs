//! Co-presence: approaching people and robots, and authenticating people.

use crate::component_types;
use crate::world::actions::{ApproachPerson, ApproachRobot, AuthenticatePerson};
use crate::world::components::{CoPresence, DepartureCount, HandsBusy, PersonInfo, SimRobot};
use crate::world::event::WorldEvent;
use crate::world::location::RobotLocation;
use crate::world::preconditions::action_error;
use crate::world::setup::RobotSetup;
use crate::world::sim_state::SimState;
use crate::world::system::System;
use crate::world::system_access::ComponentType;
use crate::world::systems::spontaneous_actions::PersonStates;
use consort_protocol::ids::{RobotId, RoleId};
use consort_skills::actions::{ActionError, ActionParameters as _, ErrorCode, Goal, GoalResult};
use hecs::Entity;

/// See the [module](self).
pub(crate) struct CoPresenceSystem;

impl System for CoPresenceSystem {
    fn name(&self) -> &'static str {
        "co_presence"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![SimRobot, DepartureCount, PersonStates, RobotLocation, HandsBusy]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![CoPresence, PersonInfo]
    }

    fn init_robot(&self, state: &mut SimState, robot: Entity, _body: &RobotSetup) {
        state.insert(robot, CoPresence::None);
    }

    fn goal_kinds(&self) -> &'static [&'static str] {
        &[ApproachPerson::ACTION, AuthenticatePerson::ACTION, ApproachRobot::ACTION]
    }

    fn begin_goal(&self, state: &mut SimState, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let duration_s = if goal.is::<ApproachPerson>() {
            state.durations.approach_person_s
        } else if goal.is::<AuthenticatePerson>() {
            state.durations.authenticate_person_s
        } else if goal.is::<ApproachRobot>() {
            state.durations.approach_robot_s
        } else {
            return None;
        };
        Some(state.co_presence_after(robot, goal).map(|_| state.now + duration_s))
    }

    fn finish_goal(&self, state: &mut SimState, robot: Entity, goal: &Goal) -> Result<GoalResult, ActionError> {
        let co_presence = state.co_presence_after(robot, goal)?;
        *state.get_mut::<CoPresence>(robot) = co_presence;
        if let CoPresence::Person { person, authenticated } = co_presence {
            state.get_mut::<PersonInfo>(person).place = state.require_place(robot)?;
            let person = state.get::<PersonInfo>(person).name.clone();
            state.log_event(WorldEvent::Approached { robot: state.robot_id(robot), person, authenticated });
        }
        Ok(GoalResult::default())
    }
}

impl SimState {
    /// Returns the co-presence that the goal would cause if it ended now.
    fn co_presence_after(&self, robot: Entity, goal: &Goal) -> Result<CoPresence, ActionError> {
        if let Some(approach) = goal.read::<ApproachPerson>() {
            return self.approach_person(robot, &approach?.role);
        }
        if let Some(authenticate) = goal.read::<AuthenticatePerson>() {
            return self.authenticate_person(robot, &authenticate?.role);
        }
        match goal.read::<ApproachRobot>() {
            Some(approach) => self.approach_robot(robot, &approach?.robot),
            None => Ok(*self.get::<CoPresence>(robot)),
        }
    }

    fn approach_person(&self, robot: Entity, role: &RoleId) -> Result<CoPresence, ActionError> {
        let place = self.require_place(robot)?;
        let is_here = |person: &&Entity| {
            let info = self.get::<PersonInfo>(**person);
            info.role == *role && info.place == place && self.is_present(&info.name)
        };
        let comes = |person: &&Entity| self.comes_when_called(**person, role);
        match self.people.values().find(is_here).or_else(|| self.people.values().find(comes)) {
            Some(person) => Ok(CoPresence::Person { person: *person, authenticated: false }),
            None => {
                let message = format!("{}: no {role} is at {}", self.robot_id(robot), self.map.place_at(place).id);
                Err(action_error(ErrorCode::OutOfReach, message))
            }
        }
    }

    /// Checks whether a person has the role and is on call, and neither a robot nor a handover needs the person.
    fn comes_when_called(&self, person: Entity, role: &RoleId) -> bool {
        let info = self.get::<PersonInfo>(person);
        let is_with = |robot: &Entity| match *self.get::<CoPresence>(*robot) {
            CoPresence::Person { person: other, .. } => other == person,
            CoPresence::None | CoPresence::Robot { .. } => false,
        };
        info.role == *role
            && info.on_call
            && self.is_present(&info.name)
            && !self.get::<HandsBusy>(person).0
            && !self.robots.values().any(is_with)
    }

    fn authenticate_person(&self, robot: Entity, role: &RoleId) -> Result<CoPresence, ActionError> {
        let CoPresence::Person { person, .. } = *self.get::<CoPresence>(robot) else {
            let message = format!("{} has not approached a {role}", self.robot_id(robot));
            return Err(action_error(ErrorCode::OutOfReach, message));
        };
        let info = self.get::<PersonInfo>(person);
        if info.role != *role {
            let message = format!("{}: {} is a {}, not a {role}", self.robot_id(robot), info.name, info.role);
            return Err(action_error(ErrorCode::NotAuthenticated, message));
        }
        if !self.is_present(&info.name) {
            return Err(action_error(
                ErrorCode::OutOfReach,
                format!("{}: {} has walked away", self.robot_id(robot), info.name),
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
