//! The standard skills: their trees are in `trees/`, their leaves here, a skill per file.
//!
//! Each leaf that sends a goal to the robot is a [`GoalLeaf`]: it differs from the others only in
//! the goal it makes. A leaf that requires a person to be present is a `PersonGoalLeaf`, which
//! waits for an absent person. Only the leaf of `navigation` handles its goals itself, since it
//! plans another route if a leg is blocked.

mod approach_person;
mod approach_robot;
mod authenticate_person;
mod context;
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

pub(crate) use context::StandardSkill;
pub use context::{SkillContext, TaskContext};
pub use goal_leaf::GoalLeaf;

use crate::bt::{Registry, RegistryError};

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
