//! Order in which missions are served: by priority, then earliest deadline first (EDF), then by age.
//!
//! A mission counts as due some hours after it could start, or at its deadline if that is nearer. So a mission without a deadline
//! comes after the missions with a nearer one, and the later missions that overtake a mission are bounded: a mission that is
//! submitted after that time is due later still. A distant deadline is no disadvantage: it decides between missions that are due
//! at the same time.

use super::entry::MissionEntry;
use super::submission::{Priority, Submission};
use std::cmp::Reverse;

/// Time after which a mission counts as due although its deadline is later or it has none, in milliseconds. Raised: missions with
/// deadlines come first for longer, and the others wait for longer in a busy fleet. A guess: a shift.
const DUE_AFTER_MS: u64 = 8 * 60 * 60 * 1000;

/// Place of a mission in the order in which missions are served: smallest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct ServiceRank {
    /// Highest priority first.
    pub(super) priority: Reverse<Priority>,
    /// Time at which the mission is due, in milliseconds since 1970.
    due_ms: u64,
    /// Deadline in milliseconds since 1970, the latest time without one. Of missions that are due at the same time the one with
    /// the nearest deadline comes first.
    deadline_ms: u64,
    /// Number among all missions ever submitted.
    number: u64,
}

impl ServiceRank {
    /// Returns the rank of a mission with this number.
    fn of(submission: &Submission, number: u64) -> ServiceRank {
        let Submission { priority, deadline_ms, not_before_ms, at_ms, .. } = submission;
        let could_start_ms = not_before_ms.unwrap_or_default().max(*at_ms);
        let deadline_ms = deadline_ms.unwrap_or(u64::MAX);
        let due_ms = deadline_ms.min(could_start_ms.saturating_add(DUE_AFTER_MS));
        ServiceRank { priority: Reverse(*priority), due_ms, deadline_ms, number }
    }
}

impl MissionEntry {
    /// Returns the place of the mission in the order in which missions are served.
    pub fn rank(&self) -> ServiceRank {
        ServiceRank::of(&self.submission, self.number)
    }
}

/// Returns missions in the order in which they are served.
pub fn service_order<'a>(missions: impl IntoIterator<Item = &'a MissionEntry>) -> Vec<&'a MissionEntry> {
    let mut missions: Vec<&MissionEntry> = missions.into_iter().collect();
    missions.sort_by_key(|entry| entry.rank());
    missions
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ledger::test_values::rounds;
    use proptest::prelude::*;

    /// A mission that is submitted at a minute, with the minutes until its deadline.
    #[derive(Debug, Clone, Copy)]
    struct Case {
        priority: i64,
        minute: u64,
        within: Option<u64>,
    }

    fn rank(case: Case, number: u64) -> ServiceRank {
        let ms = |minutes: u64| minutes * 60_000;
        let submission = Submission {
            priority: Priority::new(case.priority).unwrap(),
            deadline_ms: case.within.map(|within| ms(case.minute + within)),
            at_ms: ms(case.minute),
            ..rounds("a")
        };
        ServiceRank::of(&submission, number)
    }

    fn case() -> impl Strategy<Value = Case> {
        let fields = (-1_i64..2, 0_u64..2000, prop::option::of(1_u64..480));
        fields.prop_map(|(priority, minute, within)| Case { priority, minute, within })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn priority_then_deadline_then_age_decides_and_no_mission_starves(one in case(), other in case()) {
            // Numbers follow the times of submission.
            let (one, other) = if one.minute <= other.minute { (one, other) } else { (other, one) };
            let is_first = rank(one, 1) < rank(other, 2);
            let expected = match (one.within, other.within) {
                _ if one.priority != other.priority => one.priority > other.priority,
                (Some(within), Some(later)) => one.minute + within <= other.minute + later,
                (None, None) => true,
                (Some(_), None) => true,
                // The later mission overtakes only while the earlier one has waited for less than eight hours.
                (None, Some(later)) => one.minute + 480 < other.minute + later,
            };
            prop_assert_eq!(is_first, expected);
        }

        #[test]
        fn a_deadline_never_makes_the_rank_worse(case in case(), within in 1_u64..3000, later in 1_u64..3000) {
            let with = |within| rank(Case { within: Some(within), ..case }, 2);
            prop_assert!(with(within) < rank(Case { within: None, ..case }, 1), "{within} minutes");
            prop_assert!(with(within.min(later)) <= with(within.max(later)), "of two deadlines the nearer");
        }

        #[test]
        fn age_never_makes_the_rank_worse(
            priority in -1_i64..2,
            minutes in (0_u64..2000, 0_u64..2000),
            not_before in prop::option::of(0_u64..3000),
            deadline in prop::option::of(0_u64..5000),
        ) {
            let ms = |minutes: u64| minutes * 60_000;
            let rank = |minute: u64, number| {
                let submission = Submission {
                    priority: Priority::new(priority).unwrap(),
                    not_before_ms: not_before.map(ms),
                    deadline_ms: deadline.map(ms),
                    at_ms: ms(minute),
                    ..rounds("a")
                };
                ServiceRank::of(&submission, number)
            };
            let (one, other) = minutes;
            prop_assert!(rank(one.min(other), 1) < rank(one.max(other), 2));
        }
    }

    #[test]
    fn a_mission_with_a_distant_deadline_is_overtaken_for_a_bounded_time() {
        let day = 24 * 60;
        let distant = Case { priority: 0, minute: 0, within: Some(day) };
        let later = |minute, within| rank(Case { priority: 0, minute, within }, 2);
        assert!(later(479, Some(1)) < rank(distant, 1));
        assert!(rank(distant, 1) < later(480, Some(1)));
        assert!(rank(distant, 1) < later(1, None));
    }

    #[test]
    fn a_mission_without_a_deadline_ages_from_its_earliest_start() {
        let plain = Submission { at_ms: 1000, ..rounds("a") };
        let scheduled = Submission { not_before_ms: Some(2000), at_ms: 0, ..rounds("b") };
        assert!(ServiceRank::of(&plain, 2) < ServiceRank::of(&scheduled, 1));
    }
}
