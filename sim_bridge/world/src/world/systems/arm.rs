//! Arms: they take objects out of drawers and off tables, within their reach and payload, and put
//! them down.

use crate::component_types;
use crate::world::actions::{Deposit, Grasp, PickUp};
use crate::world::components::{CoPresence, DepartureCount, DrawerOpen, PersonInfo, SampleLabel, SimRobot};
use crate::world::location::RobotLocation;
use crate::world::preconditions::action_error;
use crate::world::samples::{Custody, HandoverCount, HolderEntity, PayloadData};
use crate::world::sim_state::SimState;
use crate::world::system::System;
use crate::world::system_access::ComponentType;
use consort_protocol::ids::RobotId;
use consort_skills::actions::{ActionError, ActionParameters as _, ErrorCode, Goal, GoalResult};
use hecs::Entity;

/// Transfers of objects to new holders, in order.
type Transfers = Vec<(Entity, HolderEntity)>;

/// See the [module](self).
pub(crate) struct Arm;

impl System for Arm {
    fn name(&self) -> &'static str {
        "arm"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![CoPresence, SimRobot, DepartureCount, DrawerOpen, SampleLabel, RobotLocation, PersonInfo]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![Custody, HandoverCount, PayloadData]
    }

    fn goal_kinds(&self) -> &'static [&'static str] {
        &[PickUp::ACTION, Grasp::ACTION, Deposit::ACTION]
    }

    fn begin_goal(&self, state: &mut SimState, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let duration_s = if goal.is::<PickUp>() || goal.is::<Grasp>() {
            state.durations.pick_up_s
        } else if goal.is::<Deposit>() {
            state.durations.deposit_s
        } else {
            return None;
        };
        Some(state.transfers(robot, goal).map(|_| state.now + duration_s))
    }

    fn finish_goal(&self, state: &mut SimState, robot: Entity, goal: &Goal) -> Result<GoalResult, ActionError> {
        for (object, to) in state.transfers(robot, goal)? {
            state.place_sample(object, to);
        }
        Ok(GoalResult::default())
    }
}

impl SimState {
    /// Returns the transfers that the goal would cause if it ended now.
    fn transfers(&self, robot: Entity, goal: &Goal) -> Result<Transfers, ActionError> {
        if let Some(pick_up) = goal.read::<PickUp>() {
            return self.pick_up(robot, &pick_up?.from);
        }
        if let Some(grasp) = goal.read::<Grasp>() {
            return self.grasp(robot, &grasp?.object);
        }
        match goal.read::<Deposit>() {
            Some(deposit) => self.deposit(robot, deposit?.into.as_ref()),
            None => Ok(vec![]),
        }
    }

    fn pick_up(&self, robot: Entity, from: &RobotId) -> Result<Transfers, ActionError> {
        let from = self.require_other_robot(robot, from)?;
        let held = self.in_arm(robot)?;
        if let Some(held) = held.filter(|_| self.get::<SimRobot>(robot).0.mobile) {
            let message = format!("{} already holds {}", self.robot_id(robot), self.label(held));
            return Err(action_error(ErrorCode::Busy, message));
        }
        self.check_drawer_accessible(robot, from)?;
        let to = HolderEntity::Arm(robot);
        if let Some(sample) = self.held(HolderEntity::Drawer(from)).first() {
            self.check_payload(robot, *sample)?;
        }
        match (self.held(HolderEntity::Drawer(from)).first().copied(), held) {
            (Some(sample), None) => Ok(vec![(sample, to)]),
            (Some(sample), Some(held)) => {
                // A stationary arm puts its object on the table next to it, then takes the next.
                let table = HolderEntity::Table(self.require_place(robot)?);
                Ok(vec![(held, table), (sample, to)])
            }
            (None, _) => {
                Err(action_error(ErrorCode::ContainerState, format!("the drawer of {} is empty", self.robot_id(from))))
            }
        }
    }

    fn grasp(&self, robot: Entity, name: &str) -> Result<Transfers, ActionError> {
        let place = self.require_place(robot)?;
        if let Some(held) = self.in_arm(robot)? {
            let message = format!("{} already holds {}", self.robot_id(robot), self.label(held));
            return Err(action_error(ErrorCode::Busy, message));
        }
        let object = self.sample_of(HolderEntity::Table(place), Some(name))?;
        self.check_reach(robot, object)?;
        self.check_payload(robot, object)?;
        Ok(vec![(object, HolderEntity::Arm(robot))])
    }

    fn deposit(&self, robot: Entity, into: Option<&RobotId>) -> Result<Transfers, ActionError> {
        let Some(sample) = self.in_arm(robot)? else {
            return Err(action_error(ErrorCode::ContainerState, format!("{} holds nothing", self.robot_id(robot))));
        };
        let to = match into {
            None => HolderEntity::Table(self.require_place(robot)?),
            Some(into) => {
                let into = self.require_other_robot(robot, into)?;
                self.check_drawer_accessible(robot, into)?;
                self.check_drawer_space(into)?;
                HolderEntity::Drawer(into)
            }
        };
        Ok(vec![(sample, to)])
    }
}
