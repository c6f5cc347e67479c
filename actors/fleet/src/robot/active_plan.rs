//! The active plan of a robot.

use super::checkpoint::Checkpoint;
use super::checkpoint_writer::CheckpointWriter;
use super::recovery_policy::RecoveryPolicy;
use super::release::PendingRelease;
use super::sequencer::{Sequencer, StepRef};
use super::signals::StaleSignals;
use super::skill_runner::RunnerMessage;
use super::task_timeout::TaskTimer;
use consort_bus::tasks::Tasks;
use consort_protocol::ids::{MissionId, RoleId};
use consort_protocol::lease::Award;
use consort_protocol::units::NodeTime;
use consort_skills::actions::GoalId;
use ractor::ActorRef;

/// The active plan of a robot.
pub(super) struct ActivePlan {
    pub(super) award: Award,
    pub(super) sequencer: Sequencer,
    pub(super) recovery_policy: RecoveryPolicy,
    pub(super) checkpoint_writer: CheckpointWriter,
    /// The attempt in progress.
    pub(super) attempt: Option<TaskAttempt>,
    /// Earliest start of the next task: the robot pauses between two attempts.
    pub(super) retry_at: NodeTime,
    /// A checkpoint of this award is stored. No task starts without it.
    pub(super) has_checkpoint: bool,
    /// Reason for the release of the role. From then on the robot only waits for the end of the
    /// award.
    pub(super) pending_release: Option<PendingRelease>,
    /// First goal of the driver that belongs to the current task, or to the next task.
    pub(super) first_goal: GoalId,
    /// The event about insufficient charge was published.
    pub(super) energy_warning_sent: bool,
    /// Signals received under awards no longer in force; each is reported once.
    pub(super) stale_signals: StaleSignals,
    pub(super) _subscriptions: Tasks,
}

/// A running skill.
pub(super) struct TaskAttempt {
    /// Number of the skill run.
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
        let (ended, alternatives) = (self.sequencer.ended().clone(), self.sequencer.alternative_progress().clone());
        Checkpoint { award: self.award.clone(), ended, alternatives, first_goal: self.first_goal }
    }

    /// Stops the attempt safely, if there is any.
    pub(super) fn stop(&mut self) {
        if let Some(attempt) = self.attempt.take() {
            // A skill that has just ended ignores this.
            let _ = attempt.runner.cast(RunnerMessage::Halt);
        }
    }
}
