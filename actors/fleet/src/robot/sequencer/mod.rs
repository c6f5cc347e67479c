//! Selection of the next step of a local plan (Algorithm 2 of the thesis), as a value.

mod alternatives;
mod outcomes;
mod parked_signals;
mod role_awards;
#[cfg(test)]
mod tests;

pub use alternatives::AlternativeProgress;
pub(crate) use role_awards::StaleSignal;

use alternatives::{alternative, alternative_task};
use consort_bus::Author;
use consort_protocol::ids::{RobotId, RoleId, TaskId};
use consort_protocol::lease::{Epoch, RoleHolder};
use consort_protocol::mission::{TaskOutcome, TaskOutcomes, TaskSpec};
use consort_protocol::plan::{LocalPlan, PlanProgress, ProgressError, Signal, SignalKind, Step, StepAction, StepIndex};
use consort_protocol::scalar::Scalar;
use outcomes::Outcomes;
use parked_signals::{ParkedSignal, ParkedSignals};
use role_awards::{RoleAwards, SignalCheck};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// A plan in execution: ended steps, current task, next step.
#[derive(Debug, Clone)]
pub struct Sequencer {
    progress: PlanProgress,
    /// The current task.
    running: Option<StepRef>,
    alternatives: AlternativeProgress,
    /// Steps that the ledger is known to contain as ended.
    recorded: BTreeSet<StepIndex>,
    /// Holders of the mission's managed roles.
    roles: RoleAwards,
    /// Signals that this role has sent.
    sent: BTreeSet<Signal>,
    /// Received signals that await a confirmation by the coordinator.
    parked: ParkedSignals,
    outcomes: Outcomes,
}

/// Progress of a role that its holder has stored.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct OwnProgress {
    /// Steps that have ended.
    pub ended: BTreeSet<StepIndex>,
    /// Alternatives that were tried or are in use.
    pub alternatives: AlternativeProgress,
    /// Outcomes of tasks of the role.
    pub outcomes: TaskOutcomes,
}

/// Effect of a received signal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SignalEffect {
    /// The signal was awaited and is new.
    Received,
    /// The signal is known already, not awaited, or not by the holder of the sending role; or other
    /// signals await a confirmation, too.
    None,
    /// The signal counts once the coordinator has confirmed it, or the award of its sender: the
    /// coordinator should be queried.
    AwaitsConfirmation,
}

/// Reference to a task within a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum StepRef {
    /// A step of the plan.
    Step(StepIndex),
    /// A task of an alternative.
    Alternative {
        /// Index of the alternative.
        alternative: usize,
        /// Index of the task within the alternative.
        task: usize,
    },
}

/// Next action for the caller.
#[expect(clippy::large_enum_variant, reason = "the caller performs an action at once; none is stored")]
#[derive(Debug, Clone, PartialEq)]
pub enum SequencerAction {
    /// Start a task.
    StartTask {
        /// Position of the task in the plan.
        step: StepRef,
        /// Its id.
        task: TaskId,
        /// Its specification.
        spec: TaskSpec,
    },
    /// Send a signal to another role.
    SendSignal(Signal),
    /// An awaited signal has arrived.
    SignalReceived(Signal),
    /// A task was skipped: its condition does not hold.
    TaskSkipped(TaskId),
    /// The current task cannot start: its condition or a parameter uses an unknown result.
    ResultUnknown {
        /// Its id.
        task: TaskId,
        /// Description of the problem.
        cause: String,
    },
}

impl Sequencer {
    /// Starts a plan with the steps that the ledger contains as ended.
    ///
    /// # Errors
    /// [`ProgressError`] if these steps cannot have ended in this order.
    pub fn new(
        plan: LocalPlan,
        ended: &BTreeSet<StepIndex>,
        holders: BTreeMap<RoleId, RoleHolder>,
    ) -> Result<Sequencer, ProgressError> {
        let own = OwnProgress::default();
        Sequencer::resume(plan, ended, own, holders)
    }

    /// Resumes a plan after a restart. The checkpoint (`own`) may be ahead of the ledger
    /// (`recorded`), or behind it.
    ///
    /// # Errors
    /// Same as [`new`](Sequencer::new).
    pub fn resume(
        plan: LocalPlan,
        recorded: &BTreeSet<StepIndex>,
        own: OwnProgress,
        holders: BTreeMap<RoleId, RoleHolder>,
    ) -> Result<Sequencer, ProgressError> {
        let OwnProgress { ended: own, alternatives, outcomes } = own;
        let ended: BTreeSet<StepIndex> = recorded.union(&own).copied().collect();
        let sent = ended.iter().filter_map(|step| match &plan.steps.get(*step as usize)?.action {
            StepAction::Send(signal) => Some(signal.clone()),
            StepAction::Wait(_) | StepAction::Task { .. } => None,
        });
        let sent = sent.collect();
        let progress = PlanProgress::restore(plan, ended, BTreeSet::new())?;
        let alternatives = alternatives.restore(&progress);
        let roles = RoleAwards::new(holders);
        let recorded = recorded.clone();
        let parked = ParkedSignals::default();
        let outcomes = Outcomes::new(progress.plan(), outcomes);
        Ok(Sequencer { progress, running: None, alternatives, recorded, roles, sent, parked, outcomes })
    }

    /// Returns the next action, which the caller performs at once. Returns `None` while a task is
    /// running, and while every open step waits: for a signal, for the ledger, or for a holder of
    /// another role that the task names. Sending and receiving a signal end with the return; a task
    /// ends with [`end_task`](Sequencer::end_task).
    pub fn next_action(&mut self) -> Option<SequencerAction> {
        if self.running.is_some() {
            return None;
        }
        let may_start = |step| self.progress.is_guard_met(step, &self.recorded) && self.outcomes.are_known_for(step);
        let next = self.progress.next_where(may_start).map(|(index, step)| (index, step.action.clone()));
        match next {
            Some((step, StepAction::Send(signal))) if signal.kind == SignalKind::Done => {
                Some(self.send_signal(step, signal))
            }
            Some((step, StepAction::Wait(signal))) => {
                self.finish(step);
                Some(SequencerAction::SignalReceived(signal))
            }
            // The current alternative takes precedence over all other tasks until it has ended.
            _ if self.alternatives.current().is_some() => self.next_alternative_task(),
            Some((step, StepAction::Send(signal))) => Some(self.send_signal(step, signal)),
            Some((step, StepAction::Task { id, spec })) => self.start_or_skip_task(step, id, spec),
            None => None,
        }
    }

    fn send_signal(&mut self, step: StepIndex, signal: Signal) -> SequencerAction {
        self.finish(step);
        self.sent.insert(signal.clone());
        SequencerAction::SendSignal(signal)
    }

    fn next_alternative_task(&mut self) -> Option<SequencerAction> {
        let (alternative, task) = self.alternatives.current()?;
        let (id, spec) = alternative_task(self.progress.plan(), alternative, task)?;
        let (id, spec) = (id.clone(), spec.clone());
        self.start_task(StepRef::Alternative { alternative, task }, id, spec)
    }

    fn start_task(&mut self, step: StepRef, task: TaskId, spec: TaskSpec) -> Option<SequencerAction> {
        if self.roles.names_vacant_role(&spec) {
            return None;
        }
        self.running = Some(step);
        Some(SequencerAction::StartTask { step, task, spec })
    }

    fn start_or_skip_task(&mut self, step: StepIndex, task: TaskId, mut spec: TaskSpec) -> Option<SequencerAction> {
        let outcomes = self.outcomes.recorded();
        let ready = match spec.conditions_hold(outcomes) {
            Ok(true) => spec.set_inputs(outcomes),
            Ok(false) => {
                self.finish(step);
                self.outcomes.add(task.clone(), TaskOutcome::Skipped);
                return Some(SequencerAction::TaskSkipped(task));
            }
            Err(problem) => Err(problem),
        };
        match ready {
            Ok(()) => self.start_task(StepRef::Step(step), task, spec),
            Err(cause) => {
                self.running = Some(StepRef::Step(step));
                Some(SequencerAction::ResultUnknown { task, cause })
            }
        }
    }

    fn finish(&mut self, step: StepIndex) {
        self.progress.end(step).expect("a returned step may end");
    }

    /// Marks the current task as succeeded, with its results.
    pub fn end_task(&mut self, step: StepRef, results: BTreeMap<String, Scalar>) {
        let task = self.current_task().cloned();
        if self.running.take_if(|running| *running == step).is_none() {
            return;
        }
        match step {
            StepRef::Step(step) => {
                self.finish(step);
                if let Some(task) = task.filter(|_| !results.is_empty()) {
                    self.outcomes.add(task, TaskOutcome::Done(results).limited());
                }
            }
            StepRef::Alternative { alternative, task } => {
                self.alternatives.end_task(alternative, task, &mut self.progress);
            }
        }
    }

    /// Aborts the current task. It starts again when the plan continues.
    pub fn abort_task(&mut self) {
        self.running = None;
    }

    /// Replaces the failed current task by the first alternative, in the order of the plan, that
    /// has not been started yet. Returns the index of the alternative. Returns `None` if there is
    /// none; the task is then only aborted.
    pub fn switch_to_alternative(&mut self) -> Option<usize> {
        let failed = self.running.take()?;
        let replaced_steps = match failed {
            StepRef::Step(step) => BTreeSet::from([step]),
            StepRef::Alternative { alternative: number, .. } => {
                alternative(self.progress.plan(), number)?.replaces.clone()
            }
        };
        self.alternatives.start_for(&replaced_steps, &self.progress)
    }

    /// Receives a signal that another role sent under the award of `epoch`. Only signals of the
    /// confirmed holder count. Those under a later award wait for [`Sequencer::set_holders`].
    ///
    /// # Errors
    /// [`StaleSignal`] if a later award of the sending role is known: the role has another holder.
    /// The state is unchanged.
    pub(crate) fn receive_signal(
        &mut self,
        signal: &Signal,
        epoch: Epoch,
        author: &Author,
    ) -> Result<SignalEffect, StaleSignal> {
        Ok(match self.roles.check_signal(&signal.from, epoch, author)? {
            SignalCheck::Valid if self.progress.receive(signal) => SignalEffect::Received,
            SignalCheck::Valid | SignalCheck::Foreign => SignalEffect::None,
            SignalCheck::OfPerson if self.progress.awaited_signals().contains(&signal) => {
                SignalEffect::AwaitsConfirmation
            }
            SignalCheck::OfPerson => SignalEffect::None,
            SignalCheck::Unconfirmed => {
                let parked = ParkedSignal { signal: signal.clone(), epoch, author: author.clone() };
                if self.parked.park(parked) { SignalEffect::AwaitsConfirmation } else { SignalEffect::None }
            }
        })
    }

    /// Receives signals that the ledger contains as sent to this role. Their sender may be gone.
    pub fn receive_recorded(&mut self, signals: &BTreeSet<Signal>) {
        for signal in signals {
            self.progress.receive(signal);
        }
    }

    /// Returns the current task and its specification.
    pub(crate) fn current_step(&self) -> Option<(StepRef, &TaskId, &TaskSpec)> {
        let step = self.running?;
        let (id, spec) = match step {
            StepRef::Step(step) => match &self.progress.step(step)?.action {
                StepAction::Task { id, spec } => (id, spec),
                StepAction::Send(_) | StepAction::Wait(_) => return None,
            },
            StepRef::Alternative { alternative, task } => alternative_task(self.progress.plan(), alternative, task)?,
        };
        Some((step, id, spec))
    }

    /// Returns the id of the current task.
    pub(crate) fn current_task(&self) -> Option<&TaskId> {
        self.current_step().map(|(_, id, _)| id)
    }

    /// Returns the remaining work, including the current task, as a plan that can be priced.
    pub fn remaining_plan(&self) -> LocalPlan {
        let plan = self.progress.plan();
        let (tasks, replaced) = self.alternatives.remaining(plan);
        let first = tasks.iter().map(|(id, spec)| StepAction::Task { id: id.clone(), spec: spec.clone() });
        let open = plan.steps.iter().zip(0..).filter(|(_, step)| {
            !self.progress.ended().contains(step) && replaced.is_none_or(|replaced| !replaced.contains(step))
        });
        let actions = first.chain(open.map(|(step, _)| step.action.clone()));
        let steps = actions.map(|action| Step { action, after: vec![] }).collect();
        LocalPlan::of(plan.role.clone(), steps)
    }

    /// Checks whether this role may have received an item: a guarded step has ended. An item that
    /// was handed on still counts, because the plan does not contain the recipient.
    pub(crate) fn may_have_custody(&self) -> bool {
        !self.progress.plan().guarded.is_disjoint(self.progress.ended())
    }

    /// Checks whether this role has received an item, or may receive one without a further step of this robot: for all that
    /// the ledger knows, a guarded step has begun.
    pub(crate) fn may_receive_item(&self) -> bool {
        let (plan, ended) = (self.progress.plan(), self.progress.ended());
        let before = |guarded: &StepIndex| plan.steps.get(*guarded as usize).map_or(&[][..], |step| &step.after);
        plan.guarded.iter().any(|guarded| before(guarded).iter().all(|step| ended.contains(step)))
    }

    /// Checks whether no step has ended, so that another robot can do the role from its start.
    pub(crate) fn is_untouched(&self) -> bool {
        self.progress.ended().is_empty()
    }

    /// Checks whether another robot can do the role from its start: no signal has been sent, and this role cannot
    /// have received an item.
    pub(crate) fn can_be_restarted(&self) -> bool {
        !self.may_have_custody() && !self.ended_actions().any(|action| matches!(action, StepAction::Send(_)))
    }

    /// Checks whether a task has ended.
    pub(crate) fn has_ended_task(&self) -> bool {
        self.ended_actions().any(|action| matches!(action, StepAction::Task { .. }))
    }

    /// Returns the actions of the ended steps.
    fn ended_actions(&self) -> impl Iterator<Item = &StepAction> {
        let steps = &self.progress.plan().steps;
        self.progress.ended().iter().filter_map(move |step| Some(&steps.get(*step as usize)?.action))
    }

    /// Returns the tasks of an alternative.
    pub(crate) fn alternative_tasks(&self, number: usize) -> Vec<TaskId> {
        let tasks = alternative(self.progress.plan(), number).map_or(&[][..], |replacement| &replacement.tasks);
        tasks.iter().map(|(id, _)| id.clone()).collect()
    }

    /// Returns the signals that this role still needs and has not received.
    pub fn awaited_signals(&self) -> BTreeSet<Signal> {
        self.progress.awaited_signals().into_iter().cloned().collect()
    }

    /// Checks whether the next step is blocked only because the ledger is not yet known to contain
    /// the ended steps.
    pub fn awaits_ledger(&self) -> bool {
        let waits = |step: &StepIndex| {
            !self.progress.is_guard_met(*step, &self.recorded) || !self.outcomes.are_known_for(*step)
        };
        self.running.is_none() && self.progress.permitted().iter().any(waits)
    }

    /// Marks steps as ended in the ledger.
    pub fn set_recorded(&mut self, ended: &BTreeSet<StepIndex>) {
        self.recorded.extend(ended);
    }

    /// Updates the outcomes of tasks, as in the ledger.
    pub fn set_recorded_outcomes(&mut self, outcomes: TaskOutcomes) {
        self.outcomes.set_recorded(outcomes);
    }

    /// Returns the outcomes of tasks of this role.
    pub(crate) fn own_outcomes(&self) -> &TaskOutcomes {
        self.outcomes.own()
    }

    /// Returns the progress for a checkpoint.
    pub(crate) fn own_progress(&self) -> OwnProgress {
        let (ended, alternatives) = (self.progress.ended().clone(), self.alternatives.clone());
        OwnProgress { ended, alternatives, outcomes: self.outcomes.own().clone() }
    }

    /// Returns the steps that have ended.
    pub fn ended(&self) -> &BTreeSet<StepIndex> {
        self.progress.ended()
    }

    /// Returns the signals that this role has sent.
    pub(crate) fn sent_signals(&self) -> &BTreeSet<Signal> {
        &self.sent
    }

    /// Checks whether every step has ended.
    #[cfg(test)]
    fn is_complete(&self) -> bool {
        self.progress.is_complete()
    }

    /// Updates the holders of the managed roles, as confirmed by the coordinator. Signals of a
    /// former holder that were not yet acted on are discarded, because its successor sends the
    /// valid ones again; parked signals of the successor are received. Returns true if a signal was
    /// discarded: the successor should then be queried.
    pub(crate) fn set_holders(&mut self, holders: BTreeMap<RoleId, RoleHolder>) -> bool {
        let changed = self.roles.set_holders(holders);
        let discarded =
            changed.iter().fold(false, |discarded, role| self.progress.discard_signals_from(role) | discarded);
        for ParkedSignal { signal, epoch, author } in self.parked.take() {
            // A signal that is stale by now is of no use.
            let _ = self.receive_signal(&signal, epoch, &author);
        }
        discarded
    }

    /// Updates the managed roles without a holder; some may never have been held. Call
    /// [`set_holders`](Sequencer::set_holders) first.
    pub(crate) fn set_vacant_roles(&mut self, vacant: &BTreeSet<RoleId>) {
        self.roles.set_vacant_roles(vacant);
    }

    /// Returns the robots that hold the managed roles.
    pub(crate) fn holder_robots(&self) -> BTreeMap<RoleId, RobotId> {
        self.roles.robots()
    }
}
