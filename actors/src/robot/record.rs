//! Keeping the notebook: when a page is written, and what follows from that it was, or could not be.

use super::actor::{RobotMessage, RobotState};
use super::ladder::Setback;
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
    pub(super) fn write_down(&mut self, myself: &ActorRef<RobotMessage>) {
        if self.writing {
            return;
        }
        let may_try = self.may_try_notebook();
        let page = match &mut self.job {
            Some(job) => match job.pen.begin() {
                true => Some(job.page().write()),
                false => return,
            },
            None if self.page_written && self.recalled.is_none() && may_try => None,
            None => return,
        };
        self.notebook_tried_at = self.settings.clock.now();
        self.writing = true;
        self.page_written = page.is_some();
        let (notebook, to) = (self.settings.notebook.clone(), myself.clone());
        self.tasks.spawn(async move {
            let result = notebook.write(page).await;
            // A robot that has stopped has nothing more to tell.
            let _ = to.cast(RobotMessage::Written(result));
        });
    }

    pub(super) async fn written(
        &mut self,
        myself: &ActorRef<RobotMessage>,
        result: io::Result<()>,
    ) -> Result<(), ActorProcessingErr> {
        self.writing = false;
        let ours = self.job.as_ref().is_some_and(|job| job.pen.is_writing());
        match result {
            Ok(()) => {
                debug!(robot = %self.settings.robot, "its notebook is up to date");
                self.notebook_problem = None;
                if let Some(job) = self.job.as_mut().filter(|_| ours) {
                    job.on_record = true;
                }
            }
            Err(problem) => {
                warn!(robot = %self.settings.robot, %problem, "its notebook was not written");
                self.notebook_problem = Some(problem.to_string());
                // The former page is still there.
                self.page_written = true;
            }
        }
        if let Some(job) = &mut self.job {
            job.pen.done();
        }
        let unwritten = self.job.as_ref().is_some_and(|job| ours && !job.on_record && job.surrender.is_none());
        if let Some(why) = self.notebook_problem.as_ref().filter(|_| unwritten) {
            // Nothing was begun: another robot can keep what this one could only promise. A role that was on record is
            // carried out all the same: what the next life lacks, the ledger has, or else nobody acted on it.
            let (kind, cause) = (FailureKind::Notebook, format!("its notebook cannot be written: {why}"));
            self.fall_back(myself, Setback { kind, cause, lasting: true });
            self.report(myself);
        }
        let now = self.settings.clock.now();
        self.sense(now);
        self.advance(myself).await
    }

    /// Whether the notebook is in order, or it is time to see whether it is again.
    fn may_try_notebook(&self) -> bool {
        let since = self.settings.clock.now().since(self.notebook_tried_at);
        self.notebook_problem.is_none() || since >= NOTEBOOK_TRIED_EVERY
    }
}
