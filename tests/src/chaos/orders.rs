//! Orders of people to robots, which some runs contain: hold and maintenance.

use super::chaos_fleet::ChaosFleet;
use super::fault_kind::FaultKind;
use super::person_action::{ALL_ROBOTS, IN_ZONE, OrderAction};
use super::schedule::{CARRIER_OF, ChaosAction, ScheduledAction};
use consort_protocol::keys::ApiCall;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::ops::{Range, RangeInclusive};

/// First seed with orders and with chargers. Smaller seeds keep their schedules: mutation checks, the scoreboard and
/// the sweeps of closed fleets use them.
pub(super) const FIRST_SEED: u64 = 121;

/// Shares of the runs with holds and with a maintenance.
const HELD: f64 = 0.6;
const MAINTAINED: f64 = 0.3;

/// Number of holds in such a run, and their durations. A robot may act for some seconds after a hold, and its end is
/// uncertain by some seconds, since clocks drift.
const HOLDS: RangeInclusive<usize> = 1..=4;
pub(super) const HOLD_S: RangeInclusive<u32> = 30..=90;

/// Shares of the holds of all robots, of the carrier of a request, and of those that are released before their end.
const OF_ALL: f64 = 0.2;
const OF_CARRIER: f64 = 0.5;
pub(super) const RELEASED: f64 = 0.4;

/// Time from a request to the hold of its carrier, which is on its way then.
const AFTER_REQUEST_MS: RangeInclusive<u64> = 1_000..=8_000;

/// Adds orders in this period, from a generator of their own. Runs with missions that cannot be completed as the only
/// faults, which bound the time of the others, have none.
pub(super) fn add_orders(
    seed: u64,
    kinds: &[FaultKind],
    composition: &ChaosFleet,
    period_ms: Range<u64>,
    steps: &mut Vec<ScheduledAction>,
) {
    if seed < FIRST_SEED || kinds == [FaultKind::Poison] {
        return;
    }
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0x0a5d_e5ed);
    let (is_held, is_maintained) = (chance.random_bool(HELD), chance.random_bool(MAINTAINED));
    let robots: Vec<&str> = composition.carriers.iter().chain(&composition.arms).copied().collect();
    let requests: Vec<(u64, String)> =
        steps.iter().filter_map(|step| Some((step.at_ms, step.action.submitted_request()?))).collect();
    let (first_ms, end_ms) = (period_ms.start, period_ms.end);
    let latest_ms = end_ms - 1_000;
    let mut push = |at_ms, robot: &str, change| {
        steps.push(ScheduledAction { at_ms, action: ChaosAction::Order { robot: robot.to_owned(), change } });
    };
    if is_held {
        for _ in 0..chance.random_range(HOLDS) {
            let (mut at_ms, mut robot) = (chance.random_range(first_ms..latest_ms), ALL_ROBOTS.to_owned());
            if !chance.random_bool(OF_ALL) {
                robot = (*robots.choose(&mut chance).expect("there is the arm")).to_owned();
                let request = requests.choose(&mut chance).filter(|_| chance.random_bool(OF_CARRIER));
                if let Some((asked_ms, request)) = request {
                    at_ms = (asked_ms + chance.random_range(AFTER_REQUEST_MS)).clamp(first_ms, latest_ms);
                    robot = format!("{CARRIER_OF}{request}");
                }
            }
            let for_s = chance.random_range(HOLD_S);
            push(at_ms, &robot, OrderAction::Hold { for_s });
            if chance.random_bool(RELEASED) {
                let over_ms = (at_ms + u64::from(for_s) * 1_000).min(end_ms);
                // Another robot may be the carrier by then.
                let robot = if robot.starts_with(CARRIER_OF) { ALL_ROBOTS } else { robot.as_str() };
                push(chance.random_range(at_ms..over_ms), robot, OrderAction::Release);
            }
        }
    }
    if is_maintained {
        let robot = *robots.choose(&mut chance).expect("there is the arm");
        let at_ms = chance.random_range(first_ms..latest_ms);
        push(at_ms, robot, OrderAction::BeginMaintenance);
        push(chance.random_range(at_ms..end_ms), robot, OrderAction::EndMaintenance);
    }
}

/// Returns the request of a person for a change of the orders to a robot, to the robots in a zone, or to all robots.
pub(super) fn request(robot: &str, change: OrderAction) -> (ApiCall, Value) {
    let robots = match robot.strip_prefix(IN_ZONE) {
        Some(zone) => json!({ "zone": zone }),
        None if robot == ALL_ROBOTS => json!("all"),
        None => json!([robot]),
    };
    match change {
        OrderAction::Hold { for_s } => {
            (ApiCall::Hold, json!({ "robots": robots, "for_s": for_s, "reason": "a spill" }))
        }
        OrderAction::Release => (ApiCall::Release, json!({ "robots": robots })),
        OrderAction::BeginMaintenance => {
            (ApiCall::Maintenance, json!({ "robots": robots, "action": "begin", "reason": "new tyres" }))
        }
        OrderAction::EndMaintenance => (ApiCall::Maintenance, json!({ "robots": robots, "action": "end" })),
    }
}

#[cfg(test)]
mod tests {
    use super::super::chaos_fleet::ARM;
    use super::super::generate::{assert_valid, drawn};
    use super::*;
    use consort_protocol::api::{HoldRequest, MaintenanceRequest, ReleaseRequest};

    fn orders(seed: u64, kinds: &[FaultKind]) -> Vec<(String, OrderAction)> {
        drawn(seed, kinds, |step| match &step.action {
            ChaosAction::Order { robot, change } => Some((robot.clone(), *change)),
            _ => None,
        })
    }

    #[test]
    fn some_later_runs_have_orders_of_all_kinds() {
        assert!((1..FIRST_SEED).all(|seed| orders(seed, &FaultKind::FAULTS).is_empty()));
        let later: Vec<_> = (FIRST_SEED..FIRST_SEED + 60).map(|seed| orders(seed, &FaultKind::FAULTS)).collect();
        assert!(later.iter().filter(|orders| orders.is_empty()).count() >= 8);
        let count = |is: &dyn Fn(&str, OrderAction) -> bool| {
            later.iter().filter(|orders| orders.iter().any(|(robot, change)| is(robot, *change))).count()
        };
        assert!(count(&|robot, change| robot == ALL_ROBOTS && matches!(change, OrderAction::Hold { .. })) >= 3);
        assert!(count(&|robot, _| robot.starts_with(CARRIER_OF)) >= 3);
        assert!(count(&|_, change| change == OrderAction::Release) >= 3);
        assert!(count(&|_, change| change == OrderAction::BeginMaintenance) >= 3);
        assert_eq!(
            count(&|_, change| change == OrderAction::BeginMaintenance),
            count(&|_, change| change == OrderAction::EndMaintenance)
        );
        assert!((FIRST_SEED..FIRST_SEED + 60).all(|seed| orders(seed, &[FaultKind::Poison]).is_empty()));
    }

    #[test]
    fn schedules_with_orders_are_valid_and_read_back_unchanged() {
        assert_valid(FIRST_SEED..FIRST_SEED + 30);
    }

    #[test]
    fn requests_are_those_of_the_api() {
        use OrderAction::{BeginMaintenance, EndMaintenance, Hold, Release};
        for robot in [ALL_ROBOTS, ARM, "zone icu"] {
            serde_json::from_value::<HoldRequest>(request(robot, Hold { for_s: 30 }).1).unwrap();
            serde_json::from_value::<ReleaseRequest>(request(robot, Release).1).unwrap();
            for change in [BeginMaintenance, EndMaintenance] {
                serde_json::from_value::<MaintenanceRequest>(request(robot, change).1).unwrap();
            }
        }
    }
}
