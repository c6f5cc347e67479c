//! Alarms that a person raises, which some runs contain.

use super::schedule::{ChaosAction, ScheduledAction};
use consort_protocol::api::AlarmAction;
use consort_protocol::keys::ApiCall;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::ops::{Range, RangeInclusive};

/// First seed with alarms, speed limits, zones and changes of missions. Smaller seeds keep their schedules: mutation checks,
/// the scoreboard and the sweeps of closed fleets use them.
pub const FIRST_SEED: u64 = 181;

/// The alarms that the fleet declares: at `fire` robots drive to assembly places, at `freeze` they stand still.
pub(super) const ALARMS: [&str; 2] = ["fire", "freeze"];

/// Share of the runs with alarms, and their number.
const RUNS: f64 = 0.5;
const RAISED: RangeInclusive<usize> = 1..=2;

/// Share of the alarms soon after a request, when its robot is on its way, and the time from the request.
const AFTER_REQUEST: f64 = 0.6;
const AFTER_REQUEST_MS: RangeInclusive<u64> = 2_000..=12_000;

/// Share of the alarms that a person clears while there are faults, and their durations. The others are cleared when all
/// faults have ended.
const CLEARED: f64 = 0.7;
const CLEAR_AFTER_MS: RangeInclusive<u64> = 15_000..=45_000;

/// Adds alarms in this period, from a generator of their own.
pub(super) fn add_alarms(seed: u64, period_ms: Range<u64>, steps: &mut Vec<ScheduledAction>) {
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0xa1a7_2e11);
    if !chance.random_bool(RUNS) {
        return;
    }
    let asked = steps.iter().filter(|step| step.action.submitted_request().is_some()).map(|step| step.at_ms);
    let asked: Vec<u64> = asked.collect();
    let latest_ms = period_ms.end - 1_000;
    for _ in 0..chance.random_range(RAISED) {
        let alarm = *ALARMS.choose(&mut chance).expect("there are two");
        let mut at_ms = chance.random_range(period_ms.start..latest_ms);
        if let Some(asked_ms) = asked.choose(&mut chance).filter(|_| chance.random_bool(AFTER_REQUEST)) {
            at_ms = (asked_ms + chance.random_range(AFTER_REQUEST_MS)).clamp(period_ms.start, latest_ms);
        }
        let mut push = |at_ms, change| {
            steps.push(ScheduledAction { at_ms, action: ChaosAction::Alarm { alarm: alarm.to_owned(), change } });
        };
        push(at_ms, AlarmAction::Raise);
        if chance.random_bool(CLEARED) {
            let clear_ms = (at_ms + chance.random_range(CLEAR_AFTER_MS)).min(period_ms.end);
            push(clear_ms, AlarmAction::Clear);
        }
    }
}

/// Returns the request of a person that raises or clears an alarm.
pub(super) fn request(alarm: &str, change: AlarmAction) -> (ApiCall, Value) {
    let mut request = json!({ "action": change, "alarm": alarm });
    if change == AlarmAction::Raise {
        request["reason"] = json!("smoke");
    }
    (ApiCall::Alarm, request)
}

/// Returns the request of a person that clears all alarms.
pub(super) fn all_clear() -> (ApiCall, Value) {
    (ApiCall::Alarm, json!({ "action": AlarmAction::Clear }))
}

#[cfg(test)]
mod tests {
    use super::super::fault_kind::FaultKind;
    use super::super::generate::{assert_valid, drawn};
    use super::*;
    use consort_protocol::api::AlarmRequest;
    use consort_protocol::ids::AlarmId;

    #[test]
    fn some_later_runs_have_each_alarm() {
        let alarms = |seed, kinds: &[FaultKind]| -> Vec<(String, AlarmAction)> {
            drawn(seed, kinds, |step| match &step.action {
                ChaosAction::Alarm { alarm, change } => Some((alarm.clone(), *change)),
                _ => None,
            })
        };
        assert!((1..FIRST_SEED).all(|seed| alarms(seed, &FaultKind::FAULTS).is_empty()));
        assert!((FIRST_SEED..FIRST_SEED + 60).all(|seed| alarms(seed, &[FaultKind::Poison]).is_empty()));
        let later: Vec<_> = (FIRST_SEED..FIRST_SEED + 60).map(|seed| alarms(seed, &FaultKind::FAULTS)).collect();
        assert!(later.iter().filter(|alarms| alarms.is_empty()).count() >= 5);
        for wanted in ALARMS {
            for change in [AlarmAction::Raise, AlarmAction::Clear] {
                let has = |alarms: &&Vec<(String, AlarmAction)>| alarms.contains(&(wanted.to_owned(), change));
                assert!(later.iter().filter(has).count() >= 3, "{wanted} {change:?}");
            }
        }
    }

    #[test]
    fn later_schedules_are_valid_and_read_back_unchanged() {
        assert_valid(FIRST_SEED..FIRST_SEED + 60);
    }

    #[test]
    fn requests_are_those_of_the_api() {
        for (name, (call, payload)) in [
            (Some("fire"), request("fire", AlarmAction::Raise)),
            (Some("fire"), request("fire", AlarmAction::Clear)),
            (None, all_clear()),
        ] {
            let parsed: AlarmRequest = serde_json::from_value(payload).unwrap();
            assert_eq!((call, parsed.alarm.as_ref().map(AlarmId::as_str)), (ApiCall::Alarm, name));
        }
    }
}
