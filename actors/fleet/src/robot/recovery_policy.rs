//! Recovery of a robot from a failed task, before it releases the role.
//!
//! ```text
//!  failed ──▶ retry ──▶ next alternative (in their order) ──▶ release the role
//! ```

use super::sequencer::{Sequencer, StepRef};
use consort_protocol::cause::CauseClass;
use consort_protocol::message::{FailureKind, TaskFailure};
use consort_skills::actions::ErrorCode;

/// Failure of an attempt at a task.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct AttemptFailure {
    /// Kind of failure.
    pub(super) kind: FailureKind,
    /// Cause, as text.
    pub(super) cause: String,
    /// Class of the cause.
    pub(super) class: CauseClass,
    /// True if the robot has certainly moved no item in steps that it has not reported as ended.
    pub(super) moved_nothing: bool,
}

impl AttemptFailure {
    /// Creates a failure that says nothing about other robots, and may have moved an item.
    pub(super) fn new(kind: FailureKind, cause: impl Into<String>) -> AttemptFailure {
        AttemptFailure { kind, cause: cause.into(), class: CauseClass::Robot, moved_nothing: false }
    }

    /// Creates the failure of an attempt whose skill has failed. `code` is that of the failed goal, and `is_able` is false
    /// for a robot that cannot move. Unless its battery is the reason, as when its driver has no connection to it, the same
    /// attempt may succeed later.
    pub(super) fn of_skill(cause: String, class: CauseClass, code: Option<ErrorCode>, is_able: bool) -> AttemptFailure {
        let (kind, class) = match (code, class) {
            (Some(ErrorCode::BatteryLow), _) => (FailureKind::Battery, CauseClass::Robot),
            (_, CauseClass::Robot) if !is_able => (FailureKind::Task, CauseClass::Transient),
            _ => (FailureKind::Task, class),
        };
        AttemptFailure { class, ..AttemptFailure::new(kind, cause) }
    }
}

/// Minimum number of attempts at a task that fails for transient causes.
const TRANSIENT_ATTEMPTS: u8 = 4;

/// Maximum number of times that the pause between attempts doubles after transient failures.
const PAUSE_DOUBLINGS_MAX: u8 = 6;

/// Result of the recovery policy.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum RecoveryAction {
    /// The task is retried.
    Retry {
        /// Number of attempts so far.
        attempt: u8,
        /// Pause before the next attempt, as a multiple of the usual one.
        pauses: u32,
    },
    /// An alternative replaces the task.
    UseAlternative {
        /// Index of the alternative in the plan.
        alternative: usize,
    },
    /// All options have failed.
    ReleaseRole(TaskFailure),
}

/// Policy after failures: counts the attempts at the current task.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct RecoveryPolicy {
    step: Option<StepRef>,
    attempts: u8,
}

impl RecoveryPolicy {
    /// Selects the action after a failure of the current task. Afterwards no task is running.
    pub(super) fn next_action(&mut self, failure: AttemptFailure, sequencer: &mut Sequencer) -> RecoveryAction {
        let AttemptFailure { kind, cause, class, moved_nothing } = failure;
        let current = sequencer.current_step().map(|(step, id, spec)| (step, id.clone(), spec.attempts));
        let (task, next_alternative) = match (kind, current) {
            (FailureKind::Task | FailureKind::Crash | FailureKind::NoProgress, Some((step, id, allowed))) => {
                if self.step != Some(step) {
                    *self = RecoveryPolicy { step: Some(step), attempts: 0 };
                }
                self.attempts = self.attempts.saturating_add(1);
                let (allowed, doublings) = match class {
                    CauseClass::Robot => (allowed, 0),
                    CauseClass::Transient => (allowed.max(TRANSIENT_ATTEMPTS), self.attempts - 1),
                    CauseClass::Task | CauseClass::Precondition => (1, 0),
                };
                if self.attempts < allowed {
                    sequencer.abort_task();
                    let pauses = 1 << doublings.min(PAUSE_DOUBLINGS_MAX);
                    return RecoveryAction::Retry { attempt: self.attempts, pauses };
                }
                (Some(id), sequencer.switch_to_alternative())
            }
            // No alternative helps.
            (_, current) => {
                sequencer.abort_task();
                (current.map(|(_, id, _)| id), None)
            }
        };
        *self = RecoveryPolicy::default();
        match next_alternative {
            Some(alternative) => RecoveryAction::UseAlternative { alternative },
            None => RecoveryAction::ReleaseRole(TaskFailure { task, cause, kind, class, moved_nothing }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::sequencer::SequencerAction;
    use super::*;
    use serde_json::json;
    use std::collections::{BTreeMap, BTreeSet};

    fn sequencer(attempts: u8, alternatives: &[&str]) -> Sequencer {
        let spec = |id: &str| json!({ "type": id, "roles": ["r1"], "attempts": attempts });
        let step =
            |id: &str, after: &[u32]| json!({ "action": { "Task": { "id": id, "spec": spec(id) } }, "after": after });
        let alternative = |id: &&str| json!({ "replaces": [0], "tasks": [[id, spec(id)]] });
        let alternatives: Vec<_> = alternatives.iter().map(alternative).collect();
        let plan =
            json!({ "role": "r1", "steps": [step("drive", &[]), step("knock", &[0])], "alternatives": alternatives });
        Sequencer::new(serde_json::from_value(plan).unwrap(), &BTreeSet::new(), BTreeMap::new()).unwrap()
    }

    fn failure(kind: FailureKind) -> AttemptFailure {
        AttemptFailure::new(kind, "stuck")
    }

    fn start(sequencer: &mut Sequencer) -> (StepRef, String) {
        match sequencer.next_action() {
            Some(SequencerAction::StartTask { step, task, .. }) => (step, task.to_string()),
            other => panic!("{other:?}"),
        }
    }

    fn release(task: &str, kind: FailureKind) -> RecoveryAction {
        RecoveryAction::ReleaseRole(TaskFailure {
            task: Some(task.parse().unwrap()),
            ..TaskFailure::new(kind, "stuck")
        })
    }

    #[test]
    fn retries_come_first_then_alternatives_then_the_release() {
        let (mut policy, mut sequencer) = (RecoveryPolicy::default(), sequencer(3, &["lift"]));
        for attempt in 1..=2 {
            assert_eq!(start(&mut sequencer).1, "drive");
            assert_eq!(
                policy.next_action(failure(FailureKind::Task), &mut sequencer),
                RecoveryAction::Retry { attempt, pauses: 1 }
            );
        }
        assert_eq!(start(&mut sequencer).1, "drive");
        assert_eq!(
            policy.next_action(failure(FailureKind::NoProgress), &mut sequencer),
            RecoveryAction::UseAlternative { alternative: 0 }
        );
        for attempt in 1..=2 {
            assert_eq!(start(&mut sequencer).1, "lift");
            assert_eq!(
                policy.next_action(failure(FailureKind::Crash), &mut sequencer),
                RecoveryAction::Retry { attempt, pauses: 1 }
            );
        }
        assert_eq!(start(&mut sequencer).1, "lift");
        assert_eq!(
            policy.next_action(failure(FailureKind::Crash), &mut sequencer),
            release("lift", FailureKind::Crash)
        );
    }

    #[test]
    fn each_task_has_its_own_attempts() {
        let (mut policy, mut sequencer) = (RecoveryPolicy::default(), sequencer(2, &[]));
        start(&mut sequencer);
        assert_eq!(
            policy.next_action(failure(FailureKind::Task), &mut sequencer),
            RecoveryAction::Retry { attempt: 1, pauses: 1 }
        );
        let (step, _) = start(&mut sequencer);
        sequencer.end_task(step, BTreeMap::new());
        assert_eq!(start(&mut sequencer).1, "knock");
        assert_eq!(
            policy.next_action(failure(FailureKind::Task), &mut sequencer),
            RecoveryAction::Retry { attempt: 1, pauses: 1 }
        );
    }

    #[test]
    fn the_class_of_the_cause_decides_about_retries() {
        let of_class = |class| AttemptFailure { class, ..failure(FailureKind::Task) };
        for (class, allowed, retries) in [
            (CauseClass::Robot, 1, &[][..]),
            (CauseClass::Robot, 3, &[1, 1]),
            (CauseClass::Transient, 1, &[1, 2, 4]),
            (CauseClass::Transient, 9, &[1, 2, 4, 8, 16, 32, 64, 64]),
            (CauseClass::Task, 9, &[]),
            (CauseClass::Precondition, 9, &[]),
        ] {
            let (mut policy, mut sequencer) = (RecoveryPolicy::default(), sequencer(allowed, &["lift"]));
            for (attempt, &pauses) in (1..).zip(retries) {
                start(&mut sequencer);
                let action = policy.next_action(of_class(class), &mut sequencer);
                assert_eq!(action, RecoveryAction::Retry { attempt, pauses }, "{class:?}");
            }
            start(&mut sequencer);
            let action = policy.next_action(of_class(class), &mut sequencer);
            assert_eq!(action, RecoveryAction::UseAlternative { alternative: 0 }, "{class:?}: an alternative may do");
        }
    }

    #[test]
    fn the_release_carries_the_class() {
        let (mut policy, mut sequencer) = (RecoveryPolicy::default(), sequencer(1, &[]));
        start(&mut sequencer);
        let failure = AttemptFailure { class: CauseClass::Task, moved_nothing: true, ..failure(FailureKind::Task) };
        let RecoveryAction::ReleaseRole(released) = policy.next_action(failure, &mut sequencer) else { panic!() };
        assert_eq!((released.class, released.moved_nothing), (CauseClass::Task, true));
    }

    #[test]
    fn a_robot_without_a_connection_to_its_driver_has_no_empty_battery() {
        let of_skill = |class, code, is_able| {
            let AttemptFailure { kind, class, .. } =
                AttemptFailure::of_skill("stopped".to_owned(), class, code, is_able);
            (kind, class)
        };
        let (low, offline) = (Some(ErrorCode::BatteryLow), Some(ErrorCode::TimedOut));
        let (task, robot) = (FailureKind::Task, CauseClass::Robot);
        assert_eq!(of_skill(robot, low, false), (FailureKind::Battery, robot));
        assert_eq!(of_skill(robot, offline, false), (task, CauseClass::Transient), "it may be back later");
        assert_eq!(of_skill(CauseClass::Task, offline, false), (task, CauseClass::Task), "no robot can do the task");
        assert_eq!(of_skill(robot, offline, true), (task, robot));
        assert_eq!(of_skill(robot, None, true), (task, robot));
    }

    #[test]
    fn a_low_battery_releases_the_role_at_once() {
        let (mut policy, mut sequencer) = (RecoveryPolicy::default(), sequencer(9, &["lift"]));
        start(&mut sequencer);
        assert_eq!(
            policy.next_action(failure(FailureKind::Battery), &mut sequencer),
            release("drive", FailureKind::Battery)
        );
        let none = RecoveryAction::ReleaseRole(TaskFailure::new(FailureKind::Leaving, "stuck"));
        assert_eq!(policy.next_action(failure(FailureKind::Leaving), &mut sequencer), none);
    }
}
