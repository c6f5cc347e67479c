//! Outcomes of tasks, as far as a role needs or produces them.

use consort_protocol::ids::TaskId;
use consort_protocol::mission::{TaskOutcome, TaskOutcomes};
use consort_protocol::plan::{LocalPlan, StepAction, StepIndex};
use std::collections::{BTreeMap, BTreeSet};

/// Outcomes of tasks. Decisions use only those in the ledger, which never change, so that all roles
/// decide in the same way, as does a robot that takes over the role.
#[derive(Debug, Clone)]
pub(super) struct Outcomes {
    /// Steps that use the results of tasks, with these tasks.
    used: BTreeMap<StepIndex, BTreeSet<TaskId>>,
    recorded: TaskOutcomes,
    own: TaskOutcomes,
}

impl Outcomes {
    pub(super) fn new(plan: &LocalPlan, own: TaskOutcomes) -> Outcomes {
        let tasks = (0..).zip(&plan.steps).filter_map(|(index, step)| match &step.action {
            // A task with an invalid condition uses no results. It fails when it is due.
            StepAction::Task { spec, .. } => Some((index, spec.tasks_used().unwrap_or_default())),
            StepAction::Send(_) | StepAction::Wait(_) => None,
        });
        Outcomes { used: tasks.filter(|(_, used)| !used.is_empty()).collect(), recorded: TaskOutcomes::new(), own }
    }

    /// Checks whether the ledger is known to contain the outcomes that a step uses.
    pub(super) fn are_known_for(&self, step: StepIndex) -> bool {
        self.used.get(&step).is_none_or(|used| used.iter().all(|task| self.recorded.contains_key(task)))
    }

    /// Returns the outcomes that the ledger is known to contain.
    pub(super) fn recorded(&self) -> &TaskOutcomes {
        &self.recorded
    }

    pub(super) fn set_recorded(&mut self, outcomes: TaskOutcomes) {
        self.recorded.extend(outcomes);
    }

    /// Adds the outcome of a task of this role.
    pub(super) fn add(&mut self, task: TaskId, outcome: TaskOutcome) {
        self.own.insert(task, outcome);
    }

    /// Returns the outcomes of tasks of this role.
    pub(super) fn own(&self) -> &TaskOutcomes {
        &self.own
    }
}
