//! The active plan of a robot, as a value: the plan of an award, and the decisions about its next
//! step, its failures and its checkpoint.

use super::checkpoint::Checkpoint;
use super::checkpoint_writer::{CheckpointWriter, PendingOutput};
use super::own_tasks::{drive_to, is_drive};
use super::recovery_policy::{AttemptFailure, RecoveryAction, RecoveryPolicy};
use super::release::{DriverActivity, PendingRelease};
use super::sequencer::{Sequencer, SequencerAction, StepRef};
use super::signals::StaleSignals;
use super::skill_runner::RunningSkill;
use super::task_timeout::TaskTimer;
use consort_bus::tasks::Tasks;
use consort_protocol::cause::CauseClass;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, PlaceId, RoleId, TaskId};
use consort_protocol::lease::{Award, RoleHolder};
use consort_protocol::message::{FailureKind, TaskFailure};
use consort_protocol::mission::TaskSpec;
use consort_protocol::plan::{LocalPlan, Signal, Step, StepAction, StepIndex};
use consort_protocol::scalar::Scalar;
use consort_protocol::units::{NodeTime, WorldTime};
use consort_skills::actions::GoalId;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tracing::warn;

/// The active plan of a robot.
pub(super) struct ActivePlan {
    pub(super) award: Award,
    pub(super) sequencer: Sequencer,
    /// The attempt in progress.
    pub(super) attempt: Option<TaskAttempt>,
    recovery: Recovery,
    checkpoint: PlanCheckpoint,
    /// The suspended task is a drive, which can go on from anywhere.
    has_suspended_drive: bool,
    /// Place that the robot left for an assembly place, and where the plan goes on.
    left: Option<PlaceId>,
    /// Signals received under awards no longer in force; each is reported once.
    pub(super) stale_signals: StaleSignals,
    /// Subscription to the signals of other roles.
    pub(super) subscriptions: Tasks,
}

/// A running skill.
pub(super) struct TaskAttempt {
    pub(super) step: StepRef,
    pub(super) skill: RunningSkill,
    pub(super) timer: TaskTimer,
}

/// Recovery of a plan from failures.
struct Recovery {
    policy: RecoveryPolicy,
    /// Earliest start of the next task: the robot pauses between two attempts.
    retry_at: NodeTime,
    /// Reason for the release of the role. From then on the robot only waits for the end of the
    /// award.
    release: Option<PendingRelease>,
    /// The event about insufficient charge was published.
    energy_warning_sent: bool,
}

/// Checkpoint of a plan.
struct PlanCheckpoint {
    writer: CheckpointWriter,
    /// A checkpoint of this award is stored. No task starts without it.
    is_stored: bool,
    /// First goal of the driver that belongs to the current task, or to the next task.
    first_goal: GoalId,
}

/// State from which a plan starts.
pub(super) struct PlanStart<'a> {
    pub(super) award: Award,
    /// Steps that the ledger contains as ended.
    pub(super) recorded: &'a BTreeSet<StepIndex>,
    pub(super) holders: BTreeMap<RoleId, RoleHolder>,
    /// Checkpoint of this award, written by the previous incarnation.
    pub(super) restored: Option<Checkpoint>,
    /// Next goal of the driver.
    pub(super) next_goal: GoalId,
}

/// Next action of a plan.
#[expect(clippy::large_enum_variant, reason = "the caller performs an action at once; none is stored")]
#[derive(Debug, PartialEq)]
pub(super) enum PlanAction {
    /// Send the outputs of steps that the checkpoint contains.
    Emit(Vec<PendingOutput>),
    /// Start a task.
    StartTask {
        /// Position of the task in the plan.
        step: StepRef,
        task: TaskId,
        spec: TaskSpec,
    },
    /// Publish that an awaited signal has arrived.
    ReportReceived(Signal),
    /// Drive back to the place that the robot left.
    ReturnTo(PlaceId),
    /// Give up the current task, which cannot start.
    Fail(AttemptFailure),
}

/// Effect of a failure on the plan.
#[derive(Debug, PartialEq)]
pub(super) enum RecoveryEffect {
    /// The task is retried after the delay.
    Retry(Duration, EventKind),
    /// The role is released.
    Release(EventKind),
    /// An alternative replaces the task. Its event waits for the checkpoint.
    Alternative,
}

/// Effect of a charge that will not last for the remaining plan.
#[derive(Debug, PartialEq)]
pub(super) enum ShortfallEffect {
    /// Another robot can still take over: the role is released.
    Fail(AttemptFailure),
    /// The robot may carry an item and continues, because a release would not help. The event is
    /// published once.
    Continue(Option<EventKind>),
}

impl ActivePlan {
    /// Starts a plan, or continues it from the checkpoint. Returns also the reason to release the
    /// role at once, if the recorded steps do not fit the plan. Returns `None` for an invalid plan.
    pub(super) fn start(start: PlanStart<'_>) -> Option<(ActivePlan, Option<TaskFailure>)> {
        let PlanStart { award, recorded, holders, restored, next_goal } = start;
        let up_to_date = restored.as_ref().filter(|checkpoint| !checkpoint.misses_ended_task(recorded));
        let first_goal = up_to_date.map_or(next_goal, |checkpoint| checkpoint.first_goal);
        let is_stored = restored.is_some();
        let left = restored.as_ref().and_then(|checkpoint| checkpoint.left.clone());
        let own = restored.map(|checkpoint| checkpoint.own).unwrap_or_default();
        let resumed = Sequencer::resume(award.plan.clone(), recorded, own, holders.clone());
        let failure = resumed.as_ref().err().map(|problem| TaskFailure::new(FailureKind::Plan, problem.to_string()));
        let sequencer = resumed.or_else(|_| Sequencer::new(award.plan.clone(), &BTreeSet::new(), holders)).ok()?;
        let mut writer = CheckpointWriter::default();
        writer.mark_outdated();
        let recovery = Recovery {
            policy: RecoveryPolicy::default(),
            retry_at: NodeTime::ZERO,
            release: None,
            energy_warning_sent: false,
        };
        let active = ActivePlan {
            award,
            sequencer,
            attempt: None,
            recovery,
            checkpoint: PlanCheckpoint { writer, is_stored, first_goal },
            has_suspended_drive: false,
            left,
            stale_signals: StaleSignals::new(),
            subscriptions: Tasks::default(),
        };
        Some((active, failure))
    }

    pub(super) fn mission_and_role(&self) -> (MissionId, RoleId) {
        (self.award.mission.clone(), self.award.role.clone())
    }

    /// Returns the next action, which the caller performs at once. Sent signals wait in the
    /// checkpoint writer. Ended steps are checkpointed before the next task starts.
    pub(super) fn next_action(&mut self, now: NodeTime) -> Option<PlanAction> {
        let outputs = self.checkpoint.writer.take_ready();
        if !outputs.is_empty() {
            return Some(PlanAction::Emit(outputs));
        }
        loop {
            if self.is_releasing() || !self.checkpoint.writer.is_idle() || now < self.recovery.retry_at {
                return None;
            }
            if let Some(place) = &self.left {
                return Some(PlanAction::ReturnTo(place.clone()));
            }
            match self.sequencer.next_action()? {
                SequencerAction::StartTask { step, task, spec } => {
                    self.has_suspended_drive = false;
                    return Some(PlanAction::StartTask { step, task, spec });
                }
                SequencerAction::SendSignal(signal) => self.checkpoint.writer.queue(PendingOutput::Signal(signal)),
                SequencerAction::SignalReceived(signal) => return Some(PlanAction::ReportReceived(signal)),
                SequencerAction::TaskSkipped(task) => {
                    let (mission, role) = self.mission_and_role();
                    let event = EventKind::TaskSkipped { mission, role, task };
                    self.checkpoint.writer.queue(PendingOutput::Event(event));
                }
                SequencerAction::ResultUnknown { cause, .. } => {
                    let kind = FailureKind::UnknownResult;
                    // No robot knows more, so the mission fails.
                    let class = CauseClass::Task;
                    return Some(PlanAction::Fail(AttemptFailure { class, ..AttemptFailure::new(kind, cause) }));
                }
            }
        }
    }

    /// Takes the attempt with this number if it is in progress.
    pub(super) fn take_attempt(&mut self, run: u64) -> Option<TaskAttempt> {
        self.attempt.take_if(|attempt| attempt.skill.run() == run)
    }

    /// Marks the current task as succeeded, with its results; later goals belong to the next task.
    pub(super) fn end_task(
        &mut self,
        step: StepRef,
        task: TaskId,
        results: BTreeMap<String, Scalar>,
        next_goal: GoalId,
    ) {
        let (mission, role) = self.mission_and_role();
        self.sequencer.end_task(step, results);
        self.checkpoint.first_goal = next_goal;
        self.checkpoint.writer.queue(PendingOutput::Event(EventKind::TaskEnded { mission, role, task }));
    }

    /// Returns the first goal of the current task, or of the next task.
    pub(super) fn first_goal(&self) -> GoalId {
        self.checkpoint.first_goal
    }

    /// Stops the attempt safely, if there is any.
    pub(super) fn stop(&mut self) {
        if let Some(attempt) = self.attempt.take() {
            attempt.skill.halt();
        }
    }

    /// Suspends the plan: the lease has expired, or a person or an alarm holds the robot.
    pub(super) fn suspend(&mut self) {
        self.stop();
        if let Some((.., task)) = self.sequencer.current_step() {
            self.has_suspended_drive = is_drive(task);
        }
        self.sequencer.abort_task();
    }

    /// Records that the robot leaves this place for an assembly place. Others may expect the robot there, unless its
    /// plan has not begun, or lets it drive.
    pub(super) fn leave(&mut self, place: PlaceId) {
        if self.left.is_none() && !self.has_suspended_drive && !self.sequencer.is_untouched() {
            self.left = Some(place);
            self.checkpoint.writer.mark_outdated();
        }
    }

    /// Returns the place that the robot has left, and where the plan goes on.
    pub(super) fn place_left(&self) -> Option<&PlaceId> {
        self.left.as_ref()
    }

    /// Records that the robot is back at the place that it had left. The plan goes on once this is stored: otherwise a
    /// robot that restarts on its next drive would return again.
    pub(super) fn set_returned(&mut self) {
        self.left = None;
        self.checkpoint.writer.mark_outdated();
    }

    /// Returns the remaining work, with the way back to the place that the robot has left, as a plan that can be
    /// priced.
    pub(super) fn remaining_plan(&self) -> LocalPlan {
        let mut rest = self.sequencer.remaining_plan();
        if let Some(place) = &self.left {
            let id = TaskId::new("return").expect("a slug");
            let action = StepAction::Task { id, spec: drive_to(place) };
            rest.steps.insert(0, Step { action, after: vec![] });
        }
        rest
    }

    /// Checks the time limit of the current task.
    pub(super) fn check_timer(&mut self, world: Option<WorldTime>, silent_for: Duration) -> Option<AttemptFailure> {
        let cause = self.attempt.as_mut()?.timer.check(world, silent_for)?;
        Some(AttemptFailure::new(FailureKind::NoProgress, cause))
    }

    /// Gives the current task at least the time of another timer, which starts now.
    pub(super) fn extend_timer(&mut self, timer: TaskTimer, world: Option<WorldTime>) {
        if let Some(attempt) = &mut self.attempt {
            attempt.timer.extend(timer, world);
        }
    }

    /// Restarts the time limit of the current task: the robot waits for a person.
    pub(super) fn restart_timer(&mut self) {
        self.attempt.iter_mut().for_each(|attempt| attempt.timer.restart());
    }

    /// Handles a failure of the current task or of the whole plan: the recovery policy selects the
    /// next action. Returns `None` if the role is being released already.
    pub(super) fn recover(
        &mut self,
        failure: AttemptFailure,
        retry_delay: Duration,
        now: NodeTime,
    ) -> Option<RecoveryEffect> {
        if self.is_releasing() {
            return None;
        }
        self.stop();
        let ((mission, role), task) = (self.mission_and_role(), self.sequencer.current_task().cloned());
        let cause = failure.cause.clone();
        warn!(robot = %self.award.robot, %mission, ?task, ?failure, "attempt failed");
        match (self.recovery.policy.next_action(failure, &mut self.sequencer), task) {
            (RecoveryAction::ReleaseRole(failure), _) => Some(RecoveryEffect::Release(self.release(failure, now))),
            (RecoveryAction::Retry { attempt, pauses }, Some(task)) => {
                let retry_delay = retry_delay.saturating_mul(pauses);
                self.recovery.retry_at = now + retry_delay;
                let event = EventKind::TaskRetried { mission, role, task, attempt, cause };
                Some(RecoveryEffect::Retry(retry_delay, event))
            }
            (RecoveryAction::UseAlternative { alternative }, Some(task)) => {
                let tasks = self.sequencer.alternative_tasks(alternative);
                let event = EventKind::Alternative { mission, role, task, alternative, tasks, cause };
                self.checkpoint.writer.queue(PendingOutput::Event(event));
                Some(RecoveryEffect::Alternative)
            }
            // Retry and alternative require a current task.
            (RecoveryAction::Retry { .. } | RecoveryAction::UseAlternative { .. }, None) => None,
        }
    }

    /// Stops the plan. From now on the robot only waits until the coordinator has released the
    /// role. Returns the event to be published.
    pub(super) fn release(&mut self, failure: TaskFailure, now: NodeTime) -> EventKind {
        let ((mission, role), TaskFailure { task, cause, kind, class, .. }) =
            (self.mission_and_role(), failure.clone());
        self.recovery.release = Some(PendingRelease::new(failure, now));
        match (kind, task) {
            (
                FailureKind::Task | FailureKind::Crash | FailureKind::NoProgress | FailureKind::UnknownResult,
                Some(task),
            ) => EventKind::TaskFailed { mission, role, task, cause, class },
            _ => EventKind::GaveUp { mission, role, kind, cause },
        }
    }

    /// Checks whether the role is being released.
    pub(super) fn is_releasing(&self) -> bool {
        self.recovery.release.is_some()
    }

    /// Returns the release in progress, for the next report.
    pub(super) fn pending_release(&mut self) -> Option<&mut PendingRelease> {
        self.recovery.release.as_mut()
    }

    /// Decides about a charge that will not last for the remaining plan.
    pub(super) fn handle_shortfall(&mut self, cause: String) -> ShortfallEffect {
        if !self.sequencer.may_have_custody() {
            return ShortfallEffect::Fail(AttemptFailure::new(FailureKind::Battery, cause));
        }
        let is_first = !std::mem::replace(&mut self.recovery.energy_warning_sent, true);
        let (mission, role) = self.mission_and_role();
        ShortfallEffect::Continue(is_first.then_some(EventKind::LowCharge { mission, role, cause }))
    }

    /// Checks whether a report is needed: the next step waits for the ledger, or the reason of the
    /// release can be reported.
    pub(super) fn needs_report(&self, driver: DriverActivity, now: NodeTime) -> bool {
        match &self.recovery.release {
            Some(release) => release.must_report(driver, now),
            None => self.sequencer.awaits_ledger(),
        }
    }

    /// Starts to write the checkpoint if the stored checkpoint is outdated. Returns its content.
    pub(super) fn start_checkpoint(&mut self) -> Option<Checkpoint> {
        if !self.checkpoint.writer.start_write() {
            return None;
        }
        let own = self.sequencer.own_progress();
        let (award, first_goal, left) = (self.award.clone(), self.checkpoint.first_goal, self.left.clone());
        Some(Checkpoint { award, own, first_goal, left })
    }

    /// Ends the write of a checkpoint, which may belong to an earlier plan. Returns true if the
    /// plan cannot start, because it has no checkpoint.
    pub(super) fn finish_checkpoint(&mut self, succeeded: bool) -> bool {
        let is_own = self.checkpoint.writer.is_writing();
        self.checkpoint.is_stored |= is_own && succeeded;
        self.checkpoint.writer.finish_write();
        is_own && !self.checkpoint.is_stored && !self.is_releasing()
    }

    /// Takes all unsent outputs in order, whether or not their steps are stored.
    pub(super) fn take_pending(&mut self) -> Vec<PendingOutput> {
        std::mem::take(&mut self.checkpoint.writer).into_pending()
    }
}

#[cfg(test)]
mod tests;
