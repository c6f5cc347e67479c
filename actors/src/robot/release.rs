//! A role that its robot cannot carry to its end, and when it may be given to another.

use crate::robot_driver::CLIENT_TIMEOUT;
use consort_protocol::message::TaskFailure;
use consort_protocol::units::NodeTime;
use std::time::Duration;

/// How much later than [`SILENCE`] a host may notice it: it looks every half a second, and clocks drift apart.
const HOST_IS_LATE: Duration = Duration::from_secs(1);

/// Why a robot gave up a role, and whether the coordinator knows: until then it only waits to put the role down.
pub(super) struct PendingRelease {
    why: TaskFailure,
    since: NodeTime,
    told: bool,
}

impl PendingRelease {
    pub(super) fn new(why: TaskFailure, since: NodeTime) -> PendingRelease {
        PendingRelease { why, since, told: false }
    }

    /// The reason, once nobody who takes the role over can meet this robot at work in it: its body is at rest, or has
    /// not been told to be for so long that its host has stopped it.
    pub(super) fn due(&self, at_rest: bool, now: NodeTime) -> Option<&TaskFailure> {
        (at_rest || now.since(self.since) >= CLIENT_TIMEOUT + HOST_IS_LATE).then_some(&self.why)
    }

    /// Whether the coordinator could be told and was not.
    pub(super) fn must_report(&self, at_rest: bool, now: NodeTime) -> bool {
        !self.told && self.due(at_rest, now).is_some()
    }

    /// The coordinator is being told what is [`due`](Self::due).
    pub(super) fn take_report(&mut self, at_rest: bool, now: NodeTime) -> Option<TaskFailure> {
        let why = self.due(at_rest, now).cloned();
        self.told = why.is_some();
        why
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::message::FailureKind;

    fn at(ms: u64) -> NodeTime {
        NodeTime::default() + Duration::from_millis(ms)
    }

    fn given_up() -> PendingRelease {
        let why = TaskFailure { task: None, cause: "no way".to_owned(), kind: FailureKind::Task };
        PendingRelease::new(why, at(1_000))
    }

    #[test]
    fn a_role_is_given_back_as_soon_as_the_body_is_at_rest() {
        let mut surrender = given_up();
        assert_eq!(surrender.due(false, at(1_100)), None);
        assert!(surrender.must_report(true, at(1_100)));
        assert!(surrender.take_report(true, at(1_100)).is_some());
        assert!(!surrender.must_report(true, at(1_200)));
    }

    #[test]
    fn a_body_that_answers_nobody_has_been_stopped_by_its_host_in_the_end() {
        let surrender = given_up();
        assert!(!surrender.must_report(false, at(4_999)));
        assert!(surrender.must_report(false, at(5_000)));
    }

    #[test]
    fn a_body_that_moves_again_makes_the_reason_owed_again() {
        let mut surrender = given_up();
        surrender.take_report(true, at(1_100));
        assert_eq!(surrender.take_report(false, at(1_200)), None);
        assert!(surrender.must_report(true, at(1_300)));
    }
}
