//! Data of a skill: the task, the holders of the roles, and the environment.

use crate::environment::Environment;
use consort_protocol::ids::{RobotId, RoleId};
use consort_protocol::mission::TaskSpec;
use std::collections::BTreeMap;

/// Mission data for a skill.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SkillContext {
    /// Holders of the managed roles, this robot included.
    pub holders: BTreeMap<RoleId, RobotId>,
}

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
