//! `deposit`: what is held, into the open drawer of the robot that holds the role in parameter `into_role` or, without
//! one, onto the place's table.

use super::{GoalLeaf, Shipped, TaskContext, roles};
use crate::actions::Goal;
use crate::bt::{PortSpec, PortType, Registry, RegistryError};

pub(super) const SKILL: Shipped =
    Shipped { task_type: "deposit", xml: include_str!("../../trees/deposit.xml"), leaves };

fn leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let ports = [PortSpec::input("into_role", PortType::Role).optional()];
    GoalLeaf::register(registry, "Deposit", ports, |context: &TaskContext, leaf| {
        let into = leaf.read_optional("into_role")?.map(|role| roles::holder(context, &role)).transpose()?;
        Ok(Goal::Deposit { into })
    })
}
