//! Alternatives of a local plan: a failed task is replaced by other tasks.

use consort_protocol::ids::TaskId;
use consort_protocol::mission::TaskSpec;
use consort_protocol::plan::{Alternative, LocalPlan, PlanProgress, StepIndex};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Alternatives that a role has started.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlternativeProgress {
    /// Alternatives started so far. An alternative starts at most once.
    started: BTreeSet<usize>,
    /// Current alternative, and the number of its tasks that have ended.
    current: Option<(usize, usize)>,
}

/// Returns an alternative of a plan.
pub(super) fn alternative(plan: &LocalPlan, number: usize) -> Option<&Alternative> {
    plan.alternatives.get(number)
}

/// Returns a task of an alternative.
pub(super) fn alternative_task(plan: &LocalPlan, number: usize, task: usize) -> Option<(&TaskId, &TaskSpec)> {
    let (id, spec) = alternative(plan, number)?.tasks.get(task)?;
    Some((id, spec))
}

impl AlternativeProgress {
    /// Drops the current alternative if all steps that it replaces have ended.
    pub(super) fn restore(mut self, progress: &PlanProgress) -> AlternativeProgress {
        self.current = self.current.filter(|(number, _)| {
            let replacement = alternative(progress.plan(), *number);
            replacement.is_some_and(|replacement| !replacement.replaces.is_subset(progress.ended()))
        });
        self
    }

    /// Returns the current alternative, and the number of its tasks that have ended.
    pub(super) fn current(&self) -> Option<(usize, usize)> {
        self.current
    }

    /// Starts the first alternative, in the order of the plan, that replaces all of these steps and
    /// has not been started yet. Returns its index.
    pub(super) fn start_for(&mut self, replaced_steps: &BTreeSet<StepIndex>, progress: &PlanProgress) -> Option<usize> {
        let mut candidates = progress.alternatives_for(*replaced_steps.first()?);
        let (number, _) = candidates.find(|(number, candidate)| {
            !self.started.contains(number) && replaced_steps.is_subset(&candidate.replaces)
        })?;
        self.started.insert(number);
        self.current = Some((number, 0));
        Some(number)
    }

    /// Marks a task of an alternative as ended. The last task ends the replaced steps.
    pub(super) fn end_task(&mut self, number: usize, task: usize, progress: &mut PlanProgress) {
        let tasks = alternative(progress.plan(), number).map_or(0, |replacement| replacement.tasks.len());
        self.current = Some((number, task + 1));
        if task + 1 >= tasks {
            self.current = None;
            progress.apply_alternative(number).expect("the tasks of a started alternative may end");
        }
    }

    /// Returns the open tasks of the current alternative, and the steps that it replaces.
    pub(super) fn remaining<'p>(
        &self,
        plan: &'p LocalPlan,
    ) -> (&'p [(TaskId, TaskSpec)], Option<&'p BTreeSet<StepIndex>>) {
        let current = self.current.and_then(|(number, done)| Some((alternative(plan, number)?, done)));
        current.map_or((&[][..], None), |(replacement, done)| {
            (replacement.tasks.get(done..).unwrap_or_default(), Some(&replacement.replaces))
        })
    }
}
