//! The policies as rules that a fleet can be told to choose by.

use super::{SuccessEstimate, greedy, optimal, random};
use crate::experiment::seeds::generator;
use consort_protocol::auction::{Allocator, AllocatorInput, Bid};
use consort_protocol::ids::{RobotId, RoleId};
use consort_protocol::units::Seconds;
use consort_skills::descriptor::{EstimateContext, Estimator};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::Arc;

const NOBODY: &str = "no robot is left for a role";

/// The rule of MissionControl: what robots themselves say of time and energy is replaced by the coordinator's own estimate.
pub struct GreedyAllocator {
    /// The coordinator's estimator.
    pub estimator: Arc<Estimator>,
    /// What the coordinator knows of each robot.
    pub robots: BTreeMap<RobotId, EstimateContext>,
}

impl fmt::Debug for GreedyAllocator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ByGreed").field("robots", &self.robots.keys()).finish_non_exhaustive()
    }
}

impl GreedyAllocator {
    /// The bid with the coordinator's own figures; as it is for a robot of which nothing is known.
    fn reprice(&self, ballot: &AllocatorInput<'_>, bid: &Bid) -> Bid {
        let own = self.robots.get(&bid.robot).and_then(|known| {
            let context = EstimateContext { place: bid.from.clone(), ..known.clone() };
            self.estimator.price(ballot.call.roles.get(&bid.role)?, &context).ok()
        });
        let Some(parts) = own else { return bid.clone() };
        let charge = bid.remaining + bid.energy;
        let energy: f64 = parts.iter().map(|part| part.energy).sum();
        let time = parts.iter().fold(Seconds::ZERO, |sum, part| sum + part.time);
        Bid { time, energy, remaining: charge - energy, parts, ..bid.clone() }
    }
}

impl Allocator for GreedyAllocator {
    fn allocate(&self, ballot: &AllocatorInput<'_>) -> Result<BTreeMap<RoleId, RobotId>, String> {
        let bids: Vec<Bid> = ballot.bids.iter().map(|bid| self.reprice(ballot, bid)).collect();
        let roles: BTreeSet<RoleId> = ballot.call.roles.keys().cloned().collect();
        greedy(&roles, &bids, ballot.limits).ok_or_else(|| NOBODY.to_owned())
    }
}

/// The baseline: anybody among those that may.
#[derive(Debug, Clone)]
pub struct RandomAllocator {
    /// Who may be given which role.
    pub candidates: BTreeMap<RoleId, BTreeSet<RobotId>>,
    /// Where its dice come from.
    pub seed: u64,
}

impl Allocator for RandomAllocator {
    fn allocate(&self, ballot: &AllocatorInput<'_>) -> Result<BTreeMap<RoleId, RobotId>, String> {
        let open = ballot.candidates.iter().map(|(role, robots)| {
            let may = self.candidates.get(role);
            let robots = robots.iter().filter(|robot| may.is_none_or(|may| may.contains(*robot)));
            (role.clone(), robots.cloned().collect())
        });
        // Asked again about the same round it answers the same.
        let auction = &ballot.call.auction;
        let round = format!("{}.{}", auction.term, auction.round);
        random(&open.collect(), &mut generator(self.seed, &["choice", &round])).ok_or_else(|| NOBODY.to_owned())
    }
}

/// The oracle.
#[derive(Debug, Clone)]
pub struct OracleAllocator {
    /// What would come of each choice.
    pub estimates: BTreeMap<(RoleId, RobotId), SuccessEstimate>,
}

impl Allocator for OracleAllocator {
    fn allocate(&self, ballot: &AllocatorInput<'_>) -> Result<BTreeMap<RoleId, RobotId>, String> {
        let open =
            |role: &RoleId, robot: &RobotId| ballot.candidates.get(role).is_some_and(|robots| robots.contains(robot));
        // Whoever cannot succeed is not sent at all: nobody else would send them, either.
        let hopeful = |prospect: &SuccessEstimate| prospect.success > 0.0;
        let prospects = self.estimates.iter().filter(|((role, robot), fate)| open(role, robot) && hopeful(fate));
        let prospects = prospects.map(|(of, prospect)| (of.clone(), *prospect)).collect();
        let roles: BTreeSet<RoleId> = ballot.call.roles.keys().cloned().collect();
        optimal(&roles, &prospects).ok_or_else(|| NOBODY.to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::auction::{AuctionId, BidLimits, CallForBids};
    use consort_protocol::ids::{PlaceId, TaskId, TaskType};
    use consort_protocol::mission::TaskSpec;
    use consort_protocol::plan::{LocalPlan, Step, StepAction};
    use consort_protocol::pose::Pose;
    use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond};
    use consort_skills::descriptor::DescriptorRegistry;
    use consort_skills::environment::{Edge, Environment, Routes, TopologicalMap};

    fn robot(name: &str) -> RobotId {
        RobotId::new(name).unwrap()
    }

    fn role() -> RoleId {
        RoleId::new("r1").unwrap()
    }

    fn place(name: &str) -> PlaceId {
        PlaceId::new(name).unwrap()
    }

    /// A drive to B.
    fn call(round: u32) -> CallForBids {
        let mut spec = TaskSpec::of(TaskType::new("navigation").unwrap(), vec![role()]);
        spec.parameters.insert("to".to_owned(), "B".to_owned());
        let action = StepAction::Task { id: TaskId::new("go").unwrap(), spec };
        let plan = LocalPlan::of(role(), vec![Step { action, after: vec![] }]);
        CallForBids {
            auction: AuctionId { mission: "m".parse().unwrap(), term: 1, round },
            ensemble: "all".parse().unwrap(),
            roles: [(role(), plan)].into(),
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
        }
    }

    fn ask(rule: &dyn Allocator, round: u32, open: &[&str], bids: &[Bid]) -> Result<String, String> {
        let open = BTreeMap::from([(role(), open.iter().map(|name| robot(name)).collect())]);
        let bids: Vec<&Bid> = bids.iter().collect();
        let limits = BidLimits::default();
        let viable: Vec<&Bid> = bids.iter().copied().filter(|bid| bid.check_viable(&limits).is_ok()).collect();
        let call = call(round);
        let ballot = AllocatorInput { call: &call, candidates: &open, bids: &bids, viable: &viable, limits: &limits };
        assert_eq!(rule.allocate(&ballot), rule.allocate(&ballot), "asked twice it answers the same");
        rule.allocate(&ballot).map(|chosen| chosen[&role()].to_string())
    }

    #[test]
    fn greed_goes_by_the_coordinators_estimates_and_not_by_what_robots_say() {
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
        };
        let rule = GreedyAllocator {
            estimator: Arc::new(DescriptorRegistry::standard().resolve(environment).unwrap()),
            robots: [(robot("ada"), known(0.5)), (robot("bob"), known(1.0))].into(),
        };
        // ada takes 20 s and 0.2 of its charge, bob 10 s and 0.1, whatever they say.
        let bids = [bid("ada", 5.0, 0.05, 0.45), bid("bob", 50.0, 0.5, 0.0)];
        assert_eq!(ask(&rule, 1, &["ada", "bob"], &bids).unwrap(), "bob");
        let bids = [bid("ada", 5.0, 0.05, 0.45), bid("bob", 50.0, 0.1, 0.05)];
        assert_eq!(ask(&rule, 1, &["ada", "bob"], &bids).unwrap(), "ada");
        assert_eq!(ask(&rule, 1, &[], &[]).unwrap_err(), NOBODY);
    }

    #[test]
    fn chance_keeps_to_those_who_may_and_has_new_dice_each_round() {
        let may = ["ada", "bob", "cyd"].map(robot).into();
        let rule = RandomAllocator { candidates: [(role(), may)].into(), seed: 7 };
        let chosen: BTreeSet<String> =
            (1..60).map(|round| ask(&rule, round, &["ada", "bob", "dan"], &[]).unwrap()).collect();
        assert_eq!(chosen, ["ada", "bob"].map(str::to_owned).into());
        assert_eq!(ask(&rule, 1, &["dan"], &[]).unwrap_err(), NOBODY);
    }

    #[test]
    fn fate_takes_the_likeliest_that_is_open() {
        let prospect = |success| SuccessEstimate { success, time_s: 1.0 };
        let prospects = [("ada", 0.9), ("bob", 0.8)].map(|(name, success)| ((role(), robot(name)), prospect(success)));
        let rule = OracleAllocator { estimates: prospects.into() };
        assert_eq!(ask(&rule, 1, &["ada", "bob"], &[]).unwrap(), "ada");
        assert_eq!(ask(&rule, 1, &["bob"], &[]).unwrap(), "bob");
        // Of those who cannot succeed none is better than nobody.
        let hopeless = [((role(), robot("ada")), prospect(0.0))];
        assert_eq!(ask(&OracleAllocator { estimates: hopeless.into() }, 1, &["ada"], &[]).unwrap_err(), NOBODY);
    }
}
