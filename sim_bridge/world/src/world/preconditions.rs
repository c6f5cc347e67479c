//! Preconditions that systems share: positions, co-presence, access to drawers.

use super::components::{CoPresence, DepartureCount, DrawerOpen, SampleLabel, SimRobot};
use super::location::MapPosition;
use super::samples::{HolderEntity, PayloadData};
use super::sim_state::SimState;
use crate::map::PlaceIndex;
use crate::suggest::did_you_mean;
use consort_protocol::ids::RobotId;
use consort_skills::actions::{ActionError, ErrorCode};
use hecs::Entity;

/// Builds the error of a goal. Goals of the simulator move items at their end, or not at all.
pub(crate) fn action_error(code: ErrorCode, message: String) -> ActionError {
    ActionError::rejected(code, message)
}

impl SimState {
    pub(crate) fn check_drawer_accessible(&self, robot: Entity, other: Entity) -> Result<(), ActionError> {
        self.check_same_place(robot, other)?;
        let (name, other_name) = (self.robot_id(robot), self.robot_id(other));
        if !self.is_next_to(robot, other) && !self.is_next_to(other, robot) {
            let message = format!("neither of {name} and {other_name} has approached the other");
            return Err(action_error(ErrorCode::OutOfReach, message));
        }
        if !self.get::<SimRobot>(other).0.has_drawer {
            return Err(action_error(ErrorCode::ContainerState, format!("{other_name} has no drawer")));
        }
        if !self.get::<DrawerOpen>(other).0 {
            return Err(action_error(ErrorCode::ContainerState, format!("the drawer of {other_name} is closed")));
        }
        Ok(())
    }

    pub(crate) fn check_drawer_space(&self, robot: Entity) -> Result<(), ActionError> {
        let held = self.held(HolderEntity::Drawer(robot));
        if held.len() < self.limits.drawer_slots {
            return Ok(());
        }
        let labels: Vec<String> = held.into_iter().map(|sample| self.label(sample)).collect();
        let message = format!("the drawer of {} is full: it holds {}", self.robot_id(robot), labels.join(", "));
        Err(action_error(ErrorCode::ContainerState, message))
    }

    /// Returns the object in a robot's arm, if any.
    pub(crate) fn in_arm(&self, robot: Entity) -> Result<Option<Entity>, ActionError> {
        if !self.get::<SimRobot>(robot).0.has_arm {
            return Err(action_error(ErrorCode::OutOfReach, format!("{} has no arm", self.robot_id(robot))));
        }
        Ok(self.held(HolderEntity::Arm(robot)).first().copied())
    }

    pub(crate) fn check_reach(&self, robot: Entity, object: Entity) -> Result<(), ActionError> {
        let (distance_m, reach_m) = (self.get::<PayloadData>(object).distance_m, self.get::<SimRobot>(robot).0.reach_m);
        if distance_m <= reach_m {
            return Ok(());
        }
        let (name, robot) = (self.label(object), self.robot_id(robot));
        let message = format!("{name} is {distance_m} m away, {robot} reaches {reach_m} m");
        Err(action_error(ErrorCode::OutOfReach, message))
    }

    pub(crate) fn check_payload(&self, robot: Entity, object: Entity) -> Result<(), ActionError> {
        let (weight_kg, payload_max_kg) =
            (self.get::<PayloadData>(object).weight_kg, self.get::<SimRobot>(robot).0.payload_max_kg);
        if weight_kg <= payload_max_kg {
            return Ok(());
        }
        let message =
            format!("{} weighs {weight_kg} kg, {} lifts {payload_max_kg} kg", self.label(object), self.robot_id(robot));
        Err(action_error(ErrorCode::TooHeavy, message))
    }

    pub(crate) fn is_next_to(&self, robot: Entity, other: Entity) -> bool {
        let departures = self.get::<DepartureCount>(other).0;
        *self.get::<CoPresence>(robot) == CoPresence::Robot { robot: other, departures }
    }

    pub(crate) fn check_same_place(&self, robot: Entity, other: Entity) -> Result<(), ActionError> {
        let place = self.require_place(robot)?;
        let position = self.map_position(other);
        if position == MapPosition::Place(place) {
            return Ok(());
        }
        let (name, other_name) = (self.robot_id(robot), self.robot_id(other));
        let message =
            format!("{name} is at {}, {other_name} {}", self.map.place_at(place).id, position.describe(&self.map));
        Err(action_error(ErrorCode::OutOfReach, message))
    }

    pub(crate) fn require_place(&self, robot: Entity) -> Result<PlaceIndex, ActionError> {
        match self.map_position(robot) {
            MapPosition::Place(place) => Ok(place),
            position @ (MapPosition::Lane { .. } | MapPosition::Floor { .. } | MapPosition::Lift { .. }) => {
                let message = format!("{} is {}, not at a place", self.robot_id(robot), position.describe(&self.map));
                Err(action_error(ErrorCode::OutOfReach, message))
            }
        }
    }

    pub(crate) fn require_other_robot(&self, robot: Entity, other: &RobotId) -> Result<Entity, ActionError> {
        match self.robots.get(other) {
            Some(found) if *found == robot => {
                Err(action_error(ErrorCode::Unknown, format!("{other} cannot do this with itself")))
            }
            Some(found) => Ok(*found),
            None => Err(self.unknown_robot_error(other)),
        }
    }

    pub(crate) fn unknown_robot_error(&self, id: &RobotId) -> ActionError {
        let hint = did_you_mean(id.as_str(), self.robots.keys().map(RobotId::as_str));
        action_error(ErrorCode::Unknown, format!("there is no robot {id} here{hint}"))
    }

    pub(crate) fn robot_id(&self, robot: Entity) -> RobotId {
        self.get::<SimRobot>(robot).0.id.clone()
    }

    pub(crate) fn label(&self, sample: Entity) -> String {
        self.get::<SampleLabel>(sample).0.to_string()
    }
}
