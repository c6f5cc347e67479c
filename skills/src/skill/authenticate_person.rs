//! `authenticate_person`: the approached person in parameter `person_role` proves who they are. Not tried twice: a no is
//! a no. One who has stepped away meanwhile is waited for: for the seconds in parameter `patience`, or two minutes.

use super::{PatientLeaf, Shipped, TaskContext};
use crate::actions::Goal;
use crate::bt::{Registry, RegistryError};

pub(super) const SKILL: Shipped =
    Shipped { task_type: "authenticate_person", xml: include_str!("../../trees/authenticate_person.xml"), leaves };

fn leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    PatientLeaf::register(registry, "AuthenticatePerson", |role| Goal::AuthenticatePerson { role })
}
