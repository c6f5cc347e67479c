//! Release of a role that the robot cannot complete.

use crate::robot_driver::CLIENT_TIMEOUT;
use consort_protocol::message::TaskFailure;
use consort_protocol::units::NodeTime;
use std::time::Duration;

/// Extra time until a driver server applies [`CLIENT_TIMEOUT`]: it checks every 0.5 s, and clocks
/// drift.
const CLIENT_TIMEOUT_MARGIN: Duration = Duration::from_secs(1);

/// Reason for the release, and whether it was reported. Until the coordinator ends the award, the
/// robot only waits.
pub(super) struct PendingRelease {
    failure: TaskFailure,
    since: NodeTime,
    reported: bool,
}

impl PendingRelease {
    pub(super) fn new(failure: TaskFailure, since: NodeTime) -> PendingRelease {
        PendingRelease { failure, since, reported: false }
    }

    /// Returns the reason once the robot no longer acts in the role, so that its successor cannot
    /// meet it at work: the driver is idle, or it has been unreachable for so long that its server
    /// has stopped it.
    pub(super) fn due(&self, is_idle: bool, now: NodeTime) -> Option<&TaskFailure> {
        (is_idle || now.since(self.since) >= CLIENT_TIMEOUT + CLIENT_TIMEOUT_MARGIN).then_some(&self.failure)
    }

    /// Checks whether the reason can be reported and has not been reported yet.
    pub(super) fn must_report(&self, is_idle: bool, now: NodeTime) -> bool {
        !self.reported && self.due(is_idle, now).is_some()
    }

    /// Marks the reason as reported and returns it, if it is [`due`](Self::due).
    pub(super) fn take_report(&mut self, is_idle: bool, now: NodeTime) -> Option<TaskFailure> {
        let failure = self.due(is_idle, now).cloned();
        self.reported = failure.is_some();
        failure
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::message::FailureKind;

    fn at(ms: u64) -> NodeTime {
        NodeTime::default() + Duration::from_millis(ms)
    }

    fn pending() -> PendingRelease {
        let failure = TaskFailure { task: None, cause: "no way".to_owned(), kind: FailureKind::Task };
        PendingRelease::new(failure, at(1_000))
    }

    #[test]
    fn a_release_is_reported_as_soon_as_the_driver_is_idle() {
        let mut release = pending();
        assert_eq!(release.due(false, at(1_100)), None);
        assert!(release.must_report(true, at(1_100)));
        assert!(release.take_report(true, at(1_100)).is_some());
        assert!(!release.must_report(true, at(1_200)));
    }

    #[test]
    fn an_unreachable_driver_counts_as_stopped_after_the_client_timeout() {
        let release = pending();
        assert!(!release.must_report(false, at(4_999)));
        assert!(release.must_report(false, at(5_000)));
    }

    #[test]
    fn a_driver_that_moves_again_makes_the_report_due_again() {
        let mut release = pending();
        release.take_report(true, at(1_100));
        assert_eq!(release.take_report(false, at(1_200)), None);
        assert!(release.must_report(true, at(1_300)));
    }
}
