//! `approach_person`: within reach of the person in parameter `person_role`, who must be at the robot's place. One who is not
//! there is waited for: for the seconds in parameter `patience`, or two minutes.

use super::{PatientLeaf, Shipped, TaskContext};
use crate::actions::Goal;
use crate::bt::{Registry, RegistryError};

pub(super) const SKILL: Shipped =
    Shipped { task_type: "approach_person", xml: include_str!("../../trees/approach_person.xml"), leaves };

fn leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    PatientLeaf::register(registry, "ApproachPerson", |role| Goal::ApproachPerson { role })
}
