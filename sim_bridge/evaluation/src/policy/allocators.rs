//! The policies as allocators for a fleet.

use super::{SuccessEstimate, greedy, optimal, random};
use crate::seeds::generator;
use consort_protocol::auction::{Allocator, AllocatorInput, AssignmentError, Bid};
use consort_protocol::ids::{RobotId, RoleId};
use consort_skills::descriptor::{EstimateContext, Estimator};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::Arc;

/// The rule of MissionControl: the times and energies of the bids are replaced by the coordinator's
/// own estimates.
pub struct GreedyAllocator {
    /// The coordinator's estimator.
    pub estimator: Arc<Estimator>,
    /// Static data of each robot known to the coordinator.
    pub robots: BTreeMap<RobotId, EstimateContext>,
}

impl fmt::Debug for GreedyAllocator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ByGreed").field("robots", &self.robots.keys()).finish_non_exhaustive()
    }
}

impl GreedyAllocator {
    /// Returns the bid with the coordinator's own figures; unchanged for an unknown robot.
    fn reprice(&self, input: &AllocatorInput<'_>, bid: &Bid) -> Bid {
        let own = self.robots.get(&bid.robot).and_then(|known| {
            let context = EstimateContext { place: bid.from.clone(), ..known.clone() };
            self.estimator.price(input.call.roles.get(&bid.role)?, &context).ok()
        });
        let Some(parts) = own else { return bid.clone() };
        let charge = bid.remaining + bid.energy;
        let energy: f64 = parts.iter().map(|part| part.energy).sum();
        let time = parts.iter().map(|part| part.time).sum();
        Bid { time, energy, remaining: charge - energy, parts, ..bid.clone() }
    }
}

impl Allocator for GreedyAllocator {
    fn allocate(&self, input: &AllocatorInput<'_>) -> Result<BTreeMap<RoleId, RobotId>, AssignmentError> {
        let bids: Vec<Bid> = input.bids.iter().map(|bid| self.reprice(input, bid)).collect();
        let roles: BTreeSet<RoleId> = input.call.roles.keys().cloned().collect();
        greedy(&roles, &bids, input.limits).ok_or(AssignmentError::NoRobotLeft)
    }
}

/// The baseline: a random robot among the candidates.
#[derive(Debug, Clone)]
pub struct RandomAllocator {
    /// Candidates for each role.
    pub candidates: BTreeMap<RoleId, BTreeSet<RobotId>>,
    /// Seed of the random choices.
    pub seed: u64,
}

impl Allocator for RandomAllocator {
    fn allocate(&self, input: &AllocatorInput<'_>) -> Result<BTreeMap<RoleId, RobotId>, AssignmentError> {
        let open = input.candidates.iter().map(|(role, robots)| {
            let allowed = self.candidates.get(role);
            let robots = robots.iter().filter(|robot| allowed.is_none_or(|allowed| allowed.contains(*robot)));
            (role.clone(), robots.cloned().collect())
        });
        // A repeated call for the same round gives the same result.
        let auction = &input.call.auction;
        let round = format!("{}.{}", auction.term, auction.round);
        random(&open.collect(), &mut generator(self.seed, &["choice", &round])).ok_or(AssignmentError::NoRobotLeft)
    }
}

/// The oracle.
#[derive(Debug, Clone)]
pub struct OracleAllocator {
    /// Estimated success of each robot in each role.
    pub estimates: BTreeMap<(RoleId, RobotId), SuccessEstimate>,
}

impl Allocator for OracleAllocator {
    fn allocate(&self, input: &AllocatorInput<'_>) -> Result<BTreeMap<RoleId, RobotId>, AssignmentError> {
        let open =
            |role: &RoleId, robot: &RobotId| input.candidates.get(role).is_some_and(|robots| robots.contains(robot));
        // A robot without any chance of success is not assigned, as under the other policies.
        let may_succeed = |estimate: &SuccessEstimate| estimate.success > 0.0;
        let estimates =
            self.estimates.iter().filter(|((role, robot), estimate)| open(role, robot) && may_succeed(estimate));
        let estimates = estimates.map(|(of, estimate)| (of.clone(), *estimate)).collect();
        let roles: BTreeSet<RoleId> = input.call.roles.keys().cloned().collect();
        optimal(&roles, &estimates).ok_or(AssignmentError::NoRobotLeft)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::auction::{AuctionId, BidLimits, CallForBids, Timelines};
    use consort_protocol::ids::{PlaceId, TaskId, TaskType};
    use consort_protocol::knowledge::Attributes;
    use consort_protocol::mission::TaskSpec;
    use consort_protocol::plan::{LocalPlan, Step, StepAction};
    use consort_protocol::pose::Pose;
    use consort_protocol::units::{BatteryShare, MetresPerSecond, Seconds, SharePerSecond};
    use consort_skills::descriptor::DescriptorRegistry;
    use consort_skills::environment::{Edge, Environment, Routes, SpeedLimits, TopologicalMap};

    fn robot(name: &str) -> RobotId {
        RobotId::new(name).unwrap()
    }

    fn role() -> RoleId {
        RoleId::new("r1").unwrap()
    }

    fn place(name: &str) -> PlaceId {
        PlaceId::new(name).unwrap()
    }

    /// Returns a call for a drive to B.
    fn call(round: u32) -> CallForBids {
        let mut spec = TaskSpec::of(TaskType::new("navigation").unwrap(), vec![role()]);
        spec.parameters.insert("to".to_owned(), "B".to_owned());
        let action = StepAction::Task { id: TaskId::new("go").unwrap(), spec };
        let plan = LocalPlan::of(role(), vec![Step { action, after: vec![] }]);
        CallForBids {
            auction: AuctionId { mission: "m".parse().unwrap(), term: 1, round },
            ensembles: vec![],
            roles: [(role(), plan)].into(),
            eligible: BTreeMap::new(),
            spread: BTreeSet::new(),
            timelines: Timelines::default(),
        }
    }

    fn bid(name: &str, time: f64, energy: f64, remaining: f64) -> Bid {
        Bid {
            robot: robot(name),
            role: role(),
            time: Seconds::new(time).unwrap(),
            energy,
            remaining,
            useful_charge: BatteryShare::new(0.08).unwrap(),
            from: place("A"),
            age_ms: 0,
            parts: vec![],
            present: None,
            planned: None,
        }
    }

    fn allocate(allocator: &dyn Allocator, round: u32, open: &[&str], bids: &[Bid]) -> Result<String, AssignmentError> {
        let open = BTreeMap::from([(role(), open.iter().map(|name| robot(name)).collect())]);
        let bids: Vec<&Bid> = bids.iter().collect();
        let limits = BidLimits::default();
        let viable: Vec<&Bid> = bids.iter().copied().filter(|bid| bid.check_viable(&limits).is_ok()).collect();
        let call = call(round);
        let input = AllocatorInput { call: &call, candidates: &open, bids: &bids, viable: &viable, limits: &limits };
        assert_eq!(allocator.allocate(&input), allocator.allocate(&input), "a repeated call gives the same result");
        allocator.allocate(&input).map(|chosen| chosen[&role()].to_string())
    }

    #[test]
    fn greedy_allocation_uses_the_coordinators_estimates() {
        let map = TopologicalMap {
            places: ["A", "B"].map(|name| (place(name), Pose::default())).into(),
            edges: vec![Edge { a: place("A"), b: place("B"), length_m: 10.0, one_way: false }],
        };
        let environment = Environment::new().with(Routes::new(&map).unwrap());
        let known = |speed: f64| EstimateContext {
            place: place("B"),
            pose: None,
            speed: MetresPerSecond::new(speed).unwrap(),
            discharge: SharePerSecond::new(0.01).unwrap(),
            closed: vec![],
            limits: SpeedLimits::default(),
            attributes: Attributes::default(),
            readings: None,
        };
        let allocator = GreedyAllocator {
            estimator: Arc::new(DescriptorRegistry::standard().resolve(environment).unwrap()),
            robots: [(robot("ada"), known(0.5)), (robot("bob"), known(1.0))].into(),
        };
        // By the coordinator's estimates ada needs 20 s and 0.2 of its charge, and bob 10 s and
        // 0.1; their bids contain other figures.
        let bids = [bid("ada", 5.0, 0.05, 0.45), bid("bob", 50.0, 0.5, 0.0)];
        assert_eq!(allocate(&allocator, 1, &["ada", "bob"], &bids).unwrap(), "bob");
        let bids = [bid("ada", 5.0, 0.05, 0.45), bid("bob", 50.0, 0.1, 0.05)];
        assert_eq!(allocate(&allocator, 1, &["ada", "bob"], &bids).unwrap(), "ada");
        assert_eq!(allocate(&allocator, 1, &[], &[]).unwrap_err(), AssignmentError::NoRobotLeft);
    }

    #[test]
    fn random_allocation_uses_candidates_only_and_varies_by_round() {
        let allowed = ["ada", "bob", "cyd"].map(robot).into();
        let allocator = RandomAllocator { candidates: [(role(), allowed)].into(), seed: 7 };
        let chosen: BTreeSet<String> =
            (1..60).map(|round| allocate(&allocator, round, &["ada", "bob", "dan"], &[]).unwrap()).collect();
        assert_eq!(chosen, ["ada", "bob"].map(str::to_owned).into());
        assert_eq!(allocate(&allocator, 1, &["dan"], &[]).unwrap_err(), AssignmentError::NoRobotLeft);
    }

    #[test]
    fn the_oracle_takes_the_likeliest_open_robot() {
        let estimate = |success| SuccessEstimate { success, time_s: 1.0 };
        let estimates = [("ada", 0.9), ("bob", 0.8)].map(|(name, success)| ((role(), robot(name)), estimate(success)));
        let allocator = OracleAllocator { estimates: estimates.into() };
        assert_eq!(allocate(&allocator, 1, &["ada", "bob"], &[]).unwrap(), "ada");
        assert_eq!(allocate(&allocator, 1, &["bob"], &[]).unwrap(), "bob");
        // A role is left open if every candidate would fail.
        let without_chance = [((role(), robot("ada")), estimate(0.0))];
        assert_eq!(
            allocate(&OracleAllocator { estimates: without_chance.into() }, 1, &["ada"], &[]).unwrap_err(),
            AssignmentError::NoRobotLeft
        );
    }
}
