//! The plan under way, as the robot holds it in its hands.

use super::checkpoint::Checkpoint;
use super::checkpoint_writer::CheckpointWriter;
use super::recovery_policy::RecoveryPolicy;
use super::release::PendingRelease;
use super::sequencer::{Sequencer, StepRef};
use super::signals::StaleSignals;
use super::skill_runner::RunnerMessage;
use super::task_timeout::TaskTimer;
use crate::tasks::Tasks;
use consort_protocol::ids::{MissionId, RoleId};
use consort_protocol::lease::Award;
use consort_protocol::units::NodeTime;
use consort_skills::actions::GoalId;
use ractor::ActorRef;

/// The plan under way.
pub(super) struct ActivePlan {
    pub(super) award: Award,
    pub(super) sequencer: Sequencer,
    pub(super) recovery_policy: RecoveryPolicy,
    pub(super) checkpoint_writer: CheckpointWriter,
    /// The task that is being done.
    pub(super) attempt: Option<TaskAttempt>,
    /// Nothing is begun before: the robot stands still between two attempts.
    pub(super) retry_at: NodeTime,
    /// Whether the notebook has a page of this award: without one nothing is begun.
    pub(super) has_checkpoint: bool,
    /// Why the role cannot be carried to its end; from then on the robot only waits to put it down.
    pub(super) pending_release: Option<PendingRelease>,
    /// The first goal of the body that belongs to the task under way, or to the next.
    pub(super) first_goal: GoalId,
    /// Whether it was told that the battery falls short.
    pub(super) energy_warning_sent: bool,
    /// What was said under awards no longer in force, so that each is told of once.
    pub(super) stale_signals: StaleSignals,
    pub(super) _subscriptions: Tasks,
}

/// A skill at work.
pub(super) struct TaskAttempt {
    /// Which start of a skill it is.
    pub(super) run: u64,
    pub(super) step: StepRef,
    pub(super) runner: ActorRef<RunnerMessage>,
    pub(super) timer: TaskTimer,
}

impl ActivePlan {
    pub(super) fn mission_and_role(&self) -> (MissionId, RoleId) {
        (self.award.mission.clone(), self.award.role.clone())
    }

    pub(super) fn checkpoint(&self) -> Checkpoint {
        let (ended, detours) = (self.sequencer.ended().clone(), self.sequencer.alternative_progress().clone());
        Checkpoint { award: self.award.clone(), ended, alternatives: detours, first_goal: self.first_goal }
    }

    /// Stops the body safely, if it is at work.
    pub(super) fn stop(&mut self) {
        if let Some(attempt) = self.attempt.take() {
            // One that has just ended by itself needs no halting.
            let _ = attempt.runner.cast(RunnerMessage::Halt);
        }
    }
}
