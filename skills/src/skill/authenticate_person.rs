//! `authenticate_person`: authenticates the approached person in parameter `person_role`. There is
//! no second attempt after a rejection. If the person has stepped away, the skill waits for the
//! seconds in parameter `timeout_s`, or for two minutes.

use super::context::{StandardSkill, TaskContext};
use super::person_goal_leaf::PersonGoalLeaf;
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
