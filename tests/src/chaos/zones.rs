//! Zones of the fleet, and orders of people about zones, which some runs contain: robots are held in a zone, or it is
//! closed.

use super::closures::{CLOSE_S, OPEN_AFTER_MS, parts_of_map};
use super::orders::{HOLD_S, RELEASED};
use super::person_action::{ALL_ROBOTS, ClosureAction, IN_ZONE, OrderAction};
use super::schedule::{ChaosAction, ScheduledAction};
use crate::slug;
use consort_protocol::ids::{PlaceId, ZoneId};
use consort_protocol::ledger::{MapPart, Zone};
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::{Range, RangeInclusive};

/// The zones by their names and places: the way between all wings, and the wing of most missions.
const ZONES: [(&str, &[&str]); 2] = [
    ("junction", &["Crossing", "Laboratory Corridor"]),
    (
        "icu",
        &[
            "IC Corridor 1",
            "IC Corridor 2",
            "IC Corridor 3",
            "IC Corridor 4",
            "IC Corridor 5",
            "IC Corridor 6",
            "IC Room 1",
            "IC Room 2",
            "IC Room 3",
            "IC Room 4",
            "IC Room 5",
            "IC Room 6",
        ],
    ),
];

/// Share of the runs with orders about zones, and their number.
const RUNS: f64 = 0.5;
const ORDERS: RangeInclusive<usize> = 1..=2;

/// Share of the orders that hold robots. The others close the zone.
const HOLDS: f64 = 0.5;

/// Share of the closures that end by themselves. A person opens the others.
const WITH_END: f64 = 0.3;

/// Adds orders about zones in this period, from a generator of their own.
pub(super) fn add_zone_orders(seed: u64, period_ms: Range<u64>, steps: &mut Vec<ScheduledAction>) {
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0x20_4e0d);
    if !chance.random_bool(RUNS) {
        return;
    }
    let latest_ms = period_ms.end - 1_000;
    for _ in 0..chance.random_range(ORDERS) {
        let at_ms = chance.random_range(period_ms.start..latest_ms);
        let mut push = |at_ms, action| steps.push(ScheduledAction { at_ms, action });
        if chance.random_bool(HOLDS) {
            let order = |robot: &str, change| ChaosAction::Order { robot: robot.to_owned(), change };
            let for_s = chance.random_range(HOLD_S);
            let in_zone =
                zone_names().choose(&mut chance).map(|zone| format!("{IN_ZONE}{zone}")).expect("there are two");
            push(at_ms, order(&in_zone, OrderAction::Hold { for_s }));
            if chance.random_bool(RELEASED) {
                let over_ms = (at_ms + u64::from(for_s) * 1_000).min(period_ms.end);
                // Other robots may be in the zone by then.
                push(chance.random_range(at_ms..over_ms), order(ALL_ROBOTS, OrderAction::Release));
            }
            continue;
        }
        let part = zone_parts().choose(&mut chance).expect("there are two").clone();
        let closure = |change| ChaosAction::Closure { part: part.clone(), change };
        if chance.random_bool(WITH_END) {
            push(at_ms, closure(ClosureAction::Close { for_s: Some(chance.random_range(CLOSE_S)) }));
            continue;
        }
        push(at_ms, closure(ClosureAction::Close { for_s: None }));
        let open_ms = (at_ms + chance.random_range(OPEN_AFTER_MS)).min(period_ms.end);
        push(open_ms, closure(ClosureAction::Open));
    }
}

/// Returns the zones, as the fleet declares them.
pub(super) fn zones() -> BTreeMap<ZoneId, BTreeSet<PlaceId>> {
    let places = |places: &[&str]| -> BTreeSet<PlaceId> { places.iter().map(|place| slug(place)).collect() };
    BTreeMap::from(ZONES.map(|(zone, of)| (slug::<ZoneId>(zone), places(of))))
}

/// Returns the names of the zones.
pub(super) fn zone_names() -> Vec<&'static str> {
    ZONES.map(|(zone, _)| zone).to_vec()
}

/// Returns the zones as parts of the map.
pub(super) fn zone_parts() -> Vec<MapPart> {
    zones().into_iter().map(|(name, places)| MapPart::Zone(Zone { name, places })).collect()
}

/// Returns the zones, places and lanes of the hospital.
pub(super) fn parts_with_zones() -> Vec<MapPart> {
    zone_parts().into_iter().chain(parts_of_map()).collect()
}

#[cfg(test)]
mod tests {
    use super::super::alarms::FIRST_SEED;
    use super::super::chaos_fleet::ChaosFleet;
    use super::super::fault_kind::FaultKind;
    use super::super::generate::generate;
    use super::*;

    #[test]
    fn every_place_of_a_zone_is_on_the_map() {
        let known = parts_of_map();
        assert!(zones().into_values().flatten().all(|place| known.contains(&MapPart::Place(place))));
    }

    #[test]
    fn some_later_runs_hold_robots_in_zones_and_close_zones() {
        let schedules = |seeds: Range<u64>| {
            let composition = ChaosFleet::of(7);
            seeds.map(|seed| generate(seed, &composition, 2.0, &FaultKind::FAULTS)).collect::<Vec<_>>()
        };
        assert!(schedules(1..FIRST_SEED).iter().all(|schedule| !schedule.names_zones()));
        let later = schedules(FIRST_SEED..FIRST_SEED + 60);
        let count = |is: &dyn Fn(&ChaosAction) -> bool| {
            later.iter().filter(|schedule| schedule.steps.iter().any(|step| is(&step.action))).count()
        };
        assert!(later.iter().filter(|schedule| !schedule.names_zones()).count() >= 5);
        assert!(count(&|action| matches!(action, ChaosAction::Order { robot, .. } if robot.starts_with(IN_ZONE))) >= 5);
        assert!(count(&|action| matches!(action, ChaosAction::Closure { part: MapPart::Zone(_), .. })) >= 5);
    }
}
