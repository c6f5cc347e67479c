use super::*;
use crate::auction::EnergyBudget;
use crate::ids::PlaceId;
use crate::units::{BatteryShare, Energy, EnergyLimit, Seconds};
use proptest::prelude::*;

fn bid(robot: &str, role: &str, time: f64) -> Bid {
    Bid {
        robot: RobotId::new(robot).unwrap(),
        role: RoleId::new(role).unwrap(),
        time: Seconds::new(time).unwrap(),
        energy: 0.1,
        remaining: 0.5,
        useful_charge: BatteryShare::new(0.08).unwrap(),
        from: PlaceId::new("dock").unwrap(),
        age_ms: 0,
        parts: vec![],
        present: None,
        planned: None,
    }
}

fn roles(names: &[&str]) -> BTreeSet<RoleId> {
    names.iter().map(|name| RoleId::new(*name).unwrap()).collect()
}

fn chosen(names: &[&str], bids: &[Bid]) -> Result<Vec<String>, AssignmentError> {
    let picks = optimal_assignment(&roles(names), &BTreeSet::new(), bids, Objective::EarliestEnd)?;
    Ok(picks.values().map(|index| bids[*index].robot.to_string()).collect())
}

#[test]
fn a_robot_fills_only_1_role_even_if_it_is_fastest_for_both() {
    let bids = [bid("ada", "r1", 10.0), bid("ada", "r2", 10.0), bid("bob", "r1", 12.0), bid("bob", "r2", 30.0)];
    assert_eq!(chosen(&["r1", "r2"], &bids).unwrap(), ["bob", "ada"]);
}

#[test]
fn a_bid_without_a_cost_is_the_last() {
    let endless = Bid { energy: f64::INFINITY, ..bid("ada", "r1", 10.0) };
    let bids = [endless, Bid { energy: f64::NAN, ..bid("bob", "r1", 10.0) }, bid("cyd", "r1", 90.0)];
    for objective in [Objective::EarliestEnd, Objective::LeastEnergy] {
        let picks = optimal_assignment(&roles(&["r1"]), &BTreeSet::new(), &bids, objective).unwrap();
        assert_eq!(picks.into_values().collect::<Vec<_>>(), [2], "{objective:?}");
    }
}

#[test]
fn a_tie_is_resolved_by_the_order_of_names() {
    let bids = [bid("cyd", "r1", 10.0), bid("bob", "r1", 10.0), bid("ada", "r1", 10.000_001)];
    assert_eq!(chosen(&["r1"], &bids).unwrap(), ["bob"]);
}

#[test]
fn a_mission_is_filled_completely_or_not_at_all() {
    let bids = [bid("ada", "r1", 10.0), bid("ada", "r2", 10.0)];
    assert_eq!(
        chosen(&["r1", "r2"], &bids).unwrap_err().to_string(),
        "2 roles cannot be filled by different robots: viable bids came only from ada"
    );
    assert_eq!(chosen(&["r1", "r3"], &bids).unwrap_err().to_string(), "no viable bid for r3");
}

#[test]
fn an_impossible_pair_is_never_chosen() {
    // bob bids on r2 and r3 only, ada and cyd on r1 only: r2 and r3 cannot both be filled.
    let bids = [bid("ada", "r1", 1.0), bid("bob", "r2", 1.0), bid("bob", "r3", 1.0), bid("cyd", "r1", 2.0)];
    assert!(matches!(chosen(&["r1", "r2", "r3"], &bids), Err(AssignmentError::TooFewRobots { .. })));
}

#[test]
fn a_bid_must_leave_more_than_both_minimum_charges() {
    use crate::auction::{BidLimits, ViabilityError};
    let mut ada = bid("ada", "r1", 10.0);
    ada.remaining = 0.08;
    let floor = BatteryShare::new(0.08).unwrap();
    assert_eq!(ada.check_viable(&BidLimits::default()), Err(ViabilityError::LowCharge { remaining: 0.08, floor }));
    ada.remaining = 0.081;
    assert_eq!(ada.check_viable(&BidLimits::default()), Ok(()));
    let limit = Seconds::new(9.0).unwrap();
    let limits = BidLimits { time: Some(limit), ..BidLimits::default() };
    assert_eq!(ada.check_viable(&limits), Err(ViabilityError::TooSlow { time: ada.time, limit }));
}

/// Tries all assignments of different robots to roles and returns the smallest sum of
/// microseconds.
fn cheapest(costs: &[Vec<Option<u64>>], row: usize, taken: &mut Vec<bool>) -> Option<u64> {
    let Some(costs_by_pair) = costs.get(row) else { return Some(0) };
    let mut best = None;
    for (robot, offer) in costs_by_pair.iter().enumerate() {
        let Some(cost) = offer.filter(|_| !taken[robot]) else { continue };
        taken[robot] = true;
        if let Some(rest) = cheapest(costs, row + 1, taken) {
            best = Some(best.map_or(cost + rest, |b: u64| b.min(cost + rest)));
        }
        taken[robot] = false;
    }
    best
}

/// Tries all assignments of different robots to roles, where roles may stay open, and returns the smallest number
/// of open roles and the smallest sum of microseconds with it.
fn most_filled(costs: &[Vec<Option<u64>>], spread: &[bool], row: usize, taken: &mut Vec<bool>) -> Option<(u64, u64)> {
    let Some(costs_by_pair) = costs.get(row) else { return Some((0, 0)) };
    let mut found = vec![];
    if spread[row] {
        found.extend(most_filled(costs, spread, row + 1, taken).map(|(open, cost)| (open + 1, cost)));
    }
    for (robot, offer) in costs_by_pair.iter().enumerate() {
        let Some(cost) = offer.filter(|_| !taken[robot]) else { continue };
        taken[robot] = true;
        found.extend(most_filled(costs, spread, row + 1, taken).map(|(open, rest)| (open, cost + rest)));
        taken[robot] = false;
    }
    found.into_iter().min()
}

proptest! {
    #[test]
    fn as_many_spread_roles_as_possible_are_assigned(
        costs in (1usize..5, 1usize..5).prop_flat_map(|(rows, columns)| {
            prop::collection::vec(prop::collection::vec(prop::option::weighted(0.7, 1u64..50), columns), rows)
        }),
        spread in prop::collection::vec(prop::bool::weighted(0.7), 4),
    ) {
        let mut bids = vec![];
        for (row, costs_by_pair) in costs.iter().enumerate() {
            for (robot, offer) in costs_by_pair.iter().enumerate() {
                bids.extend(offer.map(|seconds| bid(&format!("robot{robot}"), &format!("role{row}"), seconds as f64)));
            }
        }
        let role = |row: usize| RoleId::new(format!("role{row}")).unwrap();
        let roles: BTreeSet<RoleId> = (0..costs.len()).map(role).collect();
        let may_stay_open = (0..costs.len()).filter(|row| spread[*row]).map(role).collect();
        let found = optimal_assignment(&roles, &may_stay_open, &bids, Objective::EarliestEnd).ok();
        let found = found.map(|picks| {
            let robots: BTreeSet<_> = picks.values().map(|index| &bids[*index].robot).collect();
            assert_eq!(robots.len(), picks.len());
            assert!(roles.iter().all(|role| picks.contains_key(role) || may_stay_open.contains(role)));
            let open = (roles.len() - picks.len()) as u64;
            (open, picks.values().map(|i| bids[*i].time.get() as u64).sum::<u64>())
        });
        let expected = most_filled(&costs, &spread, 0, &mut vec![false; costs[0].len()]);
        prop_assert_eq!(found, expected.filter(|(open, _)| *open < roles.len() as u64));
    }

    #[test]
    fn the_assignment_is_the_cheapest_of_all(
        costs in (1usize..4, 1usize..6).prop_flat_map(|(rows, columns)| {
            prop::collection::vec(prop::collection::vec(prop::option::weighted(0.7, 1u64..50), columns), rows)
        })
    ) {
        let mut bids = vec![];
        for (row, costs_by_pair) in costs.iter().enumerate() {
            for (robot, offer) in costs_by_pair.iter().enumerate() {
                if let Some(seconds) = offer {
                    bids.push(bid(&format!("robot{robot}"), &format!("role{row}"), *seconds as f64));
                }
            }
        }
        let roles = (0..costs.len()).map(|row| RoleId::new(format!("role{row}")).unwrap()).collect();
        let expected = cheapest(&costs, 0, &mut vec![false; costs[0].len()]);
        let found = optimal_assignment(&roles, &BTreeSet::new(), &bids, Objective::EarliestEnd).ok();
        let total = found.as_ref().map(|picks| picks.values().map(|i| bids[*i].time.get() as u64).sum::<u64>());
        prop_assert_eq!(total, expected);
        if let Some(picks) = found {
            let robots: BTreeSet<_> = picks.values().map(|index| &bids[*index].robot).collect();
            prop_assert_eq!(robots.len(), picks.len());
        }
    }

    #[test]
    fn beyond_the_bound_the_assignment_has_the_least_energy(
        offers in (1usize..4, 1usize..6).prop_flat_map(|(rows, columns)| {
            let offer = prop::option::weighted(0.7, (1u64..50, 1u64..50));
            prop::collection::vec(prop::collection::vec(offer, columns), rows)
        }),
        limit in 1u64..150,
        used in 0u64..50,
    ) {
        let percent = |share: u64| share as f64 / 100.0;
        let mut bids = vec![];
        for (row, by_robot) in offers.iter().enumerate() {
            for (robot, offer) in by_robot.iter().enumerate() {
                if let Some((seconds, energy)) = offer {
                    let bid = bid(&format!("robot{robot}"), &format!("role{row}"), *seconds as f64);
                    bids.push(Bid { energy: percent(*energy), ..bid });
                }
            }
        }
        let roles = (0..offers.len()).map(|row| RoleId::new(format!("role{row}")).unwrap()).collect();
        let Ok(picks) = optimal_assignment(&roles, &BTreeSet::new(), &bids, Objective::EarliestEnd) else { return Ok(()) };
        let fastest: BTreeMap<_, _> = picks.into_iter().map(|(role, i)| (role, bids[i].robot.clone())).collect();
        let energy_of = |holders: &BTreeMap<RoleId, RobotId>| {
            let of = |(role, robot): (&RoleId, &RobotId)| bids.iter().find(|bid| bid.role == *role && bid.robot == *robot).unwrap().energy;
            holders.iter().map(of).sum::<f64>()
        };
        let energies: Vec<Vec<_>> =
            offers.iter().map(|row| row.iter().map(|offer| offer.map(|(_, energy)| energy)).collect()).collect();
        let least = cheapest(&energies, 0, &mut vec![false; offers[0].len()]).unwrap();
        let budget = EnergyBudget { limit: EnergyLimit::new(percent(limit)).unwrap(), used: Energy::new(percent(used)).unwrap() };
        let viable: Vec<&Bid> = bids.iter().collect();
        match budget.restrict(fastest.clone(), &viable) {
            Ok(holders) if energy_of(&fastest) + percent(used) <= percent(limit) + 1e-9 => prop_assert_eq!(holders, fastest),
            Ok(holders) => {
                prop_assert!(least + used <= limit);
                prop_assert!((energy_of(&holders) - percent(least)).abs() < 1e-9, "{:?}", holders);
            }
            Err(_) => prop_assert!(least + used > limit),
        }
    }
}
