//! The mission tree as a value.

use crate::ids::{ItemId, RoleId, TaskId, TaskType};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

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
    /// What becomes of the mission when a holder of it is lost whose work others have already acted on.
    #[serde(default)]
    pub on_loss: OnLoss,
}

/// What becomes of a mission when a robot is lost after others have acted on its work, while it has no item in its hands.
/// (With one, the mission is recovered or rescued, whatever this says. Before, the role is begun anew elsewhere.)
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum OnLoss {
    /// It fails: what the others built upon may no longer be there.
    #[default]
    Fail,
    /// Another robot begins the role from its first step, and does again what had been done; the others go on from where
    /// they are. For roles whose work does no harm when it is done twice.
    Restart,
}

impl Role {
    /// A role of this kind, whose loss fails the mission once others have acted on its work.
    pub fn of(kind: RoleKind) -> Self {
        Role { kind, on_loss: OnLoss::Fail }
    }
}

/// Whether the fleet fills a role.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
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
    pub body: TaskBody,
}

/// What a task comes down to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum TaskBody {
    /// Refined by a method.
    Abstract(Method),
    /// Done as it is.
    Elementary(TaskSpec),
}

/// How an abstract task is refined.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Method {
    /// Whether its tasks depend on one another.
    pub order: TaskOrder,
    /// Its tasks; never empty.
    pub children: Vec<TaskIndex>,
    /// What its role may do instead when a task of it has failed for good, in the order in which it is tried.
    #[serde(default)]
    pub alternatives: Vec<AlternativeMethod>,
}

/// Another way to do what a method does. *Local*: every elementary task below the method, and every task of its
/// alternatives, belongs to one and the same managed role and to it alone, and none of them touches an item. So a role
/// may go over to it without asking or telling anybody.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlternativeMethod {
    /// Its tasks, one after the other; never empty.
    pub tasks: Vec<(TaskId, TaskSpec)>,
}

/// How the tasks of a method depend on one another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum TaskOrder {
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
    /// Who has which item once the task has ended.
    #[serde(default)]
    pub acquires: BTreeMap<ItemId, RoleId>,
    /// Items that nobody of the mission has any more once the task has ended: laid down where they belong.
    #[serde(default)]
    pub releases: BTreeSet<ItemId>,
    /// How often the skill is tried before the task has failed: 1 to [`ATTEMPTS_MAX`]. Raised: passing troubles cost time
    /// and not the role; lasting ones are noticed later. Default [`ATTEMPTS`] (a guess).
    #[serde(default = "attempts")]
    pub attempts: u8,
}

/// How often a skill is tried unless the mission says otherwise.
pub const ATTEMPTS: u8 = 2;
/// How often a skill may be tried.
pub const ATTEMPTS_MAX: u8 = 10;

fn attempts() -> u8 {
    ATTEMPTS
}

impl Method {
    /// A method without alternatives.
    pub fn of(order: TaskOrder, children: Vec<TaskIndex>) -> Self {
        Method { order, children, alternatives: vec![] }
    }
}

impl TaskSpec {
    /// A task of these roles that is told nothing and touches nothing.
    pub fn of(task_type: TaskType, roles: Vec<RoleId>) -> Self {
        TaskSpec {
            task_type,
            roles,
            parameters: BTreeMap::new(),
            reaches: BTreeMap::new(),
            acquires: BTreeMap::new(),
            releases: BTreeSet::new(),
            attempts: ATTEMPTS,
        }
    }

    /// The items that it moves.
    pub fn items(&self) -> impl Iterator<Item = &ItemId> {
        self.acquires.keys().chain(&self.releases)
    }

    /// Whether several roles do it together.
    pub fn is_joint(&self) -> bool {
        self.roles.len() > 1
    }
}

impl Mission {
    /// The elementary tasks, depth first and in the order of the file; those of alternatives are not among them. Ends on
    /// an unchecked mission, too: whatever its children say, each task is visited once at most.
    pub fn elementary(&self) -> Vec<(&TaskId, &TaskSpec)> {
        self.elementary_below(0)
    }

    /// The same of the part of the tree whose root is this task.
    pub fn elementary_below(&self, root: usize) -> Vec<(&TaskId, &TaskSpec)> {
        let mut found = Vec::new();
        let mut seen = vec![false; self.tasks.len()];
        let mut open: Vec<TaskIndex> = TaskIndex::try_from(root).into_iter().collect();
        while let Some(index) = open.pop() {
            let Some(node) = self.tasks.get(index as usize) else { continue };
            if std::mem::replace(&mut seen[index as usize], true) {
                continue;
            }
            match &node.body {
                TaskBody::Abstract(method) => open.extend(method.children.iter().rev()),
                TaskBody::Elementary(spec) => found.push((&node.id, spec)),
            }
        }
        found
    }

    /// The names of all tasks, those of alternatives included.
    pub fn task_names(&self) -> impl Iterator<Item = &TaskId> {
        self.tasks.iter().flat_map(|node| {
            let others: &[AlternativeMethod] = match &node.body {
                TaskBody::Abstract(method) => &method.alternatives,
                TaskBody::Elementary(_) => &[],
            };
            let others = others.iter().flat_map(|other| other.tasks.iter().map(|(id, _)| id));
            std::iter::once(&node.id).chain(others)
        })
    }

    /// The roles that robots fill, in the order of their names.
    pub fn managed_roles(&self) -> impl Iterator<Item = &RoleId> {
        self.roles.iter().filter(|(_, role)| role.kind == RoleKind::Managed).map(|(id, _)| id)
    }
}
