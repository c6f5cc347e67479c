//! The skills that come with the library: trees in `trees/`, and here the leaves that they are made of, a skill a file.
//!
//! Each leaf that asks the body for something is a [`GoalLeaf`]: it differs from the others only in how its goal is
//! made. Those that take a person to be there have the patience of a `PatientLeaf` beside it. Drives alone (`navigation`)
//! see to their goals themselves, since they look for another way where one is blocked.

mod approach_person;
mod approach_robot;
mod authenticate_person;
mod deposit;
mod dock;
mod follow_path;
mod goal_leaf;
mod grasp;
mod navigation;
mod operate_drawer;
mod person_goal_leaf;
mod pick_up;
mod roles;
mod wait;

pub(crate) use follow_path::parse_points as waypoints;
pub use goal_leaf::GoalLeaf;
use person_goal_leaf::PersonGoalLeaf;

use crate::bt::{Registry, RegistryError};
use crate::environment::Environment;
use crate::library::SkillContext;
use consort_protocol::mission::TaskSpec;

/// What the leaves of a skill may look at when it is started.
#[derive(Debug, Clone)]
pub struct TaskContext {
    /// The task.
    pub task: TaskSpec,
    /// Who takes part.
    pub skill: SkillContext,
    /// The place.
    pub environment: Environment,
}

/// A skill that comes with the library.
pub(crate) struct StandardSkill {
    pub(crate) task_type: &'static str,
    pub(crate) xml: &'static str,
    /// Adds the leaves that it brings; others may use them too.
    pub(crate) register_leaves: fn(&mut Registry<TaskContext>) -> Result<(), RegistryError>,
}

pub(crate) const STANDARD_SKILLS: [StandardSkill; 12] = [
    wait::SKILL,
    navigation::SKILL,
    approach_person::SKILL,
    authenticate_person::SKILL,
    operate_drawer::SKILL,
    approach_robot::SKILL,
    pick_up::SKILL,
    deposit::SKILL,
    follow_path::SKILL,
    grasp::SKILL,
    dock::DOCK,
    dock::UNDOCK,
];

/// Leaves that several skills share.
pub(crate) fn register_shared_leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    roles::register_leaves(registry)
}
