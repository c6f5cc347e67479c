//! Words and conditions that systems share: who is where, who is beside whom, whose drawer can be reached into.

use super::components::{Beside, Body, Departures, DrawerOpen, Label};
use super::floor::Floor;
use super::samples::Holder;
use super::whereabouts::Spot;
use crate::map::PlaceIndex;
use crate::suggest::did_you_mean;
use consort_protocol::ids::RobotId;
use consort_skills::actions::{ActionError, ErrorCode, Goal};
use hecs::Entity;

/// An error for a robot that asked for what cannot be.
pub(crate) fn refused(code: ErrorCode, message: String) -> ActionError {
    ActionError { code, message }
}

/// A goal's name for people.
pub(crate) fn verb(goal: &Goal) -> &'static str {
    match goal {
        Goal::NavigateToPose { .. } => "navigate_to_pose",
        Goal::ApproachPerson { .. } => "approach_person",
        Goal::AuthenticatePerson { .. } => "authenticate_person",
        Goal::OperateDrawer { .. } => "operate_drawer",
        Goal::ApproachRobot { .. } => "approach_robot",
        Goal::PickUp { .. } => "pick_up",
        Goal::Grasp { .. } => "grasp",
        Goal::Deposit { .. } => "deposit",
        Goal::Wait { .. } => "wait",
        Goal::FollowWaypoints { .. } => "follow_waypoints",
        Goal::Spin { .. } => "spin",
        Goal::Dock { .. } => "dock",
        Goal::Undock => "undock",
    }
}

impl Floor {
    pub(crate) fn open_drawer_in_reach(&self, robot: Entity, other: Entity) -> Result<(), ActionError> {
        self.same_place(robot, other)?;
        let (name, others) = (self.name(robot), self.name(other));
        if !self.is_beside(robot, other) && !self.is_beside(other, robot) {
            let message = format!("neither of {name} and {others} has approached the other");
            return Err(refused(ErrorCode::OutOfReach, message));
        }
        if !self.get::<Body>(other).0.has_drawer {
            return Err(refused(ErrorCode::DrawerState, format!("{others} has no drawer")));
        }
        if !self.get::<DrawerOpen>(other).0 {
            return Err(refused(ErrorCode::DrawerState, format!("the drawer of {others} is closed")));
        }
        Ok(())
    }

    pub(crate) fn room_in_drawer(&self, robot: Entity) -> Result<(), ActionError> {
        let held = self.held(Holder::Drawer(robot));
        if held.len() < self.limits.drawer_slots {
            return Ok(());
        }
        let labels: Vec<String> = held.into_iter().map(|sample| self.label(sample)).collect();
        let message = format!("the drawer of {} is full: it holds {}", self.name(robot), labels.join(", "));
        Err(refused(ErrorCode::DrawerState, message))
    }

    pub(crate) fn is_beside(&self, robot: Entity, other: Entity) -> bool {
        let departures = self.get::<Departures>(other).0;
        *self.get::<Beside>(robot) == Beside::Robot { robot: other, departures }
    }

    pub(crate) fn same_place(&self, robot: Entity, other: Entity) -> Result<(), ActionError> {
        let place = self.standing_place(robot)?;
        let spot = self.spot(other);
        if spot == Spot::Place(place) {
            return Ok(());
        }
        let (name, others) = (self.name(robot), self.name(other));
        let message = format!("{name} is at {}, {others} {}", self.map.at(place).id, spot.describe(&self.map));
        Err(refused(ErrorCode::OutOfReach, message))
    }

    pub(crate) fn standing_place(&self, robot: Entity) -> Result<PlaceIndex, ActionError> {
        match self.spot(robot) {
            Spot::Place(place) => Ok(place),
            spot @ (Spot::Lane { .. } | Spot::Floor { .. } | Spot::Lift { .. }) => {
                let message = format!("{} is {}, at no place", self.name(robot), spot.describe(&self.map));
                Err(refused(ErrorCode::OutOfReach, message))
            }
        }
    }

    pub(crate) fn other_robot(&self, robot: Entity, other: &RobotId) -> Result<Entity, ActionError> {
        match self.robots.get(other) {
            Some(found) if *found == robot => {
                Err(refused(ErrorCode::Unknown, format!("{other} cannot do this with itself")))
            }
            Some(found) => Ok(*found),
            None => Err(self.no_robot(other)),
        }
    }

    pub(crate) fn no_robot(&self, id: &RobotId) -> ActionError {
        let hint = did_you_mean(id.as_str(), self.robots.keys().map(RobotId::as_str));
        refused(ErrorCode::Unknown, format!("there is no robot {id} here{hint}"))
    }

    pub(crate) fn name(&self, robot: Entity) -> RobotId {
        self.get::<Body>(robot).0.id.clone()
    }

    pub(crate) fn label(&self, sample: Entity) -> String {
        self.get::<Label>(sample).0.to_string()
    }
}
