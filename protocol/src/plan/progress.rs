//! Progress of a role in its local plan, and the steps that are permitted next.
//!
//! A value that records the ended steps and the received signals, and computes the permitted steps.
//! It implements the contract of [`check_division`](super::check_division): a robot that performs
//! only permitted steps, a single step at a time, never waits forever.

use super::local::{Alternative, LocalPlan, Signal, SignalKind, Step, StepAction, StepIndex};
use crate::ids::{RoleId, TaskId};
use consort_text::count;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Progress of a role in its plan. Serializable, and checked when it is restored; cheap to clone.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "StoredProgress", into = "StoredProgress")]
pub struct PlanProgress {
    plan: Arc<LocalPlan>,
    ended: BTreeSet<StepIndex>,
    /// Waits with a received signal.
    received: BTreeSet<StepIndex>,
}

/// Serialized form of progress.
#[derive(Serialize, Deserialize)]
struct StoredProgress {
    plan: LocalPlan,
    ended: BTreeSet<StepIndex>,
    received: BTreeSet<Signal>,
}

/// Error: stored progress cannot be restored. Nothing was changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ProgressError {
    /// The progress may belong to another plan.
    #[error("step {step} is recorded as ended, but the plan has {}", count(*steps, "step", "steps"))]
    NoSuchStep {
        /// Index of the step.
        step: StepIndex,
        /// Number of steps in the plan.
        steps: usize,
    },
    /// The progress may belong to another plan.
    #[error("step {step} is recorded as ended, but its predecessor {before} is not")]
    OutOfOrder {
        /// The step.
        step: StepIndex,
        /// Predecessor that should have ended first.
        before: StepIndex,
    },
    /// The progress may belong to another plan.
    #[error("the signal {signal} is recorded as received, but the plan does not wait for it")]
    NotAwaited {
        /// The signal.
        signal: Signal,
    },
}

/// Error: a step was reported as ended and was not permitted. The progress is unchanged. Common
/// when a report is repeated, or arrives after its mission was revoked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("step {step} cannot end now: {problem}")]
pub struct StepNotPermitted {
    /// The step.
    pub step: StepIndex,
    /// Reason.
    pub problem: &'static str,
}

impl TryFrom<StoredProgress> for PlanProgress {
    type Error = ProgressError;
    fn try_from(stored: StoredProgress) -> Result<Self, ProgressError> {
        PlanProgress::restore(stored.plan, stored.ended, stored.received)
    }
}

impl From<PlanProgress> for StoredProgress {
    fn from(progress: PlanProgress) -> StoredProgress {
        let received = waits(&progress.plan).filter(|(step, _)| progress.received.contains(step));
        let received = received.map(|(_, signal)| signal.clone()).collect();
        StoredProgress { plan: Arc::unwrap_or_clone(progress.plan), ended: progress.ended, received }
    }
}

impl PlanProgress {
    /// Creates progress without ended steps.
    pub fn new(plan: LocalPlan) -> Self {
        Self { plan: Arc::new(plan), ended: BTreeSet::new(), received: BTreeSet::new() }
    }

    /// Restores progress. The signal of a wait that has ended counts as received.
    ///
    /// # Errors
    /// [`ProgressError`] if the steps are not part of this plan, or ended in an order that the plan
    /// does not allow.
    pub fn restore(
        plan: LocalPlan,
        ended: BTreeSet<StepIndex>,
        received: BTreeSet<Signal>,
    ) -> Result<Self, ProgressError> {
        for &step in &ended {
            let Some(Step { after, .. }) = plan.steps.get(step as usize) else {
                return Err(ProgressError::NoSuchStep { step, steps: plan.steps.len() });
            };
            if let Some(&before) = after.iter().find(|before| !ended.contains(before)) {
                return Err(ProgressError::OutOfOrder { step, before });
            }
        }
        let awaited: BTreeSet<&Signal> = waits(&plan).map(|(_, signal)| signal).collect();
        if let Some(signal) = received.iter().find(|signal| !awaited.contains(signal)) {
            return Err(ProgressError::NotAwaited { signal: signal.clone() });
        }
        let known = waits(&plan).filter(|(step, signal)| ended.contains(step) || received.contains(signal));
        let received = known.map(|(step, _)| step).collect();
        Ok(Self { plan: Arc::new(plan), ended, received })
    }

    /// Returns the plan.
    pub fn plan(&self) -> &LocalPlan {
        &self.plan
    }

    /// Returns a step of the plan.
    pub fn step(&self, step: StepIndex) -> Option<&Step> {
        self.plan.steps.get(step as usize)
    }

    /// Returns the steps that have ended.
    pub fn ended(&self) -> &BTreeSet<StepIndex> {
        &self.ended
    }

    /// Checks whether all steps have ended.
    pub fn is_complete(&self) -> bool {
        self.ended.len() == self.plan.steps.len()
    }

    /// Returns the joint task for which this role has signalled that it is ready, until its part in
    /// it has ended. Until then it executes no other task.
    pub fn committed(&self) -> Option<&TaskId> {
        let mut ready = self.ended.iter().rev().filter_map(|step| match self.step(*step).map(|step| &step.action) {
            Some(StepAction::Send(signal)) if signal.kind == SignalKind::Ready => Some(&signal.task),
            _ => None,
        });
        let unended = |task: &TaskId| {
            self.plan.steps.iter().enumerate().any(|(index, step)| match &step.action {
                StepAction::Task { id, .. } => id == task && !self.ended.contains(&(index as StepIndex)),
                StepAction::Send(_) | StepAction::Wait(_) => false,
            })
        };
        ready.find(|task| unended(task))
    }

    /// Returns every step that may be performed now while the robot executes no task, in the order
    /// of the plan.
    pub fn permitted(&self) -> Vec<StepIndex> {
        let committed = self.committed();
        let free = |task: &TaskId| committed.is_none_or(|joint| joint == task);
        let may = |index: StepIndex, step: &Step| match &step.action {
            StepAction::Task { id, .. } => free(id),
            StepAction::Send(signal) => signal.kind == SignalKind::Done || free(&signal.task),
            StepAction::Wait(_) => self.received.contains(&index),
        };
        self.open().filter(|(index, step)| may(*index, step)).map(|(index, _)| index).collect()
    }

    /// Returns the step to perform next. Order of preference: sends of `done`, for which other
    /// roles may be waiting; waits with a received signal; the first task in the order of the plan,
    /// or the `ready` for it. Call this only while no task runs: signals received meanwhile may
    /// change the order.
    pub fn next(&self) -> Option<(StepIndex, &Step)> {
        self.first_of(self.permitted().into_iter())
    }

    fn first_of(&self, permitted: impl Iterator<Item = StepIndex>) -> Option<(StepIndex, &Step)> {
        let rank = |index: &StepIndex| match &self.plan.steps[*index as usize].action {
            StepAction::Send(signal) if signal.kind == SignalKind::Done => 0,
            StepAction::Wait(_) => 1,
            StepAction::Send(_) | StepAction::Task { .. } => 2,
        };
        let index = permitted.min_by_key(|index| (rank(index), *index))?;
        Some((index, &self.plan.steps[index as usize]))
    }

    /// Records that a step was performed: a signal was sent, a task succeeded, or the signal of a
    /// wait was noticed.
    ///
    /// # Errors
    /// [`StepNotPermitted`] if the step was not permitted; nothing is changed.
    pub fn end(&mut self, step: StepIndex) -> Result<(), StepNotPermitted> {
        let reject = |problem| Err(StepNotPermitted { step, problem });
        if step as usize >= self.plan.steps.len() {
            return reject("the plan has no such step");
        }
        if self.ended.contains(&step) {
            return reject("it has ended already");
        }
        if !self.permitted().contains(&step) {
            return reject("a predecessor has not ended, or its signal has not been received, or a joint task is due");
        }
        self.ended.insert(step);
        Ok(())
    }

    /// Discards signals from `role` that were received but not yet used, since the role has a new
    /// holder. Returns whether any signal was discarded.
    pub fn discard_signals_from(&mut self, role: &RoleId) -> bool {
        let invalid = waits(&self.plan).filter(|(step, signal)| signal.from == *role && !self.ended.contains(step));
        let invalid: BTreeSet<StepIndex> = invalid.map(|(step, _)| step).collect();
        let before = self.received.len();
        self.received.retain(|step| !invalid.contains(step));
        self.received.len() < before
    }

    /// Checks whether the ledger permits the step: the step is not guarded, or `known` contains all
    /// steps that have ended so far. `known` are the steps of this plan that the ledger is known to
    /// contain.
    pub fn is_guard_met(&self, step: StepIndex, known: &BTreeSet<StepIndex>) -> bool {
        !self.plan.guarded.contains(&step) || self.ended.is_subset(known)
    }

    /// Returns the same as [`next`](Self::next), restricted to steps with a [met
    /// guard](Self::is_guard_met). While a guarded step is blocked, other steps may proceed.
    pub fn next_guarded(&self, known: &BTreeSet<StepIndex>) -> Option<(StepIndex, &Step)> {
        self.next_where(|step| self.is_guard_met(step, known))
    }

    /// Returns the same as [`next`](Self::next), restricted to steps that `may_begin`.
    pub fn next_where(&self, may_begin: impl Fn(StepIndex) -> bool) -> Option<(StepIndex, &Step)> {
        self.first_of(self.permitted().into_iter().filter(|step| may_begin(*step)))
    }

    /// Returns the alternatives, with their numbers, that can be tried when the task of this step
    /// has failed permanently.
    pub fn alternatives_for(&self, step: StepIndex) -> impl Iterator<Item = (usize, &Alternative)> {
        self.plan.alternatives.iter().enumerate().filter(move |(_, other)| other.replaces.contains(&step))
    }

    /// Records that all tasks of an alternative were completed: the steps that it replaces have
    /// ended.
    ///
    /// # Errors
    /// [`StepNotPermitted`] if there is no such alternative or a replaced step is not permitted;
    /// nothing is changed.
    pub fn apply_alternative(&mut self, alternative: usize) -> Result<(), StepNotPermitted> {
        let Some(Alternative { replaces, .. }) = self.plan.alternatives.get(alternative) else {
            return Err(StepNotPermitted { step: 0, problem: "the plan has no such alternative" });
        };
        let mut then = self.clone();
        for step in replaces.iter().filter(|step| !self.ended.contains(step)) {
            then.end(*step)?;
        }
        *self = then;
        Ok(())
    }

    /// Records a received signal. Returns false if the signal was received before or is not awaited
    /// by this plan; then nothing changes.
    pub fn receive(&mut self, signal: &Signal) -> bool {
        let wait = waits(&self.plan).find(|(_, awaited)| *awaited == signal).map(|(step, _)| step);
        wait.is_some_and(|step| self.received.insert(step))
    }

    /// Returns the signals that are awaited now and have not been received: the signals to query
    /// from other roles.
    pub fn awaited_signals(&self) -> Vec<&Signal> {
        self.open()
            .filter_map(|(index, step)| match &step.action {
                StepAction::Wait(signal) if !self.received.contains(&index) => Some(signal),
                StepAction::Wait(_) | StepAction::Send(_) | StepAction::Task { .. } => None,
            })
            .collect()
    }

    /// Returns the steps that have not ended and have no unended predecessor.
    fn open(&self) -> impl Iterator<Item = (StepIndex, &Step)> {
        self.plan.steps.iter().enumerate().map(|(index, step)| (index as StepIndex, step)).filter(|(index, step)| {
            !self.ended.contains(index) && step.after.iter().all(|before| self.ended.contains(before))
        })
    }
}

fn waits(plan: &LocalPlan) -> impl Iterator<Item = (StepIndex, &Signal)> {
    plan.steps.iter().enumerate().filter_map(|(index, step)| match &step.action {
        StepAction::Wait(signal) => Some((index as StepIndex, signal)),
        StepAction::Send(_) | StepAction::Task { .. } => None,
    })
}
