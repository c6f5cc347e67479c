//! Speed limits that a person sets, which some runs contain.

use super::closures::{CLOSE_S, OPEN_AFTER_MS, named};
use super::person_action::SpeedLimitAction;
use super::schedule::{ChaosAction, ScheduledAction};
use super::zones::{parts_with_zones, zone_parts};
use crate::slug;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::MapPart;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::ops::{Range, RangeInclusive};

/// Share of the runs with speed limits, and their number.
const RUNS: f64 = 0.6;
const LIMITS: RangeInclusive<usize> = 1..=3;

/// The limits in metres per second. The carriers drive at 0.6 m/s. At lower limits robots would reach chargers later than
/// the invariant `charged` permits in a slow world.
const SPEEDS_MPS: [f64; 3] = [0.2, 0.3, 0.4];

/// Shares of the limits on the lanes from and to the room of a request, and in zones. The others are anywhere.
const OF_ROOM: f64 = 0.4;
const OF_ZONE: f64 = 0.5;

/// Longest time by which a limit begins before its request.
const BEFORE_REQUEST_MS: u64 = 15_000;

/// Shares of the limits that end by themselves, and of the others that a person clears while there are faults. The
/// remaining limits are cleared when all faults have ended.
const WITH_END: f64 = 0.3;
const CLEARED: f64 = 0.5;

/// Adds speed limits in this period, from a generator of their own.
pub(super) fn add_speed_limits(seed: u64, period_ms: Range<u64>, steps: &mut Vec<ScheduledAction>) {
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0x51_0e11);
    if !chance.random_bool(RUNS) {
        return;
    }
    let request = |step: &ScheduledAction| match &step.action {
        ChaosAction::Submit { room, .. } => Some((step.at_ms, MapPart::Place(slug(room)))),
        _ => None,
    };
    let requests: Vec<(u64, MapPart)> = steps.iter().filter_map(request).collect();
    let (zones, parts) = (zone_parts(), parts_with_zones());
    let latest_ms = period_ms.end - 1_000;
    for _ in 0..chance.random_range(LIMITS) {
        let mut at_ms = chance.random_range(period_ms.start..latest_ms);
        let parts = if chance.random_bool(OF_ZONE) { &zones } else { &parts };
        let mut part = parts.choose(&mut chance).expect("the map has places").clone();
        if let Some((asked_ms, room)) = requests.choose(&mut chance).filter(|_| chance.random_bool(OF_ROOM)) {
            let from_ms = asked_ms.saturating_sub(BEFORE_REQUEST_MS);
            at_ms = chance.random_range(from_ms..=*asked_ms).clamp(period_ms.start, latest_ms);
            part = room.clone();
        }
        let mut push = |at_ms, change| {
            steps.push(ScheduledAction { at_ms, action: ChaosAction::SpeedLimit { part: part.clone(), change } });
        };
        let speed_mps = *SPEEDS_MPS.choose(&mut chance).expect("there are three");
        let for_s = chance.random_bool(WITH_END).then(|| chance.random_range(CLOSE_S));
        push(at_ms, SpeedLimitAction::Set { speed_mps, for_s });
        if for_s.is_none() && chance.random_bool(CLEARED) {
            let clear_ms = (at_ms + chance.random_range(OPEN_AFTER_MS)).min(period_ms.end);
            push(clear_ms, SpeedLimitAction::Clear);
        }
    }
}

/// Returns the request of a person for a change of a speed limit.
pub(super) fn request(part: &MapPart, change: SpeedLimitAction) -> (ApiCall, Value) {
    let mut request = named(part);
    match change {
        SpeedLimitAction::Set { speed_mps, for_s } => {
            request["action"] = json!("set");
            request["speed_mps"] = json!(speed_mps);
            request["reason"] = json!("wet floor");
            if let Some(for_s) = for_s {
                request["for_s"] = json!(for_s);
            }
        }
        SpeedLimitAction::Clear => request["action"] = json!("clear"),
    }
    (ApiCall::Limit, request)
}

#[cfg(test)]
mod tests {
    use super::super::alarms::FIRST_SEED;
    use super::super::chaos_fleet::ChaosFleet;
    use super::super::fault_kind::FaultKind;
    use super::super::generate::generate;
    use super::*;
    use consort_protocol::api::{LimitAction, LimitRequest};

    #[test]
    fn some_later_runs_have_speed_limits_of_all_kinds() {
        let composition = ChaosFleet::of(7);
        let limits = |seed| -> Vec<(MapPart, SpeedLimitAction)> {
            let of = |step: &ScheduledAction| match &step.action {
                ChaosAction::SpeedLimit { part, change } => Some((part.clone(), *change)),
                _ => None,
            };
            generate(seed, &composition, 2.0, &FaultKind::FAULTS).steps.iter().filter_map(of).collect()
        };
        assert!((1..FIRST_SEED).all(|seed| limits(seed).is_empty()));
        let later: Vec<_> = (FIRST_SEED..FIRST_SEED + 60).map(limits).collect();
        assert!(later.iter().filter(|limits| limits.is_empty()).count() >= 5);
        let count = |is: &dyn Fn(&MapPart, SpeedLimitAction) -> bool| {
            later.iter().filter(|limits| limits.iter().any(|(part, change)| is(part, *change))).count()
        };
        assert!(count(&|part, _| matches!(part, MapPart::Zone(_))) >= 5);
        assert!(count(&|part, _| matches!(part, MapPart::Place(place) if place.as_str().contains("Room"))) >= 5);
        assert!(count(&|_, change| matches!(change, SpeedLimitAction::Set { for_s: Some(_), .. })) >= 3);
        assert!(count(&|_, change| change == SpeedLimitAction::Clear) >= 3);
    }

    #[test]
    fn requests_are_those_of_the_api() {
        for part in parts_with_zones() {
            let set = SpeedLimitAction::Set { speed_mps: 0.3, for_s: Some(60) };
            for (change, action) in [(set, LimitAction::Set), (SpeedLimitAction::Clear, LimitAction::Clear)] {
                let (call, payload) = request(&part, change);
                let parsed: LimitRequest = serde_json::from_value(payload).unwrap();
                assert_eq!((call, parsed.action, parsed.for_s.is_some()), (ApiCall::Limit, action, change == set));
                assert_eq!(parsed.places.len() + parsed.lanes.len(), 1, "{part}");
            }
        }
    }
}
