//! `approach_robot`: approaches the robot that holds the role in parameter `robot_role`. Three
//! attempts, a second apart.

use super::context::{StandardSkill, TaskContext};
use super::goal_leaf::GoalLeaf;
use crate::actions::Goal;
use crate::bt::{PortSpec, PortType, Registry, RegistryError};

pub(super) const SKILL: StandardSkill = StandardSkill {
    task_type: "approach_robot",
    xml: include_str!("../../trees/approach_robot.xml"),
    register_leaves: leaves,
};

fn leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let ports = [PortSpec::input("robot", PortType::Robot)];
    GoalLeaf::register(registry, "ApproachRobot", ports, |_: &TaskContext, leaf| {
        Ok(Goal::ApproachRobot { robot: leaf.read("robot")? })
    })
}
