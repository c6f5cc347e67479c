//! Release of a role that the robot cannot complete.

use crate::robot_driver::CLIENT_TIMEOUT;
use consort_protocol::lease::CLOCK_DRIFT_MAX;
use consort_protocol::message::TaskFailure;
use consort_protocol::units::NodeTime;
use std::time::Duration;

/// Extra time until a robot is at rest after [`CLIENT_TIMEOUT`]: its reaction, and the drift of its
/// driver server's clock.
const CLIENT_TIMEOUT_MARGIN: Duration = Duration::from_secs(1);

/// Time after the last permission for its goals at which a robot is at rest, if no goal takes longer to stop.
const REST_AFTER: Duration = CLIENT_TIMEOUT.saturating_add(CLIENT_TIMEOUT_MARGIN);

/// Activity of a driver as known to the robot's node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct DriverActivity {
    /// No goal is in progress.
    pub(super) is_idle: bool,
    /// Time since the latest state of the driver.
    pub(super) silent_for: Duration,
    /// Time that its goals in progress may need to stop beyond that of the robot's reaction.
    pub(super) stop_lead: Duration,
}

/// Reason for the release, and whether it was reported. The robot may not act from the beginning of
/// the release; until the coordinator ends the award, it only waits.
pub(super) struct PendingRelease {
    failure: TaskFailure,
    since: NodeTime,
    reported: bool,
}

impl PendingRelease {
    pub(super) fn new(failure: TaskFailure, since: NodeTime) -> PendingRelease {
        PendingRelease { failure, since, reported: false }
    }

    /// Returns the reason once the body is at rest, so that its successor cannot meet it at work: the
    /// driver is idle, or it has been unreachable for so long that its server has stopped the robot.
    /// A driver that still reports a goal in progress is not at rest, however long ago the release
    /// began.
    pub(super) fn due(&self, driver: DriverActivity, now: NodeTime) -> Option<&TaskFailure> {
        let rest_after = REST_AFTER + driver.stop_lead.mul_f64(1.0 + CLOCK_DRIFT_MAX);
        let is_stopped_by_server = driver.silent_for >= rest_after && now.since(self.since) >= rest_after;
        (driver.is_idle || is_stopped_by_server).then_some(&self.failure)
    }

    /// Checks whether the reason can be reported and has not been reported yet.
    pub(super) fn must_report(&self, driver: DriverActivity, now: NodeTime) -> bool {
        !self.reported && self.due(driver, now).is_some()
    }

    /// Marks the reason as reported and returns it, if it is [`due`](Self::due).
    pub(super) fn take_report(&mut self, driver: DriverActivity, now: NodeTime) -> Option<TaskFailure> {
        let failure = self.due(driver, now).cloned();
        self.reported = failure.is_some();
        failure
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::lease::LEASE_REACTION;
    use consort_protocol::message::FailureKind;

    fn at(ms: u64) -> NodeTime {
        NodeTime::default() + Duration::from_millis(ms)
    }

    const IDLE: DriverActivity =
        DriverActivity { is_idle: true, silent_for: Duration::ZERO, stop_lead: Duration::ZERO };

    fn busy(silent_for_ms: u64) -> DriverActivity {
        DriverActivity { is_idle: false, silent_for: Duration::from_millis(silent_for_ms), ..IDLE }
    }

    fn pending() -> PendingRelease {
        let failure = TaskFailure::new(FailureKind::Task, "no way");
        PendingRelease::new(failure, at(1_000))
    }

    #[test]
    fn a_release_is_reported_as_soon_as_the_driver_is_idle() {
        let mut release = pending();
        assert_eq!(release.due(busy(0), at(1_100)), None);
        assert!(release.must_report(IDLE, at(1_100)));
        assert!(release.take_report(IDLE, at(1_100)).is_some());
        assert!(!release.must_report(IDLE, at(1_200)));
    }

    #[test]
    fn an_unreachable_driver_counts_as_stopped_after_the_client_timeout() {
        let release = pending();
        assert!(!release.must_report(busy(9_000), at(4_999)), "commands before the release permitted the goal");
        assert!(!release.must_report(busy(3_999), at(9_000)), "it was at work 4 s ago");
        assert!(release.must_report(busy(4_000), at(5_000)));
        assert!(CLIENT_TIMEOUT_MARGIN > LEASE_REACTION + REST_AFTER.mul_f64(CLOCK_DRIFT_MAX));
    }

    #[test]
    fn an_unreachable_body_that_stops_slowly_counts_as_stopped_later() {
        let slow = |ms| DriverActivity { stop_lead: Duration::from_secs(10), ..busy(ms) };
        assert_eq!(pending().due(slow(14_099), at(60_000)), None);
        assert_eq!(pending().due(slow(60_000), at(15_099)), None);
        assert!(pending().due(slow(14_101), at(15_101)).is_some());
    }

    #[test]
    fn a_driver_that_reports_a_goal_in_progress_is_never_at_rest() {
        assert_eq!(pending().due(busy(200), at(60_000)), None);
    }

    #[test]
    fn a_driver_that_moves_again_makes_the_report_due_again() {
        let mut release = pending();
        release.take_report(IDLE, at(1_100));
        assert_eq!(release.take_report(busy(0), at(1_200)), None);
        assert!(release.must_report(IDLE, at(1_300)));
    }
}
