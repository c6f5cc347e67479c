//! `authenticate_person`: the approached person in parameter `person_role` proves who they are. Not tried twice: a no is
//! a no. One who has stepped away meanwhile is waited for: for the seconds in parameter `patience`, or two minutes.

use super::{PersonGoalLeaf, StandardSkill, TaskContext};
use crate::actions::Goal;
use crate::bt::{Registry, RegistryError};

pub(super) const SKILL: StandardSkill = StandardSkill {
    task_type: "authenticate_person",
    xml: include_str!("../../trees/authenticate_person.xml"),
    register_leaves: leaves,
};

fn leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    PersonGoalLeaf::register(registry, "AuthenticatePerson", |role| Goal::AuthenticatePerson { role })
}
