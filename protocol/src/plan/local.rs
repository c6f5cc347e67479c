//! Local plans as values.

use crate::ids::{RoleId, TaskId};
use crate::mission::TaskSpec;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

/// Position of a step in its local plan.
pub type StepIndex = u32;

/// A mission divided: one plan for each role that has anything to do.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Division {
    /// Every role's plan.
    pub plans: BTreeMap<RoleId, LocalPlan>,
}

/// What one role does.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LocalPlan {
    /// Whose plan it is.
    pub role: RoleId,
    /// The steps, in an order that respects every `after` (and is the order of the global plan where that leaves a choice).
    pub steps: Vec<Step>,
    /// What the role may do instead of some of its tasks when one of them has failed for good: innermost first, then in the
    /// order of the file.
    #[serde(default)]
    pub alternatives: Vec<Alternative>,
    /// Steps that may be performed only once the ledger is known to hold every step of this plan that has ended so far.
    /// What a lost robot may have in its hands can be told from the ledger for this reason.
    #[serde(default)]
    pub guarded: BTreeSet<StepIndex>,
}

/// Other tasks for some of a plan. Once they are done, in their order, the steps that they replace count as ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Alternative {
    /// Task steps of the plan, between which nothing is sent and nothing is awaited.
    pub replaces: BTreeSet<StepIndex>,
    /// What is done in their stead, one after the other. Never empty.
    pub tasks: Vec<(TaskId, TaskSpec)>,
}

/// One step of a local plan.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Step {
    /// What to do.
    pub action: StepAction,
    /// Steps of the same plan that must have ended before this one begins; only smaller indices, sorted, irredundant.
    pub after: Vec<StepIndex>,
}

/// What a step comes down to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum StepAction {
    /// Do a task with the skill of its type.
    Task {
        /// Its name in the mission.
        id: TaskId,
        /// What is to be achieved.
        spec: TaskSpec,
    },
    /// Tell another role.
    Send(Signal),
    /// Begin nothing after this before the other role has told.
    Wait(Signal),
}

/// A message between two roles of one mission. Sent once by `from`, awaited once by `to`; together with the mission's
/// id its name is unique.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Signal {
    /// What is being said.
    pub kind: SignalKind,
    /// Of which task.
    pub task: TaskId,
    /// Who says it.
    pub from: RoleId,
    /// Who awaits it.
    pub to: RoleId,
}

/// What a signal says of its task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SignalKind {
    /// The sender has ended its part.
    Done,
    /// The sender stands ready to begin a joint task and will begin nothing else before it.
    Ready,
}

impl fmt::Display for Signal {
    /// `done:open_drawer:r1:nurse`: kind, task, sender, receiver.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = match self.kind {
            SignalKind::Done => "done",
            SignalKind::Ready => "ready",
        };
        write!(f, "{kind}:{}:{}:{}", self.task, self.from, self.to)
    }
}

impl LocalPlan {
    /// A plan of these steps, without alternatives or guards.
    pub fn of(role: RoleId, steps: Vec<Step>) -> Self {
        LocalPlan { role, steps, alternatives: vec![], guarded: BTreeSet::new() }
    }

    /// The tasks a robot would be asked to price, in the order of the plan: messages are steps that cost time too.
    pub fn tasks(&self) -> impl Iterator<Item = (&TaskId, &TaskSpec)> {
        self.steps.iter().filter_map(|step| match &step.action {
            StepAction::Task { id, spec } => Some((id, spec)),
            StepAction::Send(_) | StepAction::Wait(_) => None,
        })
    }
}
