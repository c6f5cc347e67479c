//! `dock` and `undock`: connects to the charger at the robot's place, which must be the charger in
//! parameter `charger` if it is given, and disconnects from it.

use super::context::{StandardSkill, TaskContext};
use super::goal_leaf::GoalLeaf;
use crate::actions::Goal;
use crate::bt::{PortSpec, PortType, Registry, RegistryError};

pub(super) const DOCK: StandardSkill =
    StandardSkill { task_type: "dock", xml: include_str!("../../trees/dock.xml"), register_leaves: dock_leaves };

pub(super) const UNDOCK: StandardSkill =
    StandardSkill { task_type: "undock", xml: include_str!("../../trees/undock.xml"), register_leaves: undock_leaves };

fn dock_leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let ports = [PortSpec::input("charger", PortType::Place).optional()];
    GoalLeaf::register(registry, "Dock", ports, |_: &TaskContext, leaf| {
        Ok(Goal::Dock { charger: leaf.read_optional("charger")? })
    })
}

fn undock_leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    GoalLeaf::register(registry, "Undock", [], |_: &TaskContext, _| Ok(Goal::Undock))
}
