//! How far a role has come in its local plan, and what it may do next.
//!
//! A value that is told what has ended and what has been heard, and answers which steps may be performed. It keeps the
//! contract of [`check_division`](super::check_division): whoever performs only what it allows, one step at a time,
//! waits for nobody for ever.

use super::local::{Alternative, LocalPlan, Signal, SignalKind, Step, StepAction, StepIndex};
use crate::count::count;
use crate::ids::{RoleId, TaskId};
use crate::mutants::{self, Mutant};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::sync::Arc;

/// A role's progress in its plan. Survives as text or bytes, and is checked when it is read back; cheap to clone.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Kept", into = "Kept")]
pub struct PlanProgress {
    plan: Arc<LocalPlan>,
    ended: BTreeSet<StepIndex>,
    /// The waits whose signal has been heard.
    heard: BTreeSet<StepIndex>,
}

/// The form in which progress is kept.
#[derive(Serialize, Deserialize)]
struct Kept {
    plan: LocalPlan,
    ended: BTreeSet<StepIndex>,
    heard: BTreeSet<Signal>,
}

/// Why kept progress cannot be taken up. Nothing was taken over.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ProgressError {
    /// Kept for another plan, perhaps.
    #[error("step {step} is said to have ended, but the plan has {}", count(*steps, "step", "steps"))]
    NoSuchStep {
        /// The step.
        step: StepIndex,
        /// How many there are.
        steps: usize,
    },
    /// Kept for another plan, perhaps.
    #[error("step {step} is said to have ended, but not step {before}, which comes before it")]
    OutOfOrder {
        /// The step.
        step: StepIndex,
        /// What should have ended first.
        before: StepIndex,
    },
    /// Kept for another plan, perhaps.
    #[error("the signal {signal} is said to have been heard, but the plan does not wait for it")]
    NotAwaited {
        /// The signal.
        signal: Signal,
    },
}

/// A step that was said to have ended and could not have. The progress is unchanged; ordinary when a report comes twice
/// or after its mission was taken away.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("step {step} cannot end now: {problem}")]
pub struct StepNotPermitted {
    /// The step.
    pub step: StepIndex,
    /// Why not.
    pub problem: &'static str,
}

impl TryFrom<Kept> for PlanProgress {
    type Error = ProgressError;
    fn try_from(kept: Kept) -> Result<Self, ProgressError> {
        PlanProgress::restore(kept.plan, kept.ended, kept.heard)
    }
}

impl From<PlanProgress> for Kept {
    fn from(progress: PlanProgress) -> Kept {
        let heard = waits(&progress.plan).filter(|(step, _)| progress.heard.contains(step));
        let heard = heard.map(|(_, signal)| signal.clone()).collect();
        Kept { plan: Arc::unwrap_or_clone(progress.plan), ended: progress.ended, heard }
    }
}

impl PlanProgress {
    /// Nothing has ended yet.
    pub fn new(plan: LocalPlan) -> Self {
        Self { plan: Arc::new(plan), ended: BTreeSet::new(), heard: BTreeSet::new() }
    }

    /// Takes up where somebody left off. A wait that has ended counts as heard.
    ///
    /// # Errors
    /// [`ProgressError`] if the steps are not of this plan, or ended in an order that the plan does not allow.
    pub fn restore(
        plan: LocalPlan,
        ended: BTreeSet<StepIndex>,
        heard: BTreeSet<Signal>,
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
        if let Some(signal) = heard.iter().find(|signal| !awaited.contains(signal)) {
            return Err(ProgressError::NotAwaited { signal: signal.clone() });
        }
        let known = waits(&plan).filter(|(step, signal)| {
            ended.contains(step) || heard.contains(signal) || mutants::is_active(Mutant::WaitSkipped)
        });
        let heard = known.map(|(step, _)| step).collect();
        Ok(Self { plan: Arc::new(plan), ended, heard })
    }

    /// The plan.
    pub fn plan(&self) -> &LocalPlan {
        &self.plan
    }

    /// A step of the plan.
    pub fn step(&self, step: StepIndex) -> Option<&Step> {
        self.plan.steps.get(step as usize)
    }

    /// The steps that have ended.
    pub fn ended(&self) -> &BTreeSet<StepIndex> {
        &self.ended
    }

    /// Whether all steps have ended.
    pub fn is_complete(&self) -> bool {
        self.ended.len() == self.plan.steps.len()
    }

    /// The joint task for which this role has said that it stands ready, until its part in it has ended. Until then
    /// it does no other task.
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

    /// Every step that may be performed now by a robot that does no task at present, in the order of the plan.
    pub fn permitted(&self) -> Vec<StepIndex> {
        let committed = self.committed();
        let free = |task: &TaskId| committed.is_none_or(|joint| joint == task);
        let may = |index: StepIndex, step: &Step| match &step.action {
            StepAction::Task { id, .. } => free(id),
            StepAction::Send(signal) => signal.kind == SignalKind::Done || free(&signal.task),
            StepAction::Wait(_) => self.heard.contains(&index),
        };
        self.open().filter(|(index, step)| may(*index, step)).map(|(index, _)| index).collect()
    }

    /// The step to perform next: what others may be waiting for, then what has been heard, then the first task in the order
    /// of the plan, or the `ready` for it. To be asked while no task runs: what is heard meanwhile may let another one
    /// come first.
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

    /// A step was performed: sent, done with success, or, of a wait, noticed.
    ///
    /// # Errors
    /// [`NotPermitted`] if the step could not have been performed; nothing is changed.
    pub fn end(&mut self, step: StepIndex) -> Result<(), StepNotPermitted> {
        let refuse = |problem| Err(StepNotPermitted { step, problem });
        if step as usize >= self.plan.steps.len() {
            return refuse("the plan has no such step");
        }
        if self.ended.contains(&step) {
            return refuse("it has ended already");
        }
        if !self.permitted().contains(&step) {
            return refuse(
                "what comes before it has not ended, or its signal has not been heard, or a joint task is due",
            );
        }
        self.ended.insert(step);
        Ok(())
    }

    /// Whoever plays `role` now is not who spoke for it before: what was heard from it and not yet acted on no longer holds.
    /// Returns whether there was any such thing.
    pub fn discard_signals_from(&mut self, role: &RoleId) -> bool {
        let void = waits(&self.plan).filter(|(step, signal)| signal.from == *role && !self.ended.contains(step));
        let void: BTreeSet<StepIndex> = void.map(|(step, _)| step).collect();
        let heard = self.heard.len();
        self.heard.retain(|step| !void.contains(step));
        self.heard.len() < heard
    }

    /// Whether the step may be performed as far as the ledger is concerned: it is not guarded, or `known`, the steps that the
    /// ledger is known to hold of this plan, has all that ended so far.
    pub fn is_guard_met(&self, step: StepIndex, known: &BTreeSet<StepIndex>) -> bool {
        mutants::is_active(Mutant::GuardSkipped) || !self.plan.guarded.contains(&step) || self.ended.is_subset(known)
    }

    /// As [`next`](Self::next), of the steps whose [guard is met](Self::guard_is_met). While a guarded step is held up,
    /// others may go on.
    pub fn next_guarded(&self, known: &BTreeSet<StepIndex>) -> Option<(StepIndex, &Step)> {
        self.first_of(self.permitted().into_iter().filter(|step| self.is_guard_met(*step, known)))
    }

    /// The alternatives, by their numbers, that could be tried when the task of this step has failed for good.
    pub fn alternatives_for(&self, step: StepIndex) -> impl Iterator<Item = (usize, &Alternative)> {
        self.plan.alternatives.iter().enumerate().filter(move |(_, other)| other.replaces.contains(&step))
    }

    /// All tasks of an alternative were done instead: the steps that it replaces have ended.
    ///
    /// # Errors
    /// [`NotPermitted`] if there is no such alternative or none of its steps could be performed; nothing is changed.
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

    /// A signal has arrived. Returns whether that is news: a signal that was heard before, or that is not for this plan,
    /// changes nothing.
    pub fn receive(&mut self, signal: &Signal) -> bool {
        let wait = waits(&self.plan).find(|(_, awaited)| *awaited == signal).map(|(step, _)| step);
        wait.is_some_and(|step| self.heard.insert(step))
    }

    /// The signals whose time has come and which have not been heard: what to ask others for.
    pub fn awaited_signals(&self) -> Vec<&Signal> {
        self.open()
            .filter_map(|(index, step)| match &step.action {
                StepAction::Wait(signal) if !self.heard.contains(&index) => Some(signal),
                StepAction::Wait(_) | StepAction::Send(_) | StepAction::Task { .. } => None,
            })
            .collect()
    }

    /// The steps that have not ended, of which all `after` have.
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
