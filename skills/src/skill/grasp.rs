//! `grasp`: takes the object in parameter `object` from the table of the robot's place.

use super::context::{StandardSkill, TaskContext};
use super::goal_leaf::GoalLeaf;
use crate::actions::Goal;
use crate::bt::{PortSpec, PortType, Registry, RegistryError};

pub(super) const SKILL: StandardSkill =
    StandardSkill { task_type: "grasp", xml: include_str!("../../trees/grasp.xml"), register_leaves: leaves };

fn leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let ports = [PortSpec::input("object", PortType::Text)];
    GoalLeaf::register(registry, "Grasp", ports, |_: &TaskContext, leaf| {
        Ok(Goal::Grasp { object: leaf.read("object")? })
    })
}
