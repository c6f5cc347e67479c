//! `operate_drawer`: opens or closes the robot's own drawer, by parameter `action`.

use super::context::{StandardSkill, TaskContext};
use super::goal_leaf::GoalLeaf;
use crate::actions::Goal;
use crate::bt::{PortSpec, PortType, Registry, RegistryError};

pub(super) const SKILL: StandardSkill = StandardSkill {
    task_type: "operate_drawer",
    xml: include_str!("../../trees/operate_drawer.xml"),
    register_leaves: leaves,
};

fn leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let ports = [PortSpec::input("action", PortType::Text).one_of(&["open", "close"])];
    GoalLeaf::register(registry, "OperateDrawer", ports, |_: &TaskContext, leaf| {
        Ok(Goal::OperateDrawer { open: leaf.read::<String>("action")? == "open" })
    })
}
