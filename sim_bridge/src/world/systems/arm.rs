//! Arms that take things out of drawers and off tables, as far as they reach and as much as they lift, and put them down.

use crate::world::components::{CoPresence, DepartureCount, DrawerOpen, PersonInfo, SampleLabel, SimRobot};
use crate::world::location::RobotLocation;
use crate::world::preconditions::action_error;
use crate::world::samples::{Custody, HandoverCount, HolderEntity, PayloadData};
use crate::world::sim_state::SimState;
use crate::world::system::{ComponentType, System, kinds};
use consort_protocol::ids::RobotId;
use consort_skills::actions::{ActionError, ErrorCode, Goal};
use hecs::Entity;

/// What changes hands: each thing, and to whom, in this order.
type Moves = Vec<(Entity, HolderEntity)>;

/// See the [module](self).
pub(crate) struct Arm;

impl System for Arm {
    fn name(&self) -> &'static str {
        "arm"
    }

    fn reads(&self) -> Vec<ComponentType> {
        kinds![CoPresence, SimRobot, DepartureCount, DrawerOpen, SampleLabel, RobotLocation, PersonInfo]
    }

    fn writes(&self) -> Vec<ComponentType> {
        kinds![Custody, HandoverCount, PayloadData]
    }

    fn begin_goal(&self, floor: &mut SimState, robot: Entity, goal: &Goal) -> Option<Result<f64, ActionError>> {
        let takes = match goal {
            Goal::PickUp { .. } | Goal::Grasp { .. } => floor.durations.pick_up_s,
            Goal::Deposit { .. } => floor.durations.deposit_s,
            _ => return None,
        };
        Some(floor.moves(robot, goal).map(|_| floor.now + takes))
    }

    fn finish_goal(&self, floor: &mut SimState, robot: Entity, goal: &Goal) -> Result<(), ActionError> {
        for (thing, to) in floor.moves(robot, goal)? {
            floor.get_mut::<PayloadData>(thing).distance_m = 0.0;
            floor.transfer_sample(thing, to);
        }
        Ok(())
    }
}

impl SimState {
    /// What would change hands if the goal ended now.
    fn moves(&self, robot: Entity, goal: &Goal) -> Result<Moves, ActionError> {
        match goal {
            Goal::PickUp { from } => self.pick_up(robot, from),
            Goal::Grasp { object } => self.grasp(robot, object),
            Goal::Deposit { into } => self.deposit(robot, into.as_ref()),
            _ => Ok(vec![]),
        }
    }

    fn pick_up(&self, robot: Entity, from: &RobotId) -> Result<Moves, ActionError> {
        let from = self.require_other_robot(robot, from)?;
        let held = self.in_arm(robot)?;
        if let Some(held) = held.filter(|_| self.get::<SimRobot>(robot).0.mobile) {
            let message = format!("{} already holds {}", self.robot_id(robot), self.label(held));
            return Err(action_error(ErrorCode::Busy, message));
        }
        self.check_drawer_accessible(robot, from)?;
        let to = HolderEntity::Arm(robot);
        if let Some(sample) = self.held(HolderEntity::Drawer(from)).first() {
            self.within_strength(robot, *sample)?;
        }
        match (self.held(HolderEntity::Drawer(from)).first().copied(), held) {
            (Some(sample), None) => Ok(vec![(sample, to)]),
            (Some(sample), Some(held)) => {
                // A fixed arm lays what it holds on the table beside it, then takes the next.
                let table = HolderEntity::Table(self.require_place(robot)?);
                Ok(vec![(held, table), (sample, to)])
            }
            (None, _) => {
                Err(action_error(ErrorCode::DrawerState, format!("the drawer of {} is empty", self.robot_id(from))))
            }
        }
    }

    fn grasp(&self, robot: Entity, object: &str) -> Result<Moves, ActionError> {
        let place = self.require_place(robot)?;
        if let Some(held) = self.in_arm(robot)? {
            let message = format!("{} already holds {}", self.robot_id(robot), self.label(held));
            return Err(action_error(ErrorCode::Busy, message));
        }
        let there = self.held(HolderEntity::Table(place));
        let Some(thing) = there.iter().copied().find(|thing| self.label(*thing) == object) else {
            let labels: Vec<String> = there.iter().map(|thing| self.label(*thing)).collect();
            let lies = if labels.is_empty() { "nothing".to_owned() } else { labels.join(", ") };
            let message = format!("no {object:?} lies at {}; there lies: {lies}", self.map.place_at(place).id);
            return Err(action_error(ErrorCode::OutOfReach, message));
        };
        let (distance_m, reach_m) = (self.get::<PayloadData>(thing).distance_m, self.get::<SimRobot>(robot).0.reach_m);
        if distance_m > reach_m {
            let message = format!("{object} is {distance_m} m away, {} reaches {reach_m} m", self.robot_id(robot));
            return Err(action_error(ErrorCode::OutOfReach, message));
        }
        self.within_strength(robot, thing)?;
        Ok(vec![(thing, HolderEntity::Arm(robot))])
    }

    fn within_strength(&self, robot: Entity, thing: Entity) -> Result<(), ActionError> {
        let (weight_kg, most) =
            (self.get::<PayloadData>(thing).weight_kg, self.get::<SimRobot>(robot).0.payload_max_kg);
        if weight_kg <= most {
            return Ok(());
        }
        let message = format!("{} weighs {weight_kg} kg, {} lifts {most} kg", self.label(thing), self.robot_id(robot));
        Err(action_error(ErrorCode::TooHeavy, message))
    }

    fn deposit(&self, robot: Entity, into: Option<&RobotId>) -> Result<Moves, ActionError> {
        let Some(sample) = self.in_arm(robot)? else {
            return Err(action_error(ErrorCode::DrawerState, format!("{} holds nothing", self.robot_id(robot))));
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

    /// What a robot's arm holds, if anything; an error for a robot without an arm.
    fn in_arm(&self, robot: Entity) -> Result<Option<Entity>, ActionError> {
        if !self.get::<SimRobot>(robot).0.has_arm {
            return Err(action_error(ErrorCode::OutOfReach, format!("{} has no arm", self.robot_id(robot))));
        }
        Ok(self.held(HolderEntity::Arm(robot)).first().copied())
    }
}
