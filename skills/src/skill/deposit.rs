//! `deposit`: puts the held object into the open drawer of the robot that holds the role in
//! parameter `into_role` or, without the parameter, on the table of the place.

use super::context::{StandardSkill, TaskContext};
use super::goal_leaf::GoalLeaf;
use super::roles;
use crate::actions::Goal;
use crate::bt::{PortSpec, PortType, Registry, RegistryError};

pub(super) const SKILL: StandardSkill =
    StandardSkill { task_type: "deposit", xml: include_str!("../../trees/deposit.xml"), register_leaves: leaves };

fn leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let ports = [PortSpec::input("into_role", PortType::Role).optional()];
    GoalLeaf::register(registry, "Deposit", ports, |context: &TaskContext, leaf| {
        let into = leaf.read_optional("into_role")?.map(|role| roles::role_holder(context, &role)).transpose()?;
        Ok(Goal::Deposit { into })
    })
}
