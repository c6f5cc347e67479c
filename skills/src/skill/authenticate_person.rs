//! `authenticate_person`: the approached person in parameter `person_role` proves who they are. Not tried twice: a no is
//! a no.

use super::{GoalLeaf, Shipped, TaskContext};
use crate::actions::Goal;
use crate::bt::{PortSpec, PortType, Registry, RegistryError};

pub(super) const SKILL: Shipped =
    Shipped { task_type: "authenticate_person", xml: include_str!("../../trees/authenticate_person.xml"), leaves };

fn leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let ports = [PortSpec::input("role", PortType::Role)];
    GoalLeaf::register(registry, "AuthenticatePerson", ports, |_: &TaskContext, leaf| {
        Ok(Goal::AuthenticatePerson { role: leaf.read("role")? })
    })
}
