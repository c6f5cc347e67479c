//! `approach_person`: within reach of the person in parameter `person_role`, who must be at the robot's place. Tried
//! three times, a second apart: people step aside.

use super::{GoalLeaf, Shipped, TaskContext};
use crate::actions::Goal;
use crate::bt::{PortSpec, PortType, Registry, RegistryError};

pub(super) const SKILL: Shipped =
    Shipped { task_type: "approach_person", xml: include_str!("../../trees/approach_person.xml"), leaves };

fn leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let ports = [PortSpec::input("role", PortType::Role)];
    GoalLeaf::register(registry, "ApproachPerson", ports, |_: &TaskContext, leaf| {
        Ok(Goal::ApproachPerson { role: leaf.read("role")? })
    })
}
