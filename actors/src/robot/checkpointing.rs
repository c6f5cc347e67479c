//! Keeping the notebook: when a page is written, and what follows from that it was, or could not be.

use super::actor::{RobotMessage, RobotState};
use super::recovery_policy::AttemptFailure;
use consort_protocol::message::FailureKind;
use ractor::{ActorProcessingErr, ActorRef};
use std::io;
use std::time::Duration;
use tracing::{debug, warn};

/// How often a robot without a role looks whether a notebook that could not be written can be again.
const NOTEBOOK_TRIED_EVERY: Duration = Duration::from_secs(1);

impl RobotState {
    /// Brings the notebook up to date, one page at a time; without a role its page is torn out. The mailbox does not wait for
    /// the disk: a lease may run out meanwhile.
    pub(super) fn write_checkpoint(&mut self, myself: &ActorRef<RobotMessage>) {
        if self.checkpoint_in_flight {
            return;
        }
        let may_try = self.may_try_notebook();
        let page = match &mut self.active_plan {
            Some(job) => match job.checkpoint_writer.start_write() {
                true => Some(job.checkpoint().encode()),
                false => return,
            },
            None if self.checkpoint_exists && self.restored.is_none() && may_try => None,
            None => return,
        };
        self.checkpoint_tried_at = self.settings.clock.now();
        self.checkpoint_in_flight = true;
        self.checkpoint_exists = page.is_some();
        let (notebook, to) = (self.settings.checkpoint_store.clone(), myself.clone());
        self.tasks.spawn(async move {
            let result = notebook.write(page).await;
            // A robot that has stopped has nothing more to tell.
            let _ = to.cast(RobotMessage::CheckpointWritten(result));
        });
    }

    pub(super) async fn handle_checkpoint_written(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        result: io::Result<()>,
    ) -> Result<(), ActorProcessingErr> {
        self.checkpoint_in_flight = false;
        let ours = self.active_plan.as_ref().is_some_and(|job| job.checkpoint_writer.is_writing());
        match result {
            Ok(()) => {
                debug!(robot = %self.settings.robot, "its notebook is up to date");
                self.checkpoint_error = None;
                if let Some(job) = self.active_plan.as_mut().filter(|_| ours) {
                    job.has_checkpoint = true;
                }
            }
            Err(problem) => {
                warn!(robot = %self.settings.robot, %problem, "its notebook was not written");
                self.checkpoint_error = Some(problem.to_string());
                // The former page is still there.
                self.checkpoint_exists = true;
            }
        }
        if let Some(job) = &mut self.active_plan {
            job.checkpoint_writer.finish_write();
        }
        let unwritten =
            self.active_plan.as_ref().is_some_and(|job| ours && !job.has_checkpoint && job.pending_release.is_none());
        if let Some(why) = self.checkpoint_error.as_ref().filter(|_| unwritten) {
            // Nothing was begun: another robot can keep what this one could only promise. A role that was on record is
            // carried out all the same: what the next life lacks, the ledger has, or else nobody acted on it.
            let (kind, cause) = (FailureKind::Notebook, format!("its notebook cannot be written: {why}"));
            self.recover(myself, AttemptFailure { kind, cause, permanent: true });
            self.report(myself);
        }
        let now = self.settings.clock.now();
        self.update_worker(now);
        self.advance(myself).await
    }

    /// Whether the notebook is in order, or it is time to see whether it is again.
    fn may_try_notebook(&self) -> bool {
        let since = self.settings.clock.now().since(self.checkpoint_tried_at);
        self.checkpoint_error.is_none() || since >= NOTEBOOK_TRIED_EVERY
    }
}
