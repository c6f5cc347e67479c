//! `approach_person`: approaches the person in parameter `person_role`, who must be at the robot's
//! place. If the person is absent, the skill waits for the seconds in parameter `timeout_s`,
//! or for two minutes.

use super::context::{StandardSkill, TaskContext};
use super::person_goal_leaf::PersonGoalLeaf;
use crate::actions::Goal;
use crate::bt::{Registry, RegistryError};

pub(super) const SKILL: StandardSkill = StandardSkill {
    task_type: "approach_person",
    xml: include_str!("../../trees/approach_person.xml"),
    register_leaves: leaves,
};

fn leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    PersonGoalLeaf::register(registry, "ApproachPerson", |role| Goal::ApproachPerson { role })
}
