//! `pick_up`: takes an object from the open drawer of the robot that holds the role in parameter
//! `from_role`.

use super::context::{StandardSkill, TaskContext};
use super::goal_leaf::GoalLeaf;
use crate::actions::Goal;
use crate::bt::{PortSpec, PortType, Registry, RegistryError};

pub(super) const SKILL: StandardSkill =
    StandardSkill { task_type: "pick_up", xml: include_str!("../../trees/pick_up.xml"), register_leaves: leaves };

fn leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let ports = [PortSpec::input("from", PortType::Robot)];
    GoalLeaf::register(registry, "PickUp", ports, |_: &TaskContext, leaf| Ok(Goal::PickUp { from: leaf.read("from")? }))
}
