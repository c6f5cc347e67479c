//! Classes of causes of failures.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Class of the cause of a failure. It decides about further attempts at a task; of a failed mission it says whether the
/// same mission can succeed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum CauseClass {
    /// This robot failed; another robot may succeed. The robot tries as often as the task allows.
    #[default]
    Robot,
    /// No robot can do the task: the mission fails at once.
    Task,
    /// The same attempt may succeed later. The robot tries again after growing pauses, and then the role
    /// goes to any robot.
    Transient,
    /// The robot lacks what the task needs; another robot may have it. The robot does not try again.
    Precondition,
}

impl CauseClass {
    /// Checks whether the robot is not asked again for the role.
    pub fn excludes_robot(self) -> bool {
        matches!(self, CauseClass::Robot | CauseClass::Precondition)
    }
}

impl fmt::Display for CauseClass {
    /// The name, as in JSON.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            CauseClass::Robot => "robot",
            CauseClass::Task => "task",
            CauseClass::Transient => "transient",
            CauseClass::Precondition => "precondition",
        })
    }
}
