//! Closures of places and lanes by a person, which some runs contain.

use super::fault_kind::FaultKind;
use super::person_action::ClosureAction;
use super::schedule::{ChaosAction, ScheduledAction};
use crate::slug;
use consort_protocol::ids::PlaceId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::MapPart;
use consort_world::map;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::ops::{Range, RangeInclusive};

/// First seed with closures. Smaller seeds keep their schedules: mutation checks, the scoreboard and the sweeps of
/// closed fleets use them.
pub(super) const FIRST_SEED: u64 = 151;

/// Share of the runs with closures, and their number.
const RUNS: f64 = 0.7;
const CLOSURES: RangeInclusive<usize> = 1..=3;

/// Shares of the closures of the room of a request, which its mission needs, and of those that end by themselves.
const OF_ROOM: f64 = 0.6;
const WITH_END: f64 = 0.3;

/// Share of the closures without an end that a person opens. The others are opened when all faults have ended.
const OPENED: f64 = 0.5;

/// Durations. A robot may ignore a closure for some seconds, and its end is uncertain by some seconds, since clocks drift.
pub(super) const CLOSE_S: RangeInclusive<u32> = 45..=120;
pub(super) const OPEN_AFTER_MS: RangeInclusive<u64> = 20_000..=90_000;

/// Longest times by which a room is closed before and after its request: the mission waits, or its robot is on its way.
const BEFORE_REQUEST_MS: u64 = 20_000;
const AFTER_REQUEST_MS: u64 = 4_000;

/// Adds closures in this period, from a generator of their own. Runs with missions that cannot be completed as the only
/// faults, which bound the time of the others, have none.
pub(super) fn add_closures(seed: u64, kinds: &[FaultKind], period_ms: Range<u64>, steps: &mut Vec<ScheduledAction>) {
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0xc105_ed0a);
    if seed < FIRST_SEED || kinds == [FaultKind::Poison] || !chance.random_bool(RUNS) {
        return;
    }
    let requests: Vec<(u64, PlaceId)> = steps
        .iter()
        .filter_map(|step| match &step.action {
            ChaosAction::Submit { room, .. } => Some((step.at_ms, slug(room))),
            _ => None,
        })
        .collect();
    let parts = parts_of_map();
    let (first_ms, latest_ms) = (period_ms.start, period_ms.end - 1_000);
    let mut push = |at_ms, part: &MapPart, change| {
        steps.push(ScheduledAction { at_ms, action: ChaosAction::Closure { part: part.clone(), change } });
    };
    for _ in 0..chance.random_range(CLOSURES) {
        let mut at_ms = chance.random_range(first_ms..latest_ms);
        let mut part = parts.choose(&mut chance).expect("the map has places").clone();
        let request = requests.choose(&mut chance).filter(|_| chance.random_bool(OF_ROOM));
        if let Some((asked_ms, room)) = request {
            let from_ms = asked_ms.saturating_sub(BEFORE_REQUEST_MS);
            at_ms = chance.random_range(from_ms..=asked_ms + AFTER_REQUEST_MS).clamp(first_ms, latest_ms);
            part = MapPart::Place(room.clone());
        }
        if chance.random_bool(WITH_END) {
            push(at_ms, &part, ClosureAction::Close { for_s: Some(chance.random_range(CLOSE_S)) });
            continue;
        }
        push(at_ms, &part, ClosureAction::Close { for_s: None });
        if chance.random_bool(OPENED) {
            let open_ms = (at_ms + chance.random_range(OPEN_AFTER_MS)).min(period_ms.end);
            push(open_ms, &part, ClosureAction::Open);
        }
    }
}

/// Returns the places and lanes of the hospital.
pub(super) fn parts_of_map() -> Vec<MapPart> {
    let map = map::shipped("hospital").expect("the shipped map is sound").topology();
    let places = map.places.into_keys().map(MapPart::Place);
    places.chain(map.edges.into_iter().map(|edge| MapPart::of_lane(edge.a, edge.b))).collect()
}

/// Returns the fields of a request that name a zone, a place or a lane.
pub(super) fn named(part: &MapPart) -> Value {
    match part {
        MapPart::Zone(zone) => json!({ "places": [zone.name] }),
        MapPart::Place(place) => json!({ "places": [place] }),
        MapPart::Lane(a, b) => json!({ "lanes": [[a, b]] }),
    }
}

/// Returns the request of a person for a change of a closure.
pub(super) fn request(part: &MapPart, change: ClosureAction) -> (ApiCall, Value) {
    let mut request = named(part);
    match change {
        ClosureAction::Close { for_s } => {
            request["reason"] = json!("a spill");
            if let Some(for_s) = for_s {
                request["for_s"] = json!(for_s);
            }
            (ApiCall::Close, request)
        }
        ClosureAction::Open => (ApiCall::Open, request),
    }
}

#[cfg(test)]
mod tests {
    use super::super::generate::{assert_valid, drawn};
    use super::*;
    use consort_protocol::api::{CloseRequest, OpenRequest};

    fn closures(seed: u64, kinds: &[FaultKind]) -> Vec<(MapPart, ClosureAction)> {
        drawn(seed, kinds, |step| match &step.action {
            ChaosAction::Closure { part, change } => Some((part.clone(), *change)),
            _ => None,
        })
    }

    #[test]
    fn some_later_runs_have_closures_of_all_kinds() {
        assert!((1..FIRST_SEED).all(|seed| closures(seed, &FaultKind::FAULTS).is_empty()));
        let later: Vec<_> = (FIRST_SEED..FIRST_SEED + 60).map(|seed| closures(seed, &FaultKind::FAULTS)).collect();
        assert!(later.iter().filter(|closures| closures.is_empty()).count() >= 5);
        let count = |is: &dyn Fn(&MapPart, ClosureAction) -> bool| {
            later.iter().filter(|closures| closures.iter().any(|(part, change)| is(part, *change))).count()
        };
        assert!(count(&|part, _| matches!(part, MapPart::Lane(..))) >= 3);
        assert!(count(&|part, _| matches!(part, MapPart::Place(place) if place.as_str().contains("Room"))) >= 10);
        assert!(count(&|_, change| matches!(change, ClosureAction::Close { for_s: Some(_) })) >= 3);
        assert!(count(&|_, change| change == ClosureAction::Close { for_s: None }) >= 3);
        assert!(count(&|_, change| change == ClosureAction::Open) >= 3);
        assert!((FIRST_SEED..FIRST_SEED + 60).all(|seed| closures(seed, &[FaultKind::Poison]).is_empty()));
    }

    #[test]
    fn schedules_with_closures_are_valid_and_read_back_unchanged() {
        assert_valid(FIRST_SEED..FIRST_SEED + 30);
    }

    #[test]
    fn requests_are_those_of_the_api() {
        for part in [MapPart::Place(slug("Dock")), MapPart::of_lane(slug("Dock"), slug("Crossing"))] {
            for for_s in [None, Some(60)] {
                let (call, close) = request(&part, ClosureAction::Close { for_s });
                assert_eq!(
                    (call, serde_json::from_value::<CloseRequest>(close).unwrap().for_s),
                    (ApiCall::Close, for_s)
                );
            }
            let (call, open) = request(&part, ClosureAction::Open);
            let OpenRequest { places, lanes, .. } = serde_json::from_value(open).unwrap();
            let of_lane = matches!(part, MapPart::Lane(..));
            assert_eq!((call, places.is_empty(), lanes.is_empty()), (ApiCall::Open, of_lane, !of_lane));
        }
    }
}
