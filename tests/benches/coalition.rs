//! Coalition formation in process: every worker estimates role r1 of a lab-samples mission; a
//! single worker is chosen.
//!
//! ```text
//! cargo bench -p consort-tests --bench coalition
//! ```
//!
//! `auction` is the auction of a fleet without the bus: `Bidder::respond` of each robot, and
//! `clear_auction` of the coordinator with its record of all responses. `responses` and `clear` are
//! its two halves. `lean` is the same estimates and choice without responses, refusals and record.

use consort_fleet::robot::{BidContext, Bidder};
use consort_protocol::auction::{
    AuctionContext, AuctionId, AuctionOutcome, Bid, BidLimits, BidResponse, CallForBids, Invitation, Objective,
    Timelines, clear_auction, optimal_assignment,
};
use consort_protocol::ensemble::Membership;
use consort_protocol::ids::{PlaceId, RobotId, RoleId};
use consort_protocol::knowledge::{Attributes, Availability, RobotKnowledge};
use consort_protocol::plan::divide_and_check;
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond};
use consort_skills::descriptor::{DescriptorRegistry, EstimateContext, Estimator};
use consort_skills::domain::hospital;
use consort_skills::environment::{Environment, Routes, SpeedLimits};
use consort_skills::missions::shipped;
use consort_tests::slug;
use consort_world::map;
use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use std::collections::{BTreeMap, BTreeSet};
use std::hint::black_box;
use std::sync::Arc;

const SKILLS: [&str; 5] = ["navigation", "approach_person", "authenticate_person", "operate_drawer", "approach_robot"];

/// Workers at places all over the hospital, and the call for bids.
struct Scene {
    call: CallForBids,
    roles: BTreeSet<RoleId>,
    estimator: Arc<Estimator>,
    bidders: Vec<Bidder>,
    circumstances: Vec<BidContext<'static>>,
    expected: Invitation,
    limits: BidLimits,
}

impl Scene {
    fn new(workers: usize) -> Scene {
        let map = map::shipped("hospital").expect("the shipped map is sound");
        let environment = Environment::new().with(Routes::new(&map.topology()).expect("the shipped map is sound"));
        let estimator = Arc::new(DescriptorRegistry::standard().resolve(environment).expect("routes are there"));
        let room = BTreeMap::from([("room".to_owned(), "IC Room 6".to_owned())]);
        let mission = shipped()["lab-samples"].instantiate(&room, &hospital()).expect("a shipped mission");
        let plan = divide_and_check(&mission).expect("a shipped mission").plans[&slug::<RoleId>("r1")].clone();
        let robot = |number: usize| slug::<RobotId>(&format!("robot-{number:04}"));
        let worker = |number: usize| {
            let place = &map.places()[number * 7 % map.places().len()];
            RobotKnowledge {
                skills: SKILLS.into_iter().map(slug).collect(),
                attributes: Default::default(),
                place: place.id.clone(),
                pose: place.pose,
                battery: BatteryShare::new(0.3 + 0.7 * (number % 11) as f64 / 11.0).expect("a share"),
                discharge: SharePerSecond::new(0.0004).expect("a rate"),
                useful_charge: BatteryShare::new(0.08).expect("a share"),
                speed: Some(MetresPerSecond::new(0.4 + 0.05 * (number % 7) as f64).expect("a speed")),
                availability: Availability::Free,
                estimator: "1".to_owned(),
                charging: None,
            }
        };
        let circumstance = |number: usize| {
            // Bidders borrow the data of their robot for the lifetime of the program.
            let worker: &'static RobotKnowledge = Box::leak(Box::new(worker(number)));
            let membership = Membership { member: true, reason: "has the skills".to_owned(), age_ms: 0 };
            BidContext {
                worker,
                closed_lanes: &[],
                found_closed: &[],
                closures: &[],
                speed_limits: SpeedLimits::default(),
                readings: None,
                age_ms: 0,
                membership,
                present: None,
            }
        };
        Scene {
            call: CallForBids {
                auction: AuctionId { mission: slug("lab-samples-1"), term: 1, round: 1 },
                ensembles: vec![slug("logistics")],
                roles: BTreeMap::from([(slug("r1"), plan)]),
                eligible: BTreeMap::new(),
                spread: BTreeSet::new(),
                timelines: Timelines::default(),
            },
            roles: BTreeSet::from([slug("r1")]),
            bidders: (0..workers).map(|number| Bidder::new(robot(number), Arc::clone(&estimator))).collect(),
            estimator,
            circumstances: (0..workers).map(circumstance).collect(),
            expected: Invitation { robots: (0..workers).map(robot).collect(), preferred: vec![] },
            limits: BidLimits::default(),
        }
    }

    fn responses(&self) -> Vec<BidResponse> {
        let each = self.bidders.iter().zip(&self.circumstances);
        each.map(|(bidder, circumstance)| bidder.respond(&self.call, circumstance)).collect()
    }

    fn clear_auction(&self, responses: &[BidResponse]) -> AuctionOutcome {
        let taken = BTreeMap::new();
        let (expected, limits) = (&self.expected, &self.limits);
        let excluded = BTreeMap::new();
        clear_auction(
            &self.call,
            responses,
            &AuctionContext {
                energy: None,
                invitation: expected,
                unavailable: &taken,
                excluded: &excluded,
                limits,
                promises: None,
                window_ms: 200,
                at_ms: 0,
            },
        )
    }

    /// Returns the choice by the estimates alone.
    fn lean(&self) -> RobotId {
        let (role, plan) = self.call.roles.first_key_value().expect("there is r1");
        let bid = |(robot, circumstance): (&RobotId, &BidContext<'_>)| {
            let worker = circumstance.worker;
            let (place, speed, discharge) = (worker.place.clone(), worker.speed?, worker.discharge);
            let parts = self
                .estimator
                .price(
                    plan,
                    &EstimateContext {
                        place,
                        pose: None,
                        speed,
                        discharge,
                        closed: vec![],
                        limits: SpeedLimits::default(),
                        attributes: Attributes::default(),
                        readings: None,
                    },
                )
                .ok()?;
            let energy: f64 = parts.iter().map(|part| part.energy).sum();
            let bid = Bid {
                robot: robot.clone(),
                role: role.clone(),
                time: parts.iter().map(|part| part.time).sum(),
                energy,
                remaining: worker.battery.get() - energy,
                useful_charge: worker.useful_charge,
                from: PlaceId::clone(&worker.place),
                age_ms: 0,
                parts,
                present: None,
                planned: None,
            };
            bid.check_viable(&self.limits).is_ok().then_some(bid)
        };
        let bids: Vec<Bid> = self.expected.robots.iter().zip(&self.circumstances).filter_map(bid).collect();
        let chosen = optimal_assignment(&self.roles, &BTreeSet::new(), &bids, Objective::EarliestEnd)
            .expect("a worker can fill the role");
        bids[chosen[role]].robot.clone()
    }
}

fn coalition(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("coalition");
    for workers in [6, 200, 1000] {
        let scene = Scene::new(workers);
        let responses = scene.responses();
        let chosen = scene.clear_auction(&responses).holders.expect("a worker can fill the role");
        assert_eq!(chosen.into_values().collect::<Vec<_>>(), [scene.lean()], "both choose the same robot");
        let id = |name| BenchmarkId::new(name, workers);
        group.bench_function(id("auction"), |bench| bench.iter(|| scene.clear_auction(black_box(&scene.responses()))));
        group.bench_function(id("tenders"), |bench| bench.iter(|| scene.responses()));
        group.bench_function(id("conclude"), |bench| bench.iter(|| scene.clear_auction(black_box(&responses))));
        group.bench_function(id("lean"), |bench| bench.iter(|| scene.lean()));
    }
    group.finish();
}

criterion_group!(benches, coalition);
criterion_main!(benches);
