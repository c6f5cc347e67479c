//! A mission with a schedule, which some runs add, pause, resume and remove.

use super::control_flow::FIRST_SEED;
use super::fault_kind::FaultKind;
use super::schedule::{ChaosAction, ScheduledAction};
use consort_protocol::api::ScheduleAction;
use consort_protocol::ledger::MissedOccurrences;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

/// Name of the schedule.
pub(super) const SCHEDULE: &str = "rests";

/// Interval of the occurrences: the smallest of schedules.
pub(super) const INTERVAL_MS: u64 = 60_000;

/// Shares of the runs with a schedule, and of these runs with a pause and with a removal.
const RUNS: f64 = 0.5;
const PAUSED: f64 = 0.4;
const REMOVED: f64 = 0.2;

/// Adds the changes of the schedule up to `end_ms`, from a generator of their own. Runs with missions that cannot be
/// completed as the only faults, which bound the time of the others, have none.
pub(super) fn add_schedule(seed: u64, kinds: &[FaultKind], end_ms: u64, steps: &mut Vec<ScheduledAction>) {
    use MissedOccurrences::{All, Last, Skip};
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0x5c4e_d01e);
    if seed < FIRST_SEED || kinds == [FaultKind::Poison] || !chance.random_bool(RUNS) {
        return;
    }
    let missed = *[All, All, Last, Skip].choose(&mut chance).expect("there are four");
    let mut push =
        |at_ms, change| steps.push(ScheduledAction { at_ms, action: ChaosAction::ChangeSchedule { change, missed } });
    let added_ms = chance.random_range(1_000..end_ms / 4);
    push(added_ms, ScheduleAction::Add);
    if chance.random_bool(PAUSED) {
        let paused_ms = chance.random_range(added_ms..end_ms * 3 / 4);
        push(paused_ms, ScheduleAction::Pause);
        push(chance.random_range(paused_ms..end_ms), ScheduleAction::Resume);
    }
    if chance.random_bool(REMOVED) {
        push(chance.random_range(end_ms / 2..end_ms), ScheduleAction::Remove);
    }
}

/// Returns the mission of the schedule: a rest of 1 s.
pub(super) fn mission() -> Value {
    let rest = json!({ "task": "rest", "type": "wait", "roles": ["r1"], "parameters": { "seconds": "1" } });
    json!({ "mission": "rest", "roles": { "r1": { "kind": "managed" } }, "root": rest })
}

/// Returns the request for a change. The mission is due every minute.
pub(super) fn request(change: ScheduleAction, missed: MissedOccurrences) -> Value {
    let change = json!({ "schedule": SCHEDULE, "action": change });
    if change["action"] != "add" {
        return change;
    }
    let submit = json!({ "mission": mission() });
    json!({ "schedule": SCHEDULE, "action": "add", "cron": "* * * * *", "missed": missed, "submit": submit })
}

#[cfg(test)]
mod tests {
    use super::super::generate::drawn;
    use super::*;
    use consort_protocol::api::ScheduleRequest;

    fn changes(seed: u64, kinds: &[FaultKind]) -> Vec<(u64, ScheduleAction)> {
        drawn(seed, kinds, |step| match step.action {
            ChaosAction::ChangeSchedule { change, .. } => Some((step.at_ms, change)),
            _ => None,
        })
    }

    #[test]
    fn some_later_runs_have_a_schedule_with_all_kinds_of_changes() {
        use ScheduleAction::{Add, Pause, Remove, Resume};
        assert!((1..FIRST_SEED).all(|seed| changes(seed, &FaultKind::FAULTS).is_empty()));
        let later: Vec<_> = (FIRST_SEED..FIRST_SEED + 60).map(|seed| changes(seed, &FaultKind::FAULTS)).collect();
        assert!(later.iter().filter(|changes| changes.is_empty()).count() >= 15);
        for kind in [Add, Pause, Resume, Remove] {
            let with = later.iter().filter(|changes| changes.iter().any(|(_, change)| *change == kind));
            assert!(with.count() >= 2, "{kind:?}");
        }
        assert!(later.iter().filter_map(|changes| changes.first()).all(|(_, first)| *first == Add));
        assert!((FIRST_SEED..FIRST_SEED + 60).all(|seed| changes(seed, &[FaultKind::Poison]).is_empty()));
    }

    #[test]
    fn requests_are_those_of_the_api() {
        for change in [ScheduleAction::Add, ScheduleAction::Pause, ScheduleAction::Resume, ScheduleAction::Remove] {
            let request: ScheduleRequest = serde_json::from_value(request(change, MissedOccurrences::All)).unwrap();
            assert_eq!((request.action, request.has_content()), (change, change == ScheduleAction::Add));
        }
    }
}
