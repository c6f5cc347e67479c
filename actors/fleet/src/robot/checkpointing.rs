//! Checkpointing: when a checkpoint is written, and the reaction to success and failure.

use super::actor::{RobotMessage, RobotState};
use super::recovery_policy::AttemptFailure;
use consort_protocol::message::FailureKind;
use ractor::{ActorProcessingErr, ActorRef};
use std::io;
use std::time::Duration;
use tracing::{debug, warn};

/// Retry interval for a failed checkpoint write while the robot holds no role.
const WRITE_RETRY_INTERVAL: Duration = Duration::from_secs(1);

impl RobotState {
    /// Writes the checkpoint if it is outdated, with at most 1 write in progress. Without a role,
    /// the checkpoint is deleted. The mailbox does not wait for the disk: a lease may expire
    /// meanwhile.
    pub(super) fn write_checkpoint(&mut self, myself: &ActorRef<RobotMessage>) {
        if self.checkpoint_in_flight {
            return;
        }
        let may_write = self.may_write();
        let checkpoint = match &mut self.active_plan {
            Some(active) => match active.checkpoint_writer.start_write() {
                true => Some(active.checkpoint().encode()),
                false => return,
            },
            None if self.checkpoint_exists && self.restored.is_none() && may_write => None,
            None => return,
        };
        self.checkpoint_tried_at = self.settings.clock.now();
        self.checkpoint_in_flight = true;
        self.checkpoint_exists = checkpoint.is_some();
        let (store, to) = (self.settings.checkpoint_store.clone(), myself.clone());
        self.tasks.spawn(async move {
            let result = store.write(checkpoint).await;
            // A stopped robot needs no result.
            let _ = to.cast(RobotMessage::CheckpointWritten(result));
        });
    }

    pub(super) async fn handle_checkpoint_written(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        result: io::Result<()>,
    ) -> Result<(), ActorProcessingErr> {
        self.checkpoint_in_flight = false;
        let is_for_plan = self.active_plan.as_ref().is_some_and(|active| active.checkpoint_writer.is_writing());
        match result {
            Ok(()) => {
                debug!(robot = %self.settings.robot, "checkpoint written");
                self.checkpoint_error = None;
                if let Some(active) = self.active_plan.as_mut().filter(|_| is_for_plan) {
                    active.has_checkpoint = true;
                }
            }
            Err(problem) => {
                warn!(robot = %self.settings.robot, %problem, "checkpoint was not written");
                self.checkpoint_error = Some(problem.to_string());
                // The previous checkpoint is still stored.
                self.checkpoint_exists = true;
            }
        }
        if let Some(active) = &mut self.active_plan {
            active.checkpoint_writer.finish_write();
        }
        let lacks_checkpoint = self
            .active_plan
            .as_ref()
            .is_some_and(|active| is_for_plan && !active.has_checkpoint && active.pending_release.is_none());
        if let Some(why) = self.checkpoint_error.as_ref().filter(|_| lacks_checkpoint) {
            // No step has started, so another robot can take the role with a checkpoint. A role
            // that already has a checkpoint continues: the ledger contains the steps that the next
            // incarnation lacks, or no other node has acted on them.
            let (kind, cause) = (FailureKind::Checkpoint, format!("its checkpoint cannot be written: {why}"));
            self.recover(myself, AttemptFailure { kind, cause, permanent: true });
            self.report(myself);
        }
        let now = self.settings.clock.now();
        self.update_worker(now);
        self.advance(myself).await
    }

    /// Checks whether the store works, or the next attempt to write is due.
    fn may_write(&self) -> bool {
        let since = self.settings.clock.now().since(self.checkpoint_tried_at);
        self.checkpoint_error.is_none() || since >= WRITE_RETRY_INTERVAL
    }
}
