//! What a robot does about a task that did not succeed, before it asks others for help.
//!
//! ```text
//!  failed ──▶ try again ──▶ another way (alternatives, in their order) ──▶ give the role up
//! ```

use super::sequencer::{Sequencer, StepRef};
use consort_protocol::message::{FailureKind, TaskFailure};

/// How an attempt at a task ended without success.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AttemptFailure {
    /// What kind of failure it was.
    pub kind: FailureKind,
    /// Why, in words.
    pub cause: String,
    /// Whether the same task would fail again for the same reason: it is not tried again as it is.
    pub permanent: bool,
}

/// What follows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RecoveryAction {
    /// The task is tried again.
    Retry {
        /// How often it was tried so far.
        attempt: u8,
    },
    /// Another way is taken, by its number in the plan.
    UseAlternative {
        /// Which alternative.
        alternative: usize,
    },
    /// All was tried.
    ReleaseRole(TaskFailure),
}

/// Counts attempts at the task under way.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RecoveryPolicy {
    at: Option<StepRef>,
    attempts: u8,
}

impl RecoveryPolicy {
    /// The task under way has met with a setback. Afterwards no task is under way.
    pub fn next_action(&mut self, setback: AttemptFailure, sequencer: &mut Sequencer) -> RecoveryAction {
        let AttemptFailure { kind, cause, permanent: lasting } = setback;
        let under_way = sequencer.current_step().map(|(spot, id, spec)| (spot, id.clone(), spec.attempts));
        let (task, another_way) = match (kind, under_way) {
            (FailureKind::Task | FailureKind::Crash | FailureKind::NoProgress, Some((spot, id, allowed))) => {
                if self.at != Some(spot) {
                    *self = RecoveryPolicy { at: Some(spot), attempts: 0 };
                }
                self.attempts = self.attempts.saturating_add(1);
                if !lasting && self.attempts < allowed {
                    sequencer.abort_task();
                    return RecoveryAction::Retry { attempt: self.attempts };
                }
                (Some(id), sequencer.switch_to_alternative())
            }
            // No other way helps.
            (_, under_way) => {
                sequencer.abort_task();
                (under_way.map(|(_, id, _)| id), None)
            }
        };
        *self = RecoveryPolicy::default();
        match another_way {
            Some(alternative) => RecoveryAction::UseAlternative { alternative },
            None => RecoveryAction::ReleaseRole(TaskFailure { task, cause, kind }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::SequencerAction;
    use serde_json::json;
    use std::collections::{BTreeMap, BTreeSet};

    fn sequencer(attempts: u8, alternatives: &[&str]) -> Sequencer {
        let spec = |id: &str| json!({ "type": id, "roles": ["r1"], "attempts": attempts });
        let step =
            |id: &str, after: &[u32]| json!({ "action": { "Task": { "id": id, "spec": spec(id) } }, "after": after });
        let aside = |id: &&str| json!({ "replaces": [0], "tasks": [[id, spec(id)]] });
        let alternatives: Vec<_> = alternatives.iter().map(aside).collect();
        let plan =
            json!({ "role": "r1", "steps": [step("drive", &[]), step("knock", &[0])], "alternatives": alternatives });
        Sequencer::new(serde_json::from_value(plan).unwrap(), &BTreeSet::new(), BTreeMap::new()).unwrap()
    }

    fn setback(kind: FailureKind) -> AttemptFailure {
        AttemptFailure { kind, cause: "stuck".to_owned(), permanent: false }
    }

    fn begin(sequencer: &mut Sequencer) -> (StepRef, String) {
        match sequencer.next_action() {
            Some(SequencerAction::StartTask { step: spot, task, .. }) => (spot, task.to_string()),
            other => panic!("{other:?}"),
        }
    }

    fn give_up(task: &str, kind: FailureKind) -> RecoveryAction {
        RecoveryAction::ReleaseRole(TaskFailure { task: Some(task.parse().unwrap()), cause: "stuck".to_owned(), kind })
    }

    #[test]
    fn a_task_is_tried_as_often_as_it_says_then_its_alternatives_and_then_the_role_is_given_up() {
        let (mut ladder, mut sequencer) = (RecoveryPolicy::default(), sequencer(3, &["lift"]));
        for attempt in 1..=2 {
            assert_eq!(begin(&mut sequencer).1, "drive");
            assert_eq!(
                ladder.next_action(setback(FailureKind::Task), &mut sequencer),
                RecoveryAction::Retry { attempt }
            );
        }
        assert_eq!(begin(&mut sequencer).1, "drive");
        assert_eq!(
            ladder.next_action(setback(FailureKind::NoProgress), &mut sequencer),
            RecoveryAction::UseAlternative { alternative: 0 }
        );
        for attempt in 1..=2 {
            assert_eq!(begin(&mut sequencer).1, "lift");
            assert_eq!(
                ladder.next_action(setback(FailureKind::Crash), &mut sequencer),
                RecoveryAction::Retry { attempt }
            );
        }
        assert_eq!(begin(&mut sequencer).1, "lift");
        assert_eq!(
            ladder.next_action(setback(FailureKind::Crash), &mut sequencer),
            give_up("lift", FailureKind::Crash)
        );
    }

    #[test]
    fn each_task_has_its_own_attempts() {
        let (mut ladder, mut sequencer) = (RecoveryPolicy::default(), sequencer(2, &[]));
        begin(&mut sequencer);
        assert_eq!(
            ladder.next_action(setback(FailureKind::Task), &mut sequencer),
            RecoveryAction::Retry { attempt: 1 }
        );
        let (spot, _) = begin(&mut sequencer);
        sequencer.end_task(spot);
        assert_eq!(begin(&mut sequencer).1, "knock");
        assert_eq!(
            ladder.next_action(setback(FailureKind::Task), &mut sequencer),
            RecoveryAction::Retry { attempt: 1 }
        );
    }

    #[test]
    fn what_will_not_pass_is_not_tried_again() {
        let (mut ladder, mut sequencer) = (RecoveryPolicy::default(), sequencer(9, &["lift"]));
        begin(&mut sequencer);
        let lasting = AttemptFailure { permanent: true, ..setback(FailureKind::Task) };
        assert_eq!(ladder.next_action(lasting, &mut sequencer), RecoveryAction::UseAlternative { alternative: 0 });
    }

    #[test]
    fn nothing_but_another_robot_helps_an_empty_battery() {
        let (mut ladder, mut sequencer) = (RecoveryPolicy::default(), sequencer(9, &["lift"]));
        begin(&mut sequencer);
        assert_eq!(
            ladder.next_action(setback(FailureKind::Battery), &mut sequencer),
            give_up("drive", FailureKind::Battery)
        );
        let none = RecoveryAction::ReleaseRole(TaskFailure {
            task: None,
            cause: "stuck".to_owned(),
            kind: FailureKind::Leaving,
        });
        assert_eq!(ladder.next_action(setback(FailureKind::Leaving), &mut sequencer), none);
    }
}
