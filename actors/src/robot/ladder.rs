//! What a robot does about a task that did not succeed, before it asks others for help.
//!
//! ```text
//!  failed ──▶ try again ──▶ another way (alternatives, in their order) ──▶ give the role up
//! ```

use super::sequencer::{Sequencer, Spot};
use consort_protocol::message::{FailureKind, TaskFailure};

/// How an attempt at a task ended without success.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setback {
    /// What kind of failure it was.
    pub kind: FailureKind,
    /// Why, in words.
    pub cause: String,
    /// Whether the same task would fail again for the same reason: it is not tried again as it is.
    pub lasting: bool,
}

/// What follows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Rung {
    /// The task is tried again.
    Again {
        /// How often it was tried so far.
        attempt: u8,
    },
    /// Another way is taken, by its number in the plan.
    Aside {
        /// Which alternative.
        alternative: usize,
    },
    /// All was tried.
    GiveUp(TaskFailure),
}

/// Counts attempts at the task under way.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Ladder {
    at: Option<Spot>,
    attempts: u8,
}

impl Ladder {
    /// The task under way has met with a setback. Afterwards no task is under way.
    pub fn climb(&mut self, setback: Setback, sequencer: &mut Sequencer) -> Rung {
        let Setback { kind, cause, lasting } = setback;
        let under_way = sequencer.under_way().map(|(spot, id, spec)| (spot, id.clone(), spec.attempts));
        let (task, another_way) = match (kind, under_way) {
            (FailureKind::Task | FailureKind::Crash | FailureKind::NoProgress, Some((spot, id, allowed))) => {
                if self.at != Some(spot) {
                    *self = Ladder { at: Some(spot), attempts: 0 };
                }
                self.attempts = self.attempts.saturating_add(1);
                if !lasting && self.attempts < allowed {
                    sequencer.break_off();
                    return Rung::Again { attempt: self.attempts };
                }
                (Some(id), sequencer.turn_aside())
            }
            // No other way helps.
            (_, under_way) => {
                sequencer.break_off();
                (under_way.map(|(_, id, _)| id), None)
            }
        };
        *self = Ladder::default();
        match another_way {
            Some(alternative) => Rung::Aside { alternative },
            None => Rung::GiveUp(TaskFailure { task, cause, kind }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Move;
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

    fn setback(kind: FailureKind) -> Setback {
        Setback { kind, cause: "stuck".to_owned(), lasting: false }
    }

    fn begin(sequencer: &mut Sequencer) -> (Spot, String) {
        match sequencer.next_move() {
            Some(Move::Perform { spot, task, .. }) => (spot, task.to_string()),
            other => panic!("{other:?}"),
        }
    }

    fn give_up(task: &str, kind: FailureKind) -> Rung {
        Rung::GiveUp(TaskFailure { task: Some(task.parse().unwrap()), cause: "stuck".to_owned(), kind })
    }

    #[test]
    fn a_task_is_tried_as_often_as_it_says_then_its_alternatives_and_then_the_role_is_given_up() {
        let (mut ladder, mut sequencer) = (Ladder::default(), sequencer(3, &["lift"]));
        for attempt in 1..=2 {
            assert_eq!(begin(&mut sequencer).1, "drive");
            assert_eq!(ladder.climb(setback(FailureKind::Task), &mut sequencer), Rung::Again { attempt });
        }
        assert_eq!(begin(&mut sequencer).1, "drive");
        assert_eq!(ladder.climb(setback(FailureKind::NoProgress), &mut sequencer), Rung::Aside { alternative: 0 });
        for attempt in 1..=2 {
            assert_eq!(begin(&mut sequencer).1, "lift");
            assert_eq!(ladder.climb(setback(FailureKind::Crash), &mut sequencer), Rung::Again { attempt });
        }
        assert_eq!(begin(&mut sequencer).1, "lift");
        assert_eq!(ladder.climb(setback(FailureKind::Crash), &mut sequencer), give_up("lift", FailureKind::Crash));
    }

    #[test]
    fn each_task_has_its_own_attempts() {
        let (mut ladder, mut sequencer) = (Ladder::default(), sequencer(2, &[]));
        begin(&mut sequencer);
        assert_eq!(ladder.climb(setback(FailureKind::Task), &mut sequencer), Rung::Again { attempt: 1 });
        let (spot, _) = begin(&mut sequencer);
        sequencer.end(spot);
        assert_eq!(begin(&mut sequencer).1, "knock");
        assert_eq!(ladder.climb(setback(FailureKind::Task), &mut sequencer), Rung::Again { attempt: 1 });
    }

    #[test]
    fn what_will_not_pass_is_not_tried_again() {
        let (mut ladder, mut sequencer) = (Ladder::default(), sequencer(9, &["lift"]));
        begin(&mut sequencer);
        let lasting = Setback { lasting: true, ..setback(FailureKind::Task) };
        assert_eq!(ladder.climb(lasting, &mut sequencer), Rung::Aside { alternative: 0 });
    }

    #[test]
    fn nothing_but_another_robot_helps_an_empty_battery() {
        let (mut ladder, mut sequencer) = (Ladder::default(), sequencer(9, &["lift"]));
        begin(&mut sequencer);
        assert_eq!(ladder.climb(setback(FailureKind::Battery), &mut sequencer), give_up("drive", FailureKind::Battery));
        let none = Rung::GiveUp(TaskFailure { task: None, cause: "stuck".to_owned(), kind: FailureKind::Leaving });
        assert_eq!(ladder.climb(setback(FailureKind::Leaving), &mut sequencer), none);
    }
}
