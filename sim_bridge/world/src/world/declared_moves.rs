//! Moves of items by goals of actions that declare them.

use super::components::{CoPresence, DrawerOpen, SimRobot};
use super::preconditions::action_error;
use super::samples::HolderEntity;
use super::sim_state::SimState;
use consort_protocol::ids::RobotId;
use consort_skills::actions::{ActionError, ErrorCode, Goal};
use consort_skills::domain_file::{ActionForm, ItemHolder, SimulatedMove};
use hecs::Entity;
use serde_json::Value;

impl SimState {
    /// Returns the item that the goal would move if it ended now, and its new holder; `None` if the action moves none.
    ///
    /// # Errors
    /// The declared failure, or the reason why the item cannot be moved.
    pub(crate) fn declared_move(
        &self,
        robot: Entity,
        goal: &Goal,
        action: &ActionForm,
    ) -> Result<Option<(Entity, HolderEntity)>, ActionError> {
        let Some(moves) = &action.simulate.moves else { return Ok(None) };
        self.possible_move(robot, goal, moves).map(Some).map_err(|error| {
            let declared = moves.otherwise.as_ref().and_then(|reason| action.failure(reason, &error.message));
            declared.unwrap_or(error)
        })
    }

    fn possible_move(
        &self,
        robot: Entity,
        goal: &Goal,
        moves: &SimulatedMove,
    ) -> Result<(Entity, HolderEntity), ActionError> {
        let text = |name: Option<&String>| goal.parameters.get(name?).and_then(Value::as_str);
        let holder = |holder: ItemHolder| match holder {
            ItemHolder::Table => Ok(HolderEntity::Table(self.require_place(robot)?)),
            ItemHolder::Drawer if self.get::<SimRobot>(robot).0.has_drawer => Ok(HolderEntity::Drawer(robot)),
            ItemHolder::Drawer => {
                Err(action_error(ErrorCode::ContainerState, format!("{} has no drawer", self.robot_id(robot))))
            }
            ItemHolder::Arm => self.in_arm(robot).map(|_| HolderEntity::Arm(robot)),
            ItemHolder::OtherDrawer => self.other_drawer(robot, text(moves.robot.as_ref())),
        };
        let (from, to) = (holder(moves.from)?, holder(moves.to)?);
        let item = self.sample_of(from, text(moves.item.as_ref()))?;
        match to {
            HolderEntity::Drawer(of) => self.check_drawer_space(of)?,
            HolderEntity::Arm(_) => {
                if let Some(held) = self.in_arm(robot)? {
                    let message = format!("{} already holds {}", self.robot_id(robot), self.label(held));
                    return Err(action_error(ErrorCode::Busy, message));
                }
                self.check_reach(robot, item)?;
                self.check_payload(robot, item)?;
            }
            HolderEntity::Table(_) | HolderEntity::Hands(_) => {}
        }
        Ok((item, to))
    }

    /// Returns the drawer of another robot, if the robot has access to it.
    fn other_drawer(&self, robot: Entity, other: Option<&str>) -> Result<HolderEntity, ActionError> {
        let unknown = |message: String| action_error(ErrorCode::Unknown, message);
        let other = other.unwrap_or_default();
        let id = RobotId::new(other).map_err(|problem| unknown(format!("{other:?} is no robot: {problem}")))?;
        let other = self.require_other_robot(robot, &id)?;
        if self.find::<CoPresence>(robot).is_none() || self.find::<DrawerOpen>(other).is_none() {
            return Err(unknown("this world lacks the systems co_presence and drawer".to_owned()));
        }
        self.check_drawer_accessible(robot, other)?;
        Ok(HolderEntity::Drawer(other))
    }
}
