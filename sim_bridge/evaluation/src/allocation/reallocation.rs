//! Allocation by repeated auctions: neighbouring jobs are released from the timelines of some robots and awarded again,
//! each to the robot with the least price.
//!
//! The choice of the released jobs follows slack induction by string removals (Christiaens and Vanden Berghe, 2020),
//! and worse allocations are accepted as in simulated annealing. Prices hold as long as the timeline of their robot does
//! not change, so only robots that lose or get jobs are asked.

use super::bidder::{Order, Prices, Settlement};
use super::instance::Instance;
use super::market::Market;
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;

/// Average number of released jobs, and the largest number of neighbouring jobs of a robot among them.
const RELEASED: f64 = 10.0;
const STRING_MAX: f64 = 10.0;

/// Probability that a robot is passed over when a job is awarded.
const BLINK: f64 = 0.05;

/// Probability that a string leaves out some jobs in its middle, and that these are one more.
const SPLIT: f64 = 0.5;
const SPLIT_LONGER: f64 = 0.99;

/// Temperatures at the beginning and at the end, as shares of the mean distance for a job.
const HOT: f64 = 10.0;
const COLD: f64 = 0.01;

/// State of a robot, as far as the auctioneer knows.
#[derive(Debug, Clone)]
struct Robot {
    promised: Prices,
    /// With the changes since the last settlement; `None` without changes.
    open: Option<Prices>,
    /// Settlement that the next order to the robot contains.
    settlement: Settlement,
}

impl Robot {
    fn prices(&self) -> &Prices {
        self.open.as_ref().unwrap_or(&self.promised)
    }

    fn settle(&mut self, settlement: Settlement) {
        if let Some(open) = self.open.take() {
            self.settlement = settlement;
            if settlement == Settlement::Keep {
                self.promised = open;
            }
        }
    }
}

/// An allocation in the making.
pub(super) struct Reallocation<'a> {
    instance: &'a Instance,
    robots: Vec<Robot>,
    /// Jobs that no robot has.
    absent: BTreeSet<usize>,
    /// Number of times that each job found no robot.
    failures: Vec<u64>,
    /// For each job the others, the nearest first.
    neighbours: Vec<Vec<usize>>,
    chance: ChaCha8Rng,
    orders: usize,
    orders_max: usize,
}

/// Value of an allocation.
#[derive(Debug, Clone, Copy)]
struct Cost {
    absent: usize,
    travel: f64,
}

impl<'a> Reallocation<'a> {
    /// Returns an allocation of robots without jobs, with at most `orders_max` orders to robots.
    pub(super) fn new(
        instance: &'a Instance,
        prices: Vec<Prices>,
        orders_max: usize,
        chance: ChaCha8Rng,
    ) -> Reallocation<'a> {
        let jobs = 0..instance.jobs.len();
        let neighbours = jobs.clone().map(|job| {
            let mut others: Vec<usize> = jobs.clone().collect();
            others.sort_by(|a, b| instance.distance(job, *a).total_cmp(&instance.distance(job, *b)));
            others
        });
        let robot = |promised| Robot { promised, open: None, settlement: Settlement::Open };
        Reallocation {
            instance,
            robots: prices.into_iter().map(robot).collect(),
            absent: jobs.clone().collect(),
            failures: vec![0; jobs.len()],
            neighbours: neighbours.collect(),
            chance,
            orders: 0,
            orders_max,
        }
    }

    /// Allocates. In the end the robots have the best routes.
    pub(super) async fn run(mut self, market: &mut impl Market) {
        let jobs = self.instance.jobs.len();
        if jobs == 0 || self.robots.is_empty() {
            return;
        }
        self.award_absent(market).await;
        self.settle(Settlement::Keep);
        let mut current = self.cost();
        let (mut best, mut best_routes) = (current, self.routes());
        while self.orders < self.orders_max {
            let progress = self.orders as f64 / self.orders_max as f64;
            let scale = current.travel / jobs as f64;
            let temperature = scale * HOT * (COLD / HOT).powf(progress);
            let absent_before = self.absent.clone();
            let released = self.choose_released();
            self.release(&released, market).await;
            self.award_absent(market).await;
            let cost = self.cost();
            let gain = -temperature * self.chance.random_range(f64::EPSILON..1.0).ln();
            let sum = |absent: &BTreeSet<usize>| absent.iter().map(|job| self.failures[*job]).sum::<u64>();
            let accepted = match cost.absent.cmp(&current.absent) {
                std::cmp::Ordering::Less => true,
                std::cmp::Ordering::Equal => cost.travel < current.travel + gain,
                // Jobs that rarely fail are easier to place later.
                std::cmp::Ordering::Greater => sum(&self.absent) < sum(&absent_before),
            };
            for job in &self.absent {
                self.failures[*job] += 1;
            }
            if accepted {
                self.settle(Settlement::Keep);
                current = cost;
                if (cost.absent, cost.travel) < (best.absent, best.travel) {
                    (best, best_routes) = (cost, self.routes());
                }
            } else {
                self.settle(Settlement::Undo);
                self.absent = absent_before;
            }
        }
        self.adopt(best_routes, market).await;
    }

    /// Gives each robot a route: its jobs are released, and those of the route appended.
    async fn adopt(&mut self, routes: Vec<Vec<usize>>, market: &mut impl Market) {
        let order = |(robot, award): (&Robot, Vec<usize>)| Order {
            release: robot.promised.route.clone(),
            award,
            append: true,
            ..Order::none()
        };
        let orders: Vec<Order> = self.robots.iter().zip(routes).map(order).collect();
        self.send(orders.into_iter().enumerate().collect(), market).await;
    }

    fn routes(&self) -> Vec<Vec<usize>> {
        self.robots.iter().map(|robot| robot.prices().route.clone()).collect()
    }

    fn cost(&self) -> Cost {
        let travel = self.robots.iter().map(|robot| robot.prices().travel).sum();
        Cost { absent: self.absent.len(), travel }
    }

    fn settle(&mut self, settlement: Settlement) {
        self.robots.iter_mut().for_each(|robot| robot.settle(settlement));
    }

    /// Chooses strings of neighbouring jobs from the routes near a random job.
    fn choose_released(&mut self) -> Vec<(usize, Vec<usize>)> {
        let (jobs, chance) = (self.instance.jobs.len(), &mut self.chance);
        let used = self.robots.iter().filter(|robot| !robot.promised.route.is_empty()).count().max(1);
        let mean_length = (jobs - self.absent.len()) as f64 / used as f64;
        let longest = STRING_MAX.min(mean_length).max(1.0);
        let strings_max = 4.0 * RELEASED.min(jobs as f64) / (1.0 + longest) - 1.0;
        let strings = chance.random_range(1.0..=strings_max.max(1.0) + 1.0).floor() as usize;
        let mut released: Vec<(usize, Vec<usize>)> = vec![];
        let seed = chance.random_range(0..jobs);
        for &job in &self.neighbours[seed] {
            if released.len() == strings {
                break;
            }
            let of_job = self.robots.iter().position(|robot| robot.promised.route.contains(&job));
            let Some(robot) = of_job.filter(|robot| released.iter().all(|(other, _)| other != robot)) else { continue };
            let route = &self.robots[robot].promised.route;
            let place = route.iter().position(|other| *other == job).expect("it is on the route");
            let length_max = longest.min(route.len() as f64);
            let length = (chance.random_range(1.0..=length_max + 1.0).floor() as usize).clamp(1, route.len());
            // Jobs in the middle that stay.
            let mut kept = 0;
            if length > 1 && length < route.len() && chance.random_bool(SPLIT) {
                kept = 1;
                while length + kept < route.len() && !chance.random_bool(SPLIT_LONGER) {
                    kept += 1;
                }
            }
            let span = length + kept;
            let first_min = (place + 1).saturating_sub(span);
            let first_max = place.min(route.len() - span);
            let first = chance.random_range(first_min..=first_max.max(first_min));
            let kept_from = if kept > 0 { chance.random_range(1..length) } else { length };
            let string = (0..span).filter(|offset| !(kept_from..kept_from + kept).contains(offset));
            released.push((robot, string.map(|offset| route[first + offset]).collect()));
        }
        released
    }

    async fn release(&mut self, released: &[(usize, Vec<usize>)], market: &mut impl Market) {
        let orders = released.iter().map(|(robot, jobs)| (*robot, Order { release: jobs.clone(), ..Order::none() }));
        self.send(orders.collect(), market).await;
        self.absent.extend(released.iter().flat_map(|(_, jobs)| jobs));
    }

    /// Awards the jobs that no robot has, one after the other, each to the robot with the least price.
    async fn award_absent(&mut self, market: &mut impl Market) {
        for job in self.in_random_order(self.absent.iter().copied().collect()) {
            let chance = &mut self.chance;
            let offers = self.robots.iter().enumerate().filter(|_| !chance.random_bool(BLINK));
            let fitting = offers.map(|(number, robot)| (robot.prices().added[job], number)).filter(|o| o.0.is_finite());
            let Some((_, robot)) = fitting.min_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
            self.send(vec![(robot, Order { award: vec![job], ..Order::none() })], market).await;
            if self.robots[robot].prices().route.contains(&job) {
                self.absent.remove(&job);
            }
        }
    }

    /// Puts jobs into one of several orders: by chance, the largest, farthest or nearest first, the shortest window,
    /// the earliest or the latest begin first.
    fn in_random_order(&mut self, mut jobs: Vec<usize>) -> Vec<usize> {
        jobs.shuffle(&mut self.chance);
        let instance = self.instance;
        let site = |job: &usize| instance.jobs[*job];
        let from_depot = |job: &usize| instance.distance(instance.depot_place(), *job);
        let order = self.chance.random_range(0..24);
        let key = |job: &usize| match order {
            0..4 => 0.0,
            4..8 => -site(job).demand,
            8..16 => -from_depot(job),
            16..18 => from_depot(job),
            18..20 => site(job).due - site(job).ready,
            20..22 => site(job).ready,
            _ => -site(job).due,
        };
        jobs.sort_by(|a, b| key(a).total_cmp(&key(b)));
        jobs
    }

    async fn send(&mut self, orders: Vec<(usize, Order)>, market: &mut impl Market) {
        let numbers: Vec<usize> = orders.iter().map(|(robot, _)| *robot).collect();
        let with_settlement = |(number, order): (usize, Order)| {
            let settlement = std::mem::replace(&mut self.robots[number].settlement, Settlement::Open);
            (number, Order { settlement, ..order })
        };
        let orders: Vec<(usize, Order)> = orders.into_iter().map(with_settlement).collect();
        self.orders += orders.len();
        for (number, prices) in numbers.into_iter().zip(market.ask(orders).await) {
            self.robots[number].open = Some(prices);
        }
    }
}
