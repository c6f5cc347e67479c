//! `wait`: stand still for the time in parameter `seconds`.

use super::{GoalLeaf, Shipped, TaskContext};
use crate::actions::Goal;
use crate::bt::{PortSpec, PortType, Registry, RegistryError};

pub(super) const SKILL: Shipped = Shipped { task_type: "wait", xml: include_str!("../../trees/wait.xml"), leaves };

fn leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let ports = [PortSpec::input("seconds", PortType::Seconds)];
    GoalLeaf::register(registry, "Wait", ports, |_: &TaskContext, leaf| Ok(Goal::Wait { time: leaf.read("seconds")? }))
}
