//! Mission tree as a value.

use super::condition;
use super::domain::{Domain, ValueKind};
use super::outcome::{TaskOutcome, TaskOutcomes};
use crate::domain_reference::{DomainReference, OtherDomain};
use crate::ids::{EnsembleId, ItemId, RoleId, TaskId, TaskType};
use crate::scalar::Scalar;
use crate::units::EnergyLimit;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Index of a task in [`Mission::tasks`].
pub type TaskIndex = u32;

/// Mission: roles, and a tree of tasks. The root is the first of `tasks`, and every child comes
/// after its parent.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mission {
    /// Name of the kind of mission (`vital-signs`), not of this instance.
    pub name: TaskId,
    /// Participating roles.
    pub roles: BTreeMap<RoleId, Role>,
    /// Ensembles whose members get its roles: those of the first if they can fill all roles, otherwise
    /// those of the first 2, and so on. Empty: members of any ensemble.
    #[serde(default)]
    pub ensembles: Vec<EnsembleId>,
    /// Bound on the estimated energy of all its robots together, over all awards; `None` for no bound.
    #[serde(default)]
    pub energy_max: Option<EnergyLimit>,
    /// Tasks of the tree: parents before children, siblings in the order of the file.
    pub tasks: Vec<TaskNode>,
    /// Results of the mission, by name: expressions over the results of its tasks.
    #[serde(default)]
    pub results: BTreeMap<String, String>,
}

/// Role in a mission.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Role {
    /// Managed roles are filled by robots.
    pub kind: RoleKind,
    /// Consequence if its holder is lost after other roles have acted on its work.
    #[serde(default)]
    pub on_loss: OnLoss,
    /// Condition on the robot that fills a managed role: see [`Eligibility`](crate::ensemble::Eligibility).
    #[serde(default)]
    pub eligible: Option<String>,
    /// Role of one iteration of a spread loop. It may stay open until a robot is free.
    #[serde(default)]
    pub spread: bool,
}

/// Consequence if a robot is lost after other roles have acted on its work, while it has no item.
/// (With an item, the mission is recovered or needs intervention, whatever this value is. If no
/// role has acted on its work yet, another robot restarts the role.)
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum OnLoss {
    /// The mission fails: the result that other roles used may no longer exist.
    #[default]
    Fail,
    /// Another robot starts the role from its first step and repeats the completed work; the other
    /// roles continue. For roles with work that may be repeated without harm.
    Restart,
}

impl Role {
    /// Creates a role of this kind with the default [`OnLoss::Fail`].
    pub fn of(kind: RoleKind) -> Self {
        Role { kind, on_loss: OnLoss::Fail, eligible: None, spread: false }
    }
}

/// Kind of role: filled by the fleet or not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum RoleKind {
    /// Filled by a robot, through an auction.
    Managed,
    /// Filled by a person, or by another participant that the fleet does not command.
    Unmanaged,
}

/// Node of the tree.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TaskNode {
    /// Name, unique within the mission.
    pub id: TaskId,
    /// Abstract or elementary content.
    pub body: TaskBody,
}

/// Content of a task.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum TaskBody {
    /// Refined by a method.
    Abstract(Method),
    /// Executed by a skill.
    Elementary(TaskSpec),
}

/// Refinement of an abstract task.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Method {
    /// Order of its tasks.
    pub order: TaskOrder,
    /// Indices of its tasks; never empty.
    pub children: Vec<TaskIndex>,
    /// Alternatives for when a task has failed permanently, in the order in which they are tried.
    #[serde(default)]
    pub alternatives: Vec<AlternativeMethod>,
}

/// Alternative to a method. It is *local*: a single managed role executes every elementary task
/// below the method and every task of its alternatives, and none of them touches an item. So a role
/// may switch to it without coordination with other roles.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct AlternativeMethod {
    /// Tasks, executed in sequence; never empty.
    pub tasks: Vec<(TaskId, TaskSpec)>,
}

/// Order of the tasks of a method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum TaskOrder {
    /// Each task begins after the preceding task has ended.
    Sequential,
    /// No dependency: in parallel if the roles differ, otherwise in sequence in any order.
    Unordered,
}

/// Specification of an elementary task: the goal, not the implementation.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TaskSpec {
    /// Type, which is the name of the skill that executes it.
    #[serde(rename = "type")]
    pub task_type: TaskType,
    /// Roles that execute it: a single role, or several jointly. Never empty, without repetition,
    /// in the order of the file.
    pub roles: Vec<RoleId>,
    /// Parameters of the skill, by name (`to = IC Room 6`, `action = open`).
    #[serde(default)]
    pub parameters: BTreeMap<String, String>,
    /// State that holds after success (`location = IC Room 6`).
    #[serde(default)]
    pub reaches: BTreeMap<String, String>,
    /// Items that roles have after the task.
    #[serde(default)]
    pub acquires: BTreeMap<ItemId, RoleId>,
    /// Items that are outside the mission after the task: placed at their destination.
    #[serde(default)]
    pub releases: BTreeSet<ItemId>,
    /// Maximum number of attempts before the task has failed permanently: 1 to 100.
    /// Raised: transient errors cost time and not the role; permanent errors are detected later.
    /// Default 2 (a guess).
    #[serde(default = "attempts")]
    pub attempts: u8,
    /// For a task of a person: seconds to wait for an answer before the mission fails. Default: no limit.
    #[serde(default)]
    pub patience_s: Option<u32>,
    /// For a task of a person: escalation of a request without an answer.
    #[serde(default)]
    pub escalation: Option<Box<Escalation>>,
    /// Parameters that are results of earlier tasks. Until these are known, `parameters` contains a
    /// typical value, for estimates.
    #[serde(default)]
    pub inputs: BTreeMap<String, ResultReference>,
    /// Conditions over the results of earlier tasks. The task is skipped unless all of them hold.
    #[serde(default)]
    pub conditions: Vec<String>,
    /// Domain file that declares the type, as known to the coordinator that took the mission. A robot
    /// with another content of that file cannot do the task.
    #[serde(default)]
    pub domain: Option<DomainReference>,
}

/// Escalation of a request to a person.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Escalation {
    /// Role of the other people; it need not be a role of the mission.
    pub to: RoleId,
    /// Seconds after the request, from 1 to 604800.
    #[schemars(range(min = 1, max = PATIENCE_MAX_S))]
    pub after_s: u32,
}

/// Result of a task of the same mission.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
pub struct ResultReference {
    /// The task.
    pub task: TaskId,
    /// Name of the result.
    pub result: String,
}

/// Default number of attempts.
pub(crate) const ATTEMPTS: u8 = 2;
/// Maximum number of attempts.
pub(crate) const ATTEMPTS_MAX: u8 = 10;
/// Maximum time to wait for the answer of a person, in seconds: a week.
pub const PATIENCE_MAX_S: u32 = 7 * 24 * 3600;

fn attempts() -> u8 {
    ATTEMPTS
}

impl Method {
    /// Creates a method without alternatives.
    pub fn of(order: TaskOrder, children: Vec<TaskIndex>) -> Self {
        Method { order, children, alternatives: vec![] }
    }
}

impl TaskSpec {
    /// Creates a task of these roles without parameters and items.
    pub fn of(task_type: TaskType, roles: Vec<RoleId>) -> Self {
        TaskSpec {
            task_type,
            roles,
            parameters: BTreeMap::new(),
            reaches: BTreeMap::new(),
            acquires: BTreeMap::new(),
            releases: BTreeSet::new(),
            attempts: ATTEMPTS,
            patience_s: None,
            escalation: None,
            inputs: BTreeMap::new(),
            conditions: vec![],
            domain: None,
        }
    }

    /// Checks whether the task names a role: as a participant, or in a parameter.
    pub fn names(&self, role: &RoleId) -> bool {
        self.roles.contains(role) || self.parameters.values().any(|value| value == role.as_str())
    }

    /// Checks that the task was made with the domain that this node has for its type. `None`: the type
    /// is of no file here.
    ///
    /// # Errors
    /// [`OtherDomain`] if both are known and differ.
    pub fn check_domain(&self, own: Option<&DomainReference>) -> Result<(), OtherDomain> {
        match (own, &self.domain) {
            (Some(own), Some(other)) if own != other => {
                Err(OtherDomain { task_type: self.task_type.clone(), own: own.clone(), other: other.clone() })
            }
            _ => Ok(()),
        }
    }

    /// Returns the tasks whose results the task uses.
    ///
    /// # Errors
    /// Description of the first invalid condition.
    pub fn tasks_used(&self) -> Result<BTreeSet<TaskId>, String> {
        let mut used: BTreeSet<TaskId> = self.inputs.values().map(|input| input.task.clone()).collect();
        for condition in &self.conditions {
            used.extend(condition::tasks_used(condition).map_err(|problem| format!("`{condition}`: {problem}"))?);
        }
        Ok(used)
    }

    /// Checks whether all conditions hold. As with `&&`, a false condition decides whatever the others are.
    ///
    /// # Errors
    /// Description of the first problem: an unknown result decides, or a condition is neither true nor false.
    pub fn conditions_hold(&self, outcomes: &TaskOutcomes) -> Result<bool, String> {
        let mut all_hold = Ok(true);
        for text in &self.conditions {
            match condition::holds(text, outcomes) {
                Ok(true) => {}
                Ok(false) => return Ok(false),
                problem => all_hold = all_hold.and(problem),
            }
        }
        all_hold
    }

    /// Sets the parameters that are results of earlier tasks.
    ///
    /// # Errors
    /// Description of the problem: a result is unknown.
    pub fn set_inputs(&mut self, outcomes: &TaskOutcomes) -> Result<(), String> {
        for (name, ResultReference { task, result }) in &self.inputs {
            let value = match outcomes.get(task) {
                Some(TaskOutcome::Done(results)) => results.get(result).ok_or("the task did not return it"),
                Some(TaskOutcome::Skipped) => Err("the task was skipped"),
                None => Err("the task has not ended"),
            };
            let value = value.map_err(|problem| format!("`{name}` is unknown: ${{{task}.{result}}}: {problem}"))?;
            self.parameters.insert(name.clone(), value.to_string());
        }
        Ok(())
    }

    /// Returns the items that the task moves.
    pub(crate) fn items(&self) -> impl Iterator<Item = &ItemId> {
        self.acquires.keys().chain(&self.releases)
    }

    /// Checks whether several roles execute the task jointly.
    pub fn is_joint(&self) -> bool {
        self.roles.len() > 1
    }
}

impl Mission {
    /// Sets the domains of all tasks.
    pub(super) fn set_domains(&mut self, domain: &Domain) {
        let set = |spec: &mut TaskSpec| {
            spec.domain = domain.get(&spec.task_type).and_then(|schema| schema.domain.clone());
        };
        for node in &mut self.tasks {
            match &mut node.body {
                TaskBody::Elementary(spec) => set(spec),
                TaskBody::Abstract(method) => {
                    method.alternatives.iter_mut().flat_map(|other| &mut other.tasks).for_each(|(_, spec)| set(spec));
                }
            }
        }
    }

    /// Sets parameters that are results of earlier tasks to typical values, for estimates.
    pub(super) fn set_typical_inputs(&mut self, domain: &Domain) {
        let specs = self.tasks.iter_mut().filter_map(|node| match &mut node.body {
            TaskBody::Elementary(spec) => Some(spec),
            TaskBody::Abstract(_) => None,
        });
        for spec in specs {
            let parameters = domain.get(&spec.task_type).map(|schema| &schema.parameters);
            for name in spec.inputs.keys() {
                let kind = parameters.and_then(|parameters| parameters.get(name)).map(|parameter| &parameter.kind);
                spec.parameters.insert(name.clone(), kind.unwrap_or(&ValueKind::Text).typical());
            }
        }
    }

    /// Sets `patience_s` of the tasks of people that state none.
    pub fn set_default_patience(&mut self, patience_s: u32) {
        let Mission { roles, tasks, .. } = self;
        let is_person = |role: &RoleId| roles.get(role).is_some_and(|role| role.kind == RoleKind::Unmanaged);
        let specs = tasks.iter_mut().filter_map(|node| match &mut node.body {
            // The tasks of alternatives belong to robots.
            TaskBody::Elementary(spec) => Some(spec),
            TaskBody::Abstract(_) => None,
        });
        for spec in specs.filter(|spec| spec.roles.iter().all(is_person)) {
            spec.patience_s.get_or_insert(patience_s);
        }
    }

    /// Returns the elementary tasks, depth first and in the order of the file, without those of
    /// alternatives. Terminates for an unchecked mission, too: each task is visited at most once.
    pub fn elementary(&self) -> Vec<(&TaskId, &TaskSpec)> {
        self.elementary_below(0)
    }

    /// Returns the same for the subtree of a task.
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

    /// Returns the names of all tasks, including those of alternatives.
    pub(crate) fn task_names(&self) -> impl Iterator<Item = &TaskId> {
        self.tasks.iter().flat_map(|node| {
            let others: &[AlternativeMethod] = match &node.body {
                TaskBody::Abstract(method) => &method.alternatives,
                TaskBody::Elementary(_) => &[],
            };
            let others = others.iter().flat_map(|other| other.tasks.iter().map(|(id, _)| id));
            std::iter::once(&node.id).chain(others)
        })
    }

    /// Returns the results of the mission that are known.
    pub(crate) fn known_results(&self, outcomes: &TaskOutcomes) -> BTreeMap<String, Scalar> {
        let known = |(name, text): (&String, &String)| Some((name.clone(), condition::value(text, outcomes).ok()?));
        self.results.iter().filter_map(known).collect()
    }

    /// Returns the roles that robots fill, in the order of their names.
    pub fn managed_roles(&self) -> impl Iterator<Item = &RoleId> {
        self.roles_of_kind(RoleKind::Managed)
    }

    /// Returns the roles that people have, in the order of their names.
    pub fn unmanaged_roles(&self) -> impl Iterator<Item = &RoleId> {
        self.roles_of_kind(RoleKind::Unmanaged)
    }

    fn roles_of_kind(&self, kind: RoleKind) -> impl Iterator<Item = &RoleId> {
        self.roles.iter().filter(move |(_, role)| role.kind == kind).map(|(id, _)| id)
    }

    /// Returns the task types of a role.
    pub fn task_types_of(&self, role: &RoleId) -> BTreeSet<TaskType> {
        let tasks = self.elementary();
        let own = tasks.iter().filter(|(_, spec)| spec.roles.contains(role));
        own.map(|(_, spec)| spec.task_type.clone()).collect()
    }
}
