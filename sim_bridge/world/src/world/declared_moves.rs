//! Items that goals of actions move, create or consume, as the actions declare.

use super::components::{CoPresence, DrawerOpen, SimRobot};
use super::names::SampleId;
use super::preconditions::action_error;
use super::samples::HolderEntity;
use super::sim_state::SimState;
use consort_protocol::ids::RobotId;
use consort_skills::actions::{ActionError, ErrorCode, Goal};
use consort_skills::domain_file::{ActionForm, ItemHolder, SimulatedMove};
use hecs::Entity;
use serde_json::Value;

/// What a goal does with an item when it succeeds.
pub(crate) enum ItemChange {
    /// The item gets a new holder.
    Move(Entity, HolderEntity),
    /// A new item appears.
    Create(SampleId, HolderEntity),
    /// The item disappears.
    Consume(Entity),
}

impl SimState {
    /// Returns what the goal would do with an item if it ended now; `None` if the action moves none.
    ///
    /// # Errors
    /// The declared failure, or the reason why the item cannot be moved.
    pub(crate) fn declared_move(
        &self,
        robot: Entity,
        goal: &Goal,
        action: &ActionForm,
    ) -> Result<Option<ItemChange>, ActionError> {
        let Some(moves) = &action.simulate.moves else { return Ok(None) };
        self.possible_move(robot, goal, moves).map(Some).map_err(|error| {
            let declared = moves.otherwise.as_ref().and_then(|reason| action.failure(reason, &error.message));
            declared.unwrap_or(error)
        })
    }

    /// Applies a change to an item.
    pub(crate) fn change_item(&mut self, change: ItemChange) {
        match change {
            ItemChange::Move(item, to) => self.place_sample(item, to),
            ItemChange::Create(name, holder) => self.create_sample(name, holder),
            ItemChange::Consume(item) => self.consume_sample(item),
        }
    }

    fn possible_move(&self, robot: Entity, goal: &Goal, moves: &SimulatedMove) -> Result<ItemChange, ActionError> {
        let text = |name: Option<&String>| goal.parameters.get(name?).and_then(Value::as_str);
        let holder = |holder: ItemHolder| -> Result<Option<HolderEntity>, ActionError> {
            let holder = match holder {
                ItemHolder::Table => HolderEntity::Table(self.require_place(robot)?),
                ItemHolder::Container if self.get::<SimRobot>(robot).0.has_drawer => HolderEntity::Drawer(robot),
                ItemHolder::Container => {
                    let message = format!("{} has no drawer", self.robot_id(robot));
                    return Err(action_error(ErrorCode::ContainerState, message));
                }
                ItemHolder::Arm => self.in_arm(robot).map(|_| HolderEntity::Arm(robot))?,
                ItemHolder::OtherContainer => self.other_drawer(robot, text(moves.robot.as_ref()))?,
                ItemHolder::Nothing => return Ok(None),
            };
            Ok(Some(holder))
        };
        let (from, to) = (holder(moves.from)?, holder(moves.to)?);
        let name = text(moves.item.as_ref());
        let item = from.map(|from| self.sample_of(from, name)).transpose()?;
        if let Some(to) = to {
            self.check_space(robot, to, item)?;
        }
        match (item, to) {
            (Some(item), Some(to)) => Ok(ItemChange::Move(item, to)),
            (Some(item), None) => Ok(ItemChange::Consume(item)),
            (None, Some(to)) => Ok(ItemChange::Create(self.new_item(goal, name)?, to)),
            // The check of domain files rejects such an action, and a setup may contain others.
            (None, None) => {
                let message = format!("the action {} moves an item from nothing to nothing", goal.action.as_str());
                Err(action_error(ErrorCode::Failed, message))
            }
        }
    }

    /// Checks whether a holder can take an item. A new item is within reach and can be lifted.
    fn check_space(&self, robot: Entity, to: HolderEntity, item: Option<Entity>) -> Result<(), ActionError> {
        match to {
            HolderEntity::Drawer(of) => self.check_drawer_space(of),
            HolderEntity::Arm(_) => {
                if let Some(held) = self.in_arm(robot)? {
                    let message = format!("{} already holds {}", self.robot_id(robot), self.label(held));
                    return Err(action_error(ErrorCode::Busy, message));
                }
                let Some(item) = item else { return Ok(()) };
                self.check_reach(robot, item)?;
                self.check_payload(robot, item)
            }
            HolderEntity::Table(_) | HolderEntity::Hands(_) => Ok(()),
        }
    }

    /// Returns the name of a new item: the given name, or else a free name.
    fn new_item(&self, goal: &Goal, name: Option<&str>) -> Result<SampleId, ActionError> {
        let (items, max) = (self.samples.len(), self.limits.entities_max);
        if items >= max {
            return Err(action_error(
                ErrorCode::Busy,
                format!("the world has {items} items; at most {max} are allowed"),
            ));
        }
        let Some(name) = name else { return Ok(self.free_sample_id(goal.action.as_str(), 1)) };
        let id = SampleId::from(name);
        let unknown = |problem: &str| Err(action_error(ErrorCode::Unknown, format!("the name {name:?} {problem}")));
        if !id.is_valid() {
            return unknown("is invalid; allowed are 1 to 64 characters, without control characters");
        }
        if self.samples.contains_key(&id) {
            return unknown("is that of another item; allowed is any other name");
        }
        Ok(id)
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
