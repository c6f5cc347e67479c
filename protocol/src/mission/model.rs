//! The mission tree as a value.

use crate::ids::{RoleId, TaskId, TaskType};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Position of a task in [`Mission::tasks`].
pub type TaskIndex = u32;

/// A mission: roles, and a tree of tasks whose root is the first of `tasks`; every child stands after its parent.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mission {
    /// The name of the kind of mission (`lab-samples`), not of this instance.
    pub name: TaskId,
    /// Who takes part.
    pub roles: BTreeMap<RoleId, Role>,
    /// The tree, parents before children, siblings in the order of the file.
    pub tasks: Vec<TaskNode>,
}

/// A part in a mission.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Role {
    /// Whether a robot is sought for it.
    pub kind: RoleKind,
}

/// Whether the fleet fills a role.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RoleKind {
    /// Filled by a robot, through an auction.
    Managed,
    /// Filled by a person, or by anyone else who takes no orders from the fleet.
    Unmanaged,
}

/// A node of the tree.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskNode {
    /// Its name, unique within the mission.
    pub id: TaskId,
    /// What it comes down to.
    pub body: Body,
}

/// What a task comes down to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Body {
    /// Refined by a method.
    Abstract(Method),
    /// Done as it is.
    Elementary(TaskSpec),
}

/// How an abstract task is refined.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Method {
    /// Whether its tasks depend on one another.
    pub order: Order,
    /// Its tasks; never empty.
    pub children: Vec<TaskIndex>,
}

/// How the tasks of a method depend on one another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Order {
    /// Each begins after the one before it has ended.
    Sequential,
    /// No dependency: side by side where the roles differ, one after the other in any order where they do not.
    Unordered,
}

/// An elementary task: what is to be achieved, not how.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaskSpec {
    /// Its kind, which names the skill that realises it.
    #[serde(rename = "type")]
    pub task_type: TaskType,
    /// Who does it: one role, or several jointly. Never empty, without repetition, in the order of the file.
    pub roles: Vec<RoleId>,
    /// What the skill needs to know, by name (`to = IC Room 6`, `action = open`).
    #[serde(default)]
    pub parameters: BTreeMap<String, String>,
    /// The state that its success guarantees (`location = IC Room 6`).
    #[serde(default)]
    pub reaches: BTreeMap<String, String>,
}

impl TaskSpec {
    /// Whether several roles do it together.
    pub fn is_joint(&self) -> bool {
        self.roles.len() > 1
    }
}

impl Mission {
    /// The elementary tasks, depth first and in the order of the file. Ends on an unchecked mission, too: whatever its
    /// children say, each task is visited once at most.
    pub fn elementary(&self) -> Vec<(&TaskId, &TaskSpec)> {
        let mut found = Vec::new();
        let mut seen = vec![false; self.tasks.len()];
        let mut open: Vec<TaskIndex> = vec![0];
        while let Some(index) = open.pop() {
            let Some(node) = self.tasks.get(index as usize) else { continue };
            if std::mem::replace(&mut seen[index as usize], true) {
                continue;
            }
            match &node.body {
                Body::Abstract(method) => open.extend(method.children.iter().rev()),
                Body::Elementary(spec) => found.push((&node.id, spec)),
            }
        }
        found
    }

    /// The roles that robots fill, in the order of their names.
    pub fn managed_roles(&self) -> impl Iterator<Item = &RoleId> {
        self.roles.iter().filter(|(_, role)| role.kind == RoleKind::Managed).map(|(id, _)| id)
    }
}
