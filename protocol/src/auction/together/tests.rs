use super::super::bid::{AuctionId, BidLimits, RoleReply};
use super::super::energy::EnergyBudget;
use super::super::insertion::{Objective, Timelines};
use super::super::invitation::Invitation;
use super::*;
use crate::plan::LocalPlan;
use crate::units::{BatteryShare, Energy, EnergyLimit, Seconds};
use proptest::prelude::*;

fn auction(mission: usize) -> AuctionId {
    AuctionId { mission: format!("m-{mission}").parse().unwrap(), term: 1, round: 1 }
}

/// Times of the bids for a mission: for each of its roles those of the robots `a`, `b`, …; `None` for no bid.
type Times = Vec<Vec<Option<u8>>>;

fn role(number: usize) -> RoleId {
    format!("r{number}").parse().unwrap()
}

fn robot(number: usize) -> RobotId {
    format!("robot-{number}").parse().unwrap()
}

fn call(mission: usize, times: &[Vec<Option<u8>>]) -> CallForBids {
    CallForBids {
        auction: auction(mission),
        ensembles: vec![],
        roles: (0..times.len()).map(|number| (role(number), LocalPlan::of(role(number), vec![]))).collect(),
        eligible: BTreeMap::new(),
        spread: BTreeSet::new(),
        timelines: Timelines { objective: Objective::EarliestEnd, ..Timelines::default() },
    }
}

fn responses(mission: usize, times: &[Vec<Option<u8>>]) -> Vec<BidResponse> {
    let mut replies: BTreeMap<usize, Vec<RoleReply>> = BTreeMap::new();
    for (number, times) in times.iter().enumerate() {
        for (of, time) in times.iter().enumerate().filter_map(|(of, time)| Some((of, (*time)?))) {
            let bid = Bid {
                robot: robot(of),
                role: role(number),
                time: Seconds::new(f64::from(time)).unwrap(),
                energy: 0.1,
                remaining: 0.5,
                useful_charge: BatteryShare::new(0.1).unwrap(),
                from: "dock".parse().unwrap(),
                age_ms: 0,
                parts: vec![],
                present: None,
                planned: None,
            };
            replies.entry(of).or_default().push(RoleReply::Bid(bid));
        }
    }
    let response = |(of, replies)| BidResponse { robot: robot(of), auction: auction(mission), replies };
    replies.into_iter().map(response).collect()
}

/// Returns the numbers of the robots of each mission. The missions in `bounded` have a bound on energy.
fn allocate(missions: &[Times], bounded: &[usize]) -> Vec<Vec<usize>> {
    let numbered = || missions.iter().enumerate();
    let calls: Vec<CallForBids> = numbered().map(|(mission, times)| call(mission, times)).collect();
    let bids: Vec<Vec<BidResponse>> = numbered().map(|(mission, times)| responses(mission, times)).collect();
    let (invitation, unavailable, excluded) = (Invitation::default(), BTreeMap::new(), BTreeMap::new());
    let (limits, limit) = (BidLimits::default(), EnergyLimit::new(9.0).unwrap());
    let asked_all = Candidates::default();
    let open = |(index, (call, responses))| OpenAuction {
        call,
        responses,
        candidates: &asked_all,
        context: AuctionContext {
            invitation: &invitation,
            unavailable: &unavailable,
            excluded: &excluded,
            limits: &limits,
            energy: bounded.contains(&index).then_some(EnergyBudget { limit, used: Energy::ZERO }),
            promises: None,
            window_ms: 200,
            at_ms: 0,
        },
    };
    let responses = bids.iter().map(Vec::as_slice);
    let auctions: Vec<OpenAuction<'_>> = calls.iter().zip(responses).enumerate().map(open).collect();
    let number = |robot: &RobotId| robot.as_str().trim_start_matches("robot-").parse().unwrap();
    allocate_together(&auctions).iter().map(|robots| robots.values().map(number).collect()).collect()
}

#[test]
fn the_first_mission_leaves_a_robot_to_a_mission_that_needs_it_more() {
    let missions = [vec![vec![Some(10), Some(12)]], vec![vec![Some(11), Some(90)]]];
    assert_eq!(allocate(&missions, &[]), [[1], [0]]);
    assert_eq!(allocate(&missions, &[1]), [vec![0], vec![]], "costs alone do not decide about the second");
}

#[test]
fn missions_that_cannot_be_filled_beside_earlier_ones_are_left_out() {
    let two_roles = vec![vec![Some(10), Some(12)], vec![Some(10), Some(20)]];
    let one_role = vec![vec![Some(1), Some(1), Some(60)]];
    let none: Times = vec![vec![None, None]];
    let allocation = allocate(&[none, two_roles.clone(), one_role, two_roles], &[]);
    assert_eq!(allocation, [vec![], vec![1, 0], vec![2], vec![]]);
}

#[test]
fn the_number_of_roles_that_are_allocated_together_is_bounded() {
    let calls: Vec<CallForBids> = (0..40).map(|mission| call(mission, &[vec![], vec![], vec![]])).collect();
    assert_eq!(joint_count(&calls), JOINT_ROLES_MAX / 3);
    assert_eq!(joint_count(&calls[..2]), 2);
}

proptest! {
    /// No other choice of robots for all roles costs less.
    #[test]
    fn the_sum_of_all_costs_is_minimal(
        missions in prop::collection::vec(prop::collection::vec(prop::collection::vec(1_u8..100, 4), 1..3), 1..3),
    ) {
        let times: Vec<Times> = missions.iter()
            .map(|roles| roles.iter().map(|times| times.iter().copied().map(Some).collect()).collect()).collect();
        let roles: Vec<&Vec<u8>> = missions.iter().flatten().collect();
        let cost_of = |robots: &[usize]| -> u32 {
            roles.iter().zip(robots).map(|(times, robot)| u32::from(times[*robot])).sum()
        };
        let robots: Vec<usize> = allocate(&times, &[]).into_iter().flatten().collect();
        prop_assert_eq!(robots.len(), roles.len());
        prop_assert_eq!(robots.iter().collect::<BTreeSet<_>>().len(), robots.len());
        let mut least = u32::MAX;
        for code in 0..4_usize.pow(4) {
            let choice: Vec<usize> = (0..roles.len()).map(|place| code / 4_usize.pow(place as u32) % 4).collect();
            if choice.iter().collect::<BTreeSet<_>>().len() == choice.len() {
                least = least.min(cost_of(&choice));
            }
        }
        prop_assert_eq!(cost_of(&robots), least);
    }
}
