//! Local plans as values.

use crate::ids::{RoleId, TaskId, TaskType};
use crate::mission::TaskSpec;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

/// Index of a step in its local plan.
pub type StepIndex = u32;

/// Divided mission: 1 plan for each role that has any step.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Division {
    /// Plans by role.
    pub plans: BTreeMap<RoleId, LocalPlan>,
}

/// Plan of a single role.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LocalPlan {
    /// Role of the plan.
    pub role: RoleId,
    /// Steps, in an order that respects every `after`; otherwise in the order of the global plan.
    pub steps: Vec<Step>,
    /// Alternatives to try when a task has failed permanently: innermost first, then in the order
    /// of the file.
    #[serde(default)]
    pub alternatives: Vec<Alternative>,
    /// Steps that may be performed only after the ledger is known to contain all steps of this plan
    /// that have ended so far. Due to these guards, the ledger shows which items a lost robot may
    /// have.
    #[serde(default)]
    pub guarded: BTreeSet<StepIndex>,
}

/// Replacement tasks for some steps of a plan. When they are completed, in their order, the
/// replaced steps count as ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Alternative {
    /// Task steps that are replaced. No step between them sends or waits for a signal.
    pub replaces: BTreeSet<StepIndex>,
    /// Replacement tasks, executed in sequence. Never empty.
    pub tasks: Vec<(TaskId, TaskSpec)>,
}

/// Step of a local plan.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Step {
    /// Action of the step.
    pub action: StepAction,
    /// Steps of the same plan that must have ended before this step begins: only smaller indices,
    /// sorted, without redundant entries.
    pub after: Vec<StepIndex>,
}

/// Action of a step.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum StepAction {
    /// Executes a task with the skill of its type.
    Task {
        /// Name of the task in the mission.
        id: TaskId,
        /// Specification of the task.
        spec: TaskSpec,
    },
    /// Sends a signal to another role.
    Send(Signal),
    /// Blocks the following steps until the signal is received.
    Wait(Signal),
}

/// Message between two roles of a mission. It is sent once by `from` and awaited once by `to`. Its
/// name is unique together with the mission's id.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
pub struct Signal {
    /// Kind of signal.
    pub kind: SignalKind,
    /// Task concerned.
    pub task: TaskId,
    /// Sending role.
    pub from: RoleId,
    /// Receiving role.
    pub to: RoleId,
}

/// Meaning of a signal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum SignalKind {
    /// The sender has ended its part in the task.
    Done,
    /// The sender is ready to begin a joint task and will begin no other task before it.
    Ready,
}

impl fmt::Display for Signal {
    /// `done:open_box:r1:clerk`: kind, task, sender, receiver.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = match self.kind {
            SignalKind::Done => "done",
            SignalKind::Ready => "ready",
        };
        write!(f, "{kind}:{}:{}:{}", self.task, self.from, self.to)
    }
}

impl LocalPlan {
    /// Creates a plan of these steps, without alternatives or guards.
    pub fn of(role: RoleId, steps: Vec<Step>) -> Self {
        LocalPlan { role, steps, alternatives: vec![], guarded: BTreeSet::new() }
    }

    /// Returns the step of a task.
    pub fn step_of(&self, task: &TaskId) -> Option<StepIndex> {
        let is_it = |step: &Step| matches!(&step.action, StepAction::Task { id, .. } if id == task);
        self.steps.iter().position(is_it).map(|index| index as StepIndex)
    }

    /// Returns the task of a step; `None` for a signal.
    pub fn step_task(&self, step: StepIndex) -> Option<(&TaskId, &TaskSpec)> {
        match &self.steps.get(step as usize)?.action {
            StepAction::Task { id, spec } => Some((id, spec)),
            StepAction::Send(_) | StepAction::Wait(_) => None,
        }
    }

    /// Returns the tasks whose results the plan uses. An invalid condition uses none; the task with it
    /// fails.
    pub fn tasks_used(&self) -> BTreeSet<TaskId> {
        self.tasks().flat_map(|(_, spec)| spec.tasks_used().unwrap_or_default()).collect()
    }

    /// Returns the skills that the plan needs beyond these, in the order of their names.
    pub fn skills_missing_in(&self, skills: &BTreeSet<TaskType>) -> Vec<TaskType> {
        let needed: BTreeSet<&TaskType> = self.tasks().map(|(_, spec)| &spec.task_type).collect();
        needed.into_iter().filter(|skill| !skills.contains(*skill)).cloned().collect()
    }

    /// Returns the tasks of the plan, in order. Signals are steps that take time, too, but are not
    /// included.
    pub fn tasks(&self) -> impl Iterator<Item = (&TaskId, &TaskSpec)> {
        self.steps.iter().filter_map(|step| match &step.action {
            StepAction::Task { id, spec } => Some((id, spec)),
            StepAction::Send(_) | StepAction::Wait(_) => None,
        })
    }
}
