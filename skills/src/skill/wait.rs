//! `wait`: stands still for the time in parameter `seconds`.

use super::context::{StandardSkill, TaskContext};
use super::goal_leaf::GoalLeaf;
use crate::actions::Goal;
use crate::bt::{PortSpec, PortType, Registry, RegistryError};

pub(super) const SKILL: StandardSkill =
    StandardSkill { task_type: "wait", xml: include_str!("../../trees/wait.xml"), register_leaves: leaves };

fn leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let ports = [PortSpec::input("seconds", PortType::Seconds)];
    GoalLeaf::register(registry, "Wait", ports, |_: &TaskContext, leaf| Ok(Goal::Wait { time: leaf.read("seconds")? }))
}
