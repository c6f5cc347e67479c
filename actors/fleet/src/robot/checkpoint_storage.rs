//! The stored checkpoint of a robot, as a value: when it is written, and the reaction to success
//! and failure.

use super::active_plan::ActivePlan;
use super::checkpoint::Checkpoint;
use super::recovery_policy::AttemptFailure;
use consort_protocol::lease::Epoch;
use consort_protocol::message::FailureKind;
use consort_protocol::units::NodeTime;
use std::io;
use std::time::Duration;

/// Retry interval for a failed checkpoint write while the robot holds no role.
const WRITE_RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// State of the checkpoint store, with at most 1 write in progress.
pub(super) struct CheckpointStorage {
    /// Checkpoint of the previous incarnation, until the coordinator has replied.
    restored: Option<Checkpoint>,
    /// A write is in progress.
    in_flight: bool,
    /// The store contains a checkpoint, or may contain it.
    exists: bool,
    /// Error of the last write, if it failed.
    error: Option<String>,
    /// Time of the last write.
    tried_at: NodeTime,
}

/// Content of a checkpoint write; `None` deletes the checkpoint.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct CheckpointWrite(pub(super) Option<Vec<u8>>);

impl CheckpointStorage {
    /// Creates the state at the start. A stored checkpoint that is not restored will be deleted.
    pub(super) fn new(restored: Option<Checkpoint>, now: NodeTime) -> CheckpointStorage {
        CheckpointStorage { restored, in_flight: false, exists: true, error: None, tried_at: now }
    }

    /// Returns the checkpoint of the previous incarnation.
    pub(super) fn restored(&self) -> Option<&Checkpoint> {
        self.restored.as_ref()
    }

    /// Takes the checkpoint of the previous incarnation if it belongs to this award.
    pub(super) fn take_restored_if(&mut self, epoch: Epoch) -> Option<Checkpoint> {
        self.restored.take_if(|checkpoint| checkpoint.award.epoch == epoch)
    }

    /// Takes the checkpoint of the previous incarnation, to start the plan of an award. A
    /// checkpoint of another award is discarded.
    pub(super) fn take_restored_for(&mut self, epoch: Epoch) -> Option<Checkpoint> {
        self.restored.take().filter(|checkpoint| checkpoint.award.epoch == epoch)
    }

    /// Returns the reason why the robot takes no role: its award could not be checkpointed and
    /// would be lost in a crash.
    pub(super) fn problem(&self) -> Option<String> {
        self.error.as_ref().map(|why| format!("its checkpoint cannot be written: {why}"))
    }

    /// Starts a write if the checkpoint is outdated and no write is in progress. Without a role,
    /// the checkpoint is deleted. The caller writes, and then calls
    /// [`finish_write`](CheckpointStorage::finish_write).
    pub(super) fn start_write(&mut self, plan: Option<&mut ActivePlan>, now: NodeTime) -> Option<CheckpointWrite> {
        if self.in_flight {
            return None;
        }
        let checkpoint = match plan {
            Some(active) => Some(active.start_checkpoint()?.encode()),
            None if self.exists && self.restored.is_none() && self.may_write(now) => None,
            None => return None,
        };
        self.tried_at = now;
        self.in_flight = true;
        self.exists = checkpoint.is_some();
        Some(CheckpointWrite(checkpoint))
    }

    /// Ends the write in progress. Returns the failure of a plan that cannot start for lack of a
    /// checkpoint. No step has started then, so another robot can take the role with a checkpoint.
    /// A role that already has a checkpoint continues: the ledger contains the steps that the next
    /// incarnation lacks, or no other node has acted on them.
    pub(super) fn finish_write(
        &mut self,
        result: io::Result<()>,
        plan: Option<&mut ActivePlan>,
    ) -> Option<AttemptFailure> {
        self.in_flight = false;
        self.error = result.err().map(|problem| problem.to_string());
        if self.error.is_some() {
            // The previous checkpoint is still stored.
            self.exists = true;
        }
        let lacks_checkpoint = plan.is_some_and(|active| active.finish_checkpoint(self.error.is_none()));
        let cause = self.problem().filter(|_| lacks_checkpoint)?;
        Some(AttemptFailure::new(FailureKind::Checkpoint, cause))
    }

    /// Checks whether the store works, or the next attempt to write is due.
    fn may_write(&self, now: NodeTime) -> bool {
        self.error.is_none() || now.since(self.tried_at) >= WRITE_RETRY_INTERVAL
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_values::{at, award, started};
    use super::*;

    fn disk_full() -> io::Result<()> {
        Err(io::Error::other("disk full"))
    }

    #[test]
    fn a_stored_checkpoint_is_deleted_once_the_robot_holds_no_role() {
        let mut storage = CheckpointStorage::new(None, at(0));
        assert_eq!(storage.start_write(None, at(0)), Some(CheckpointWrite(None)));
        assert_eq!(storage.start_write(None, at(10)), None, "a write is in progress");
        assert_eq!(storage.finish_write(disk_full(), None), None);
        assert_eq!(storage.problem().unwrap(), "its checkpoint cannot be written: disk full");
        assert_eq!(storage.start_write(None, at(999)), None, "the next attempt is not due");
        assert_eq!(storage.start_write(None, at(1_000)), Some(CheckpointWrite(None)));
        assert_eq!(storage.finish_write(Ok(()), None), None);
        assert_eq!((storage.problem(), storage.start_write(None, at(9_000))), (None, None));
    }

    #[test]
    fn a_restored_checkpoint_is_kept_until_its_award_ends() {
        let mut active = started(award(7), None);
        let checkpoint = active.start_checkpoint().unwrap();
        let mut storage = CheckpointStorage::new(Some(checkpoint.clone()), at(0));
        assert_eq!(storage.start_write(None, at(0)), None);
        assert_eq!(storage.take_restored_if(award(8).epoch), None);
        assert_eq!(storage.take_restored_if(award(7).epoch), Some(checkpoint.clone()));
        assert_eq!(storage.start_write(None, at(0)), Some(CheckpointWrite(None)));
        let mut storage = CheckpointStorage::new(Some(checkpoint), at(0));
        assert_eq!(storage.take_restored_for(award(8).epoch), None);
        assert_eq!(storage.restored(), None, "the checkpoint of another award is discarded");
    }

    #[test]
    fn a_plan_without_its_first_checkpoint_fails_and_a_later_failure_is_tolerated() {
        let mut storage = CheckpointStorage::new(None, at(0));
        let mut active = started(award(7), None);
        assert!(storage.start_write(Some(&mut active), at(0)).unwrap().0.is_some());
        let failure = storage.finish_write(disk_full(), Some(&mut active)).unwrap();
        assert_eq!(failure.kind, FailureKind::Checkpoint);
        assert_eq!(failure.cause, "its checkpoint cannot be written: disk full");

        let mut resumed = started(award(7), started(award(7), None).start_checkpoint());
        assert!(storage.start_write(Some(&mut resumed), at(0)).is_some());
        assert_eq!(storage.finish_write(disk_full(), Some(&mut resumed)), None, "it has a checkpoint");
    }

    #[test]
    fn a_write_for_an_earlier_state_does_not_count_for_the_plan() {
        let mut storage = CheckpointStorage::new(None, at(0));
        storage.start_write(None, at(0));
        let mut active = started(award(7), None);
        assert_eq!(storage.start_write(Some(&mut active), at(0)), None);
        assert_eq!(storage.finish_write(disk_full(), Some(&mut active)), None);
        assert!(storage.start_write(Some(&mut active), at(0)).is_some());
    }
}
