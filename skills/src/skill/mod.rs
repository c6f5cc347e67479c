//! The standard skills: their trees are in `trees/`, their leaves here, a skill per file.
//!
//! Each leaf that sends a goal to the robot is a [`GoalLeaf`]: it differs from the others only in
//! the goal it makes. A leaf that requires a person to be present is a `PersonGoalLeaf`, which
//! waits for an absent person. Only the leaf of `navigation` handles its goals itself, since it
//! plans another route if a leg is blocked.

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

/// Data available to the leaves of a skill when it starts.
#[derive(Debug, Clone)]
pub struct TaskContext {
    /// The task.
    pub task: TaskSpec,
    /// The role holders.
    pub skill: SkillContext,
    /// The environment.
    pub environment: Environment,
}

/// A standard skill.
pub(crate) struct StandardSkill {
    pub(crate) task_type: &'static str,
    pub(crate) xml: &'static str,
    /// Registers the leaves of the skill; other skills may use them too.
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

/// Registers the leaves that several skills share.
pub(crate) fn register_shared_leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    roles::register_leaves(registry)
}
