mod insertion;

use super::super::bid::{AuctionId, Bid, BidLimits, PresentRole, RoleEstimate, RoleReply};
use super::super::clearing::{AuctionOutcome, clear_auction};
use super::super::insertion::{Objective, Timelines};
use super::super::invitation::Invitation;
use super::super::promise::{PromiseContext, PromiseTerms, RobotQueue};
use super::super::together::{OpenAuction, allocate_together};
use super::*;
use crate::ids::MissionId;
use crate::plan::LocalPlan;
use crate::units::{BatteryShare, Energy, Seconds};
use proptest::prelude::*;

fn role(number: usize) -> RoleId {
    format!("r{number}").parse().unwrap()
}

fn robot(number: usize) -> RobotId {
    format!("robot-{number:04}").parse().unwrap()
}

fn seconds(micros: u64) -> Seconds {
    Seconds::new(micros as f64 / 1e6).unwrap()
}

fn call(mission: &str, roles: usize) -> CallForBids {
    let auction = AuctionId { mission: mission.parse().unwrap(), term: 1, round: 1 };
    CallForBids {
        auction,
        ensembles: vec![],
        roles: (0..roles).map(|number| (role(number), LocalPlan::of(role(number), vec![]))).collect(),
        eligible: BTreeMap::new(),
        spread: BTreeSet::new(),
        timelines: Timelines { objective: Objective::EarliestEnd, ..Timelines::default() },
    }
}

/// A robot as it is, and as its record shows it.
#[derive(Debug, Clone)]
struct Robot {
    /// Time of its bid for each role, in microseconds; `None` if it does not bid.
    times: Vec<Option<u64>>,
    /// Bound of each time, in quarters.
    bound: u64,
    /// It leaves too little charge.
    is_empty: bool,
    /// What it holds and has promised: whether it holds a role, and the number of promises.
    queue: Option<(bool, u32)>,
}

impl Robot {
    fn queue(&self) -> Option<RobotQueue> {
        let held = RoleEstimate { time: Seconds::new(10.0).unwrap(), energy: Energy::ZERO };
        self.queue.map(|(is_held, promised)| RobotQueue {
            held: is_held.then_some(held),
            promised,
            preceding: promised,
            time: Seconds::new(20.0 * f64::from(promised)).unwrap(),
            energy: Energy::ZERO,
            yields: false,
            reason: RefusalReason::Busy { mission: "other".parse().unwrap(), role: role(0) },
        })
    }

    /// Returns the bids; `None` from a silent robot.
    fn response(&self, call: &CallForBids, number: usize) -> Option<BidResponse> {
        let mission: MissionId = "other".parse().unwrap();
        let holds = self.queue.is_some_and(|(is_held, _)| is_held);
        let present = holds.then(|| PresentRole { mission, role: role(0), time: Seconds::new(10.0).unwrap() });
        let bid = |(of, time): (usize, &Option<u64>)| {
            Some(RoleReply::Bid(Bid {
                robot: robot(number),
                role: role(of),
                time: seconds((*time)?),
                energy: 0.1,
                remaining: if self.is_empty { 0.0 } else { 0.5 },
                useful_charge: BatteryShare::new(0.1).unwrap(),
                from: "dock".parse().unwrap(),
                age_ms: 0,
                parts: vec![],
                present: present.clone(),
                planned: None,
            }))
        };
        let replies: Vec<RoleReply> = self.times.iter().take(call.roles.len()).enumerate().filter_map(bid).collect();
        (!replies.is_empty()).then(|| BidResponse { robot: robot(number), auction: call.auction.clone(), replies })
    }

    fn expected(&self, roles: usize) -> BTreeMap<RoleId, Expectation> {
        let expectation = |time: &Option<u64>| match time {
            None if self.bound == 0 => Expectation::Refuses(NotAskedReason::NotFeasible),
            None => Expectation::CostsAtLeast(0.0),
            Some(_) if self.queue.is_some() => Expectation::CostsAtLeast(0.0),
            Some(time) => Expectation::CostsAtLeast(seconds(time * self.bound / 4).get()),
        };
        (0..).map(role).zip(self.times.iter().take(roles).map(expectation)).collect()
    }
}

/// What the coordinator has beside the bids and the records.
struct Inputs {
    queues: BTreeMap<RobotId, RobotQueue>,
    excluded: BTreeMap<RoleId, BTreeMap<RobotId, String>>,
    /// Roles that can start.
    startable: BTreeSet<RoleId>,
    may_wait: bool,
    /// Maximum number of promises; 0 for none.
    promises_max: u32,
}

impl Inputs {
    /// Holds an auction that asks `count` candidates first, or all robots. Returns its outcome and the number of
    /// robots that were asked.
    fn auction(
        &self,
        call: &CallForBids,
        mut candidates: Candidates,
        reply: impl Fn(&RobotId) -> Option<BidResponse>,
        count: Option<usize>,
    ) -> (AuctionOutcome, usize) {
        let Inputs { queues, excluded, startable, may_wait, promises_max } = self;
        let unavailable = queues.iter().map(|(robot, queue)| (robot.clone(), queue.reason.clone())).collect();
        let (none, limits) = (BTreeMap::new(), BidLimits::default());
        let promises = (*promises_max > 0).then(|| PromiseContext {
            queues,
            unavailable: &none,
            startable,
            may_wait: *may_wait,
            terms: PromiseTerms { promises_max: *promises_max, ..PromiseTerms::default() },
        });
        let (mut invitation, mut responses) = (Invitation::default(), vec![]);
        let mut count = count.unwrap_or(usize::MAX);
        loop {
            let context = AuctionContext {
                invitation: &invitation,
                unavailable: &unavailable,
                excluded,
                limits: &limits,
                energy: None,
                promises: promises.clone(),
                window_ms: 200,
                at_ms: 0,
            };
            let to_ask = match count {
                usize::MAX => candidates.0.keys().cloned().collect(),
                count => candidates.to_ask(call, &responses, &context, count),
            };
            if to_ask.is_empty() {
                return (clear_auction(call, &responses, &context), invitation.robots.len());
            }
            candidates.remove(&to_ask);
            responses.extend(to_ask.iter().filter_map(&reply));
            invitation.robots.extend(to_ask);
            count = count.saturating_mul(2);
        }
    }
}

/// A fleet with a mission.
#[derive(Debug, Clone)]
struct Fleet {
    roles: usize,
    robots: Vec<Robot>,
    /// Whether each role can start.
    startable: Vec<bool>,
    may_wait: bool,
    /// Maximum number of promises; 0 for none.
    promises_max: u32,
    /// A robot that has failed.
    failed: Option<usize>,
}

impl Fleet {
    fn candidates(&self) -> Candidates {
        let expected = self.robots.iter().enumerate().map(|(number, it)| (robot(number), it.expected(self.roles)));
        Candidates::new(expected.collect())
    }

    /// Holds an auction that asks `count` candidates first, or all robots.
    fn auction(&self, count: Option<usize>) -> (AuctionOutcome, usize) {
        self.auction_among(self.candidates(), count)
    }

    /// Does the same with these candidates.
    fn auction_among(&self, candidates: Candidates, count: Option<usize>) -> (AuctionOutcome, usize) {
        let call = call("visit", self.roles);
        let numbered = || self.robots.iter().enumerate();
        let failed = self.failed.map(|number| (role(0), BTreeMap::from([(robot(number), "failed".to_owned())])));
        let startable = (0..).map(role).zip(&self.startable).filter(|(_, starts)| **starts).map(|(role, _)| role);
        let inputs = Inputs {
            queues: numbered().filter_map(|(number, it)| Some((robot(number), it.queue()?))).collect(),
            excluded: failed.into_iter().collect(),
            startable: startable.collect(),
            may_wait: self.may_wait,
            promises_max: self.promises_max,
        };
        let reply = |of: &RobotId| {
            let (number, found) = numbered().find(|(number, _)| robot(*number) == *of)?;
            found.response(&call, number)
        };
        inputs.auction(&call, candidates, reply, count)
    }

    /// Returns the sum of the times of the bids that were chosen, in microseconds.
    fn sum(&self, outcome: &AuctionOutcome) -> Option<u64> {
        let time = |(of, holder): (&RoleId, &RobotId)| {
            let (of, number) = ((0..).find(|number| role(*number) == *of)?, (0..).find(|it| robot(*it) == *holder)?);
            self.robots.get(number)?.times.get(of).copied().flatten()
        };
        outcome.holders.as_ref().map(|holders| holders.iter().filter_map(time).sum())
    }
}

/// Returns fleets with up to this number of roles, and with times below a maximum.
fn fleets(roles_max: usize, time_max: u64) -> impl Strategy<Value = Fleet> {
    let queue = prop_oneof![3 => Just(None), 1 => (any::<bool>(), 0_u32..4).prop_map(Some)];
    let times = prop::collection::vec(prop::option::weighted(0.8, 0..time_max), roles_max);
    let robot = (times, 0_u64..5, prop::bool::weighted(0.1), queue).prop_map(|(times, bound, is_empty, queue)| Robot {
        times,
        bound,
        is_empty,
        queue,
    });
    let failed = prop_oneof![9 => Just(None), 1 => (0_usize..12).prop_map(Some)];
    let startable = prop::collection::vec(prop::bool::weighted(0.7), roles_max);
    let robots = prop::collection::vec(robot, 0..12);
    (1..=roles_max, robots, startable, any::<bool>(), 0_u32..4, failed).prop_map(
        |(roles, robots, startable, may_wait, promises_max, failed)| Fleet {
            roles,
            robots,
            startable,
            may_wait,
            promises_max,
            failed,
        },
    )
}

/// Times so large that sums are equal by chance in one of many millions of fleets.
const DISTINCT: u64 = 1_000_000_000_000_000;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10_000))]

    #[test]
    fn candidates_give_the_result_of_an_auction_among_all(fleet in fleets(3, DISTINCT), count in 1_usize..5) {
        let ((found, _), (among_all, _)) = (fleet.auction(Some(count)), fleet.auction(None));
        prop_assert_eq!(&found.holders, &among_all.holders);
        prop_assert_eq!(found.record.promised, among_all.record.promised);
        prop_assert_eq!(found.record.failure.is_some(), among_all.record.failure.is_some());
        prop_assert_eq!(found.unfillable, among_all.unfillable);
    }

    #[test]
    fn a_single_role_goes_to_the_same_of_equal_robots(fleet in fleets(1, 4), count in 1_usize..5) {
        let ((found, _), (among_all, _)) = (fleet.auction(Some(count)), fleet.auction(None));
        prop_assert_eq!(found.holders, among_all.holders);
        prop_assert_eq!(found.record.promised, among_all.record.promised);
    }
}

proptest! {
    #[test]
    fn several_roles_cost_the_same_among_equal_robots(fleet in fleets(3, 4), count in 1_usize..5) {
        let fleet = Fleet { promises_max: 0, ..fleet };
        let ((found, _), (among_all, _)) = (fleet.auction(Some(count)), fleet.auction(None));
        prop_assert_eq!(fleet.sum(&found), fleet.sum(&among_all));
    }

    /// Two missions are allocated together as if all robots had been asked.
    #[test]
    fn candidates_are_allocated_together(one in fleets(2, DISTINCT), other in fleets(2, DISTINCT)) {
        let fleets = [&one, &other];
        let calls = [call("one", one.roles), call("other", other.roles)];
        let (invitation, none, excluded, limits) =
            (Invitation::default(), BTreeMap::new(), BTreeMap::new(), BidLimits::default());
        let context = AuctionContext {
            invitation: &invitation,
            unavailable: &none,
            excluded: &excluded,
            limits: &limits,
            energy: None,
            promises: None,
            window_ms: 200,
            at_ms: 0,
        };
        let free = |robots: &[Robot]| -> Vec<Robot> {
            robots.iter().map(|robot| Robot { queue: None, ..robot.clone() }).collect()
        };
        let fleets = fleets.map(|fleet| Fleet { robots: free(&fleet.robots), ..fleet.clone() });
        let allocate = |responses: &[Vec<BidResponse>; 2], candidates: &[Candidates; 2]| {
            let open = |index: usize| OpenAuction {
                call: &calls[index],
                responses: &responses[index],
                context: context.clone(),
                candidates: &candidates[index],
            };
            allocate_together(&[open(0), open(1)])
        };
        let all = |index: usize| -> Vec<BidResponse> {
            let robots = fleets[index].robots.iter().enumerate();
            robots.filter_map(|(number, it)| it.response(&calls[index], number)).collect()
        };
        let (all, asked_all) = ([all(0), all(1)], [Candidates::default(), Candidates::default()]);
        let (mut responses, mut candidates) = ([vec![], vec![]], [fleets[0].candidates(), fleets[1].candidates()]);
        let found = loop {
            let allocation = allocate(&responses, &candidates);
            let mut is_proven = true;
            for (index, robots) in allocation.iter().enumerate() {
                let unasked = robots.values().filter(|robot| candidates[index].contains(robot)).cloned();
                let unasked: BTreeSet<RobotId> = unasked.collect();
                is_proven &= unasked.is_empty();
                responses[index].extend(all[index].iter().filter(|reply| unasked.contains(&reply.robot)).cloned());
                candidates[index].remove(&unasked);
            }
            if is_proven {
                break allocation;
            }
        };
        prop_assert_eq!(found, allocate(&all, &asked_all));
    }
}

/// Returns a fleet of free robots, each a second slower than the one before, with these bounds in quarters.
fn free_fleet(size: u64, bound: u64) -> Fleet {
    let times = |number| vec![Some(number * 1_000_000)];
    let robots = (0..size).map(|number| Robot { times: times(number), bound, is_empty: false, queue: None }).collect();
    Fleet { roles: 1, robots, startable: vec![true], may_wait: false, promises_max: 16, failed: None }
}

#[test]
fn a_large_fleet_asks_as_many_robots_as_the_bounds_require() {
    let asked = |fleet: &Fleet| fleet.auction(Some(16)).1;
    assert_eq!(asked(&free_fleet(1000, 4)), 16);
    assert_eq!(asked(&free_fleet(1000, 0)), 16, "the first robot bids 0 s");
    let mut far = free_fleet(1000, 2);
    far.robots[0].times[0] = None;
    assert_eq!(asked(&far), 16, "the first refuses, and the second is better than the bound of the seventeenth");
    for robot in &mut far.robots[..20] {
        robot.is_empty = true;
    }
    let number = asked(&far);
    assert!((40..=112).contains(&number), "the best of 20 s is better than half of 40 s only: {number}");
}

#[test]
fn a_mission_that_waits_for_busy_robots_asks_none() {
    let mut fleet = free_fleet(1000, 4);
    fleet.robots.iter_mut().for_each(|robot| robot.queue = Some((true, 0)));
    assert_eq!(fleet.auction(Some(16)).1, 0, "a role that can start is not promised");
    fleet.robots[7].queue = None;
    let (outcome, asked) = fleet.auction(Some(16));
    assert_eq!((outcome.holders.unwrap()[&role(0)].clone(), asked), (robot(7), 1));
}

#[test]
fn only_robots_that_a_person_permits_are_asked() {
    let fleet = free_fleet(50, 4);
    let auction = |restriction| {
        let candidates = fleet.candidates();
        let restricted = candidates.restricted(&BTreeMap::from([(role(0), restriction)])).into_owned();
        let (outcome, asked) = fleet.auction_among(restricted, Some(16));
        (outcome.holders.unwrap()[&role(0)].clone(), asked)
    };
    assert_eq!(auction(RobotRestriction::Pinned(robot(40))), (robot(40), 1));
    assert_eq!(auction(RobotRestriction::Next(robot(49))), (robot(49), 1));
    assert_eq!(auction(RobotRestriction::Except(robot(0))), (robot(1), 16));
}

#[test]
fn a_robot_that_failed_makes_the_mission_ask_all() {
    let fleet = Fleet { failed: Some(3), ..free_fleet(50, 4) };
    assert_eq!(fleet.auction(Some(16)).1, 50);
}

#[test]
fn robots_that_were_not_asked_are_grouped_by_reason() {
    let mut fleet = free_fleet(5, 4);
    fleet.robots[3].queue = Some((true, 0));
    fleet.robots[4] = Robot { times: vec![None], bound: 0, is_empty: false, queue: None };
    let mut candidates = fleet.candidates();
    candidates.remove(&BTreeSet::from([robot(0)]));
    let busy = fleet.robots[3].queue().unwrap().reason;
    let entries = candidates.entries(&BTreeMap::from([(robot(3), busy)]));
    let entry = |number, reason, cost_min, others: &[usize]| AuctionEntry {
        role: role(0),
        robot: robot(number),
        verdict: BidVerdict::NotAsked { reason, cost_min, others: others.iter().copied().map(robot).collect() },
        parts: vec![],
    };
    assert_eq!(
        entries,
        [
            entry(1, NotAskedReason::NotNeeded, 1.0, &[2]),
            entry(3, NotAskedReason::Busy, 0.0, &[]),
            entry(4, NotAskedReason::NotFeasible, 0.0, &[]),
        ]
    );
}
