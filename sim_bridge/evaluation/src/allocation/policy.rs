//! Policies that allocate jobs by the prices of robots.

use super::bidder::{Order, Prices, Settlement};
use super::instance::Instance;
use super::market::Market;
use super::reallocation::Reallocation;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::str::FromStr;

/// Rule of an allocation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AllocationPolicy {
    /// Jobs are awarded in rounds, then groups of neighbouring jobs are released and awarded again as long as that
    /// pays.
    Consort,
    /// TeSSI (Nunes and Gini, 2015) with the distance as its objective: in each round the least price of all jobs and
    /// robots is awarded.
    Tessi,
    /// An instantaneous auction: each job in the order of its earliest begin, appended to the robot that begins it
    /// first.
    Greedy,
}

impl AllocationPolicy {
    /// All policies.
    pub const ALL: [AllocationPolicy; 3] =
        [AllocationPolicy::Consort, AllocationPolicy::Tessi, AllocationPolicy::Greedy];

    /// Returns the name.
    pub fn name(self) -> &'static str {
        match self {
            AllocationPolicy::Consort => "consort",
            AllocationPolicy::Tessi => "tessi",
            AllocationPolicy::Greedy => "greedy",
        }
    }
}

/// The text names no policy.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no policy; allowed: consort, tessi, greedy")]
pub struct UnknownAllocationPolicy(String);

impl FromStr for AllocationPolicy {
    type Err = UnknownAllocationPolicy;

    fn from_str(text: &str) -> Result<AllocationPolicy, UnknownAllocationPolicy> {
        let policy = AllocationPolicy::ALL.into_iter().find(|policy| policy.name() == text);
        policy.ok_or_else(|| UnknownAllocationPolicy(text.to_owned()))
    }
}

/// Returns a number of orders with which [`AllocationPolicy::Consort`] finds good routes for so many jobs.
pub fn usual_orders(jobs: usize) -> usize {
    (2_250_000 / jobs.max(1)).clamp(25_000, 60_000)
}

/// Allocates the jobs of an instance, and returns the jobs of each robot in their order. `orders_max` bounds the orders of [`AllocationPolicy::Consort`].
pub async fn allocate(
    instance: &Instance,
    policy: AllocationPolicy,
    market: &mut impl Market,
    orders_max: usize,
    seed: u64,
) -> Vec<Vec<usize>> {
    let to_all = |order: Order| (0..instance.robots).map(|robot| (robot, order.clone())).collect();
    let opening = Order { append: policy == AllocationPolicy::Greedy, ..Order::none() };
    let prices = market.ask(to_all(opening)).await;
    match policy {
        AllocationPolicy::Consort => {
            let chance = ChaCha8Rng::seed_from_u64(seed);
            Reallocation::new(instance, prices, orders_max, chance).run(market).await;
        }
        AllocationPolicy::Tessi => award_cheapest(instance, prices, market).await,
        AllocationPolicy::Greedy => award_in_order(instance, prices, market).await,
    }
    let promised = market.ask(to_all(Order { settlement: Settlement::Keep, ..Order::none() })).await;
    promised.into_iter().map(|prices| prices.route).collect()
}

/// Awards the least price of all jobs and robots until no job fits.
async fn award_cheapest(instance: &Instance, mut prices: Vec<Prices>, market: &mut impl Market) {
    loop {
        let offers = prices
            .iter()
            .enumerate()
            .flat_map(|(robot, prices)| (0..instance.jobs.len()).map(move |job| (prices.added[job], job, robot)));
        let is_open = |job: usize| prices.iter().all(|prices| !prices.route.contains(&job));
        let open: Vec<bool> = (0..instance.jobs.len()).map(is_open).collect();
        let best = offers.filter(|(price, job, _)| price.is_finite() && open[*job]).min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, job, robot)) = best else { return };
        award(job, robot, false, &mut prices, market).await;
    }
}

/// Awards each job in the order of its earliest begin to the robot that begins it first.
async fn award_in_order(instance: &Instance, mut prices: Vec<Prices>, market: &mut impl Market) {
    let mut jobs: Vec<usize> = (0..instance.jobs.len()).collect();
    jobs.sort_by(|a, b| instance.jobs[*a].ready.total_cmp(&instance.jobs[*b].ready));
    for job in jobs {
        let offers = prices.iter().enumerate().map(|(robot, prices)| (prices.begins[job], prices.added[job], robot));
        let fitting = offers.filter(|(begin, ..)| begin.is_finite());
        let best = fitting.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        if let Some((.., robot)) = best {
            award(job, robot, true, &mut prices, market).await;
        }
    }
}

async fn award(job: usize, robot: usize, append: bool, prices: &mut [Prices], market: &mut impl Market) {
    let order = Order { award: vec![job], append, ..Order::none() };
    if let Some(reply) = market.ask(vec![(robot, order)]).await.pop() {
        prices[robot] = reply;
    }
}

#[cfg(test)]
mod tests {
    use super::super::bidder::Bidder;
    use super::super::check::{CheckedRoutes, check_routes};
    use super::super::instance::Site;
    use super::*;
    use rand::RngExt as _;
    use std::future::Future as _;
    use std::pin::pin;
    use std::sync::Arc;
    use std::task::{Context, Poll, Waker};

    /// Robots in this process.
    struct Direct(Vec<Bidder>);

    impl Market for Direct {
        async fn ask(&mut self, orders: Vec<(usize, Order)>) -> Vec<Prices> {
            orders.into_iter().map(|(robot, order)| self.0[robot].execute(&order)).collect()
        }
    }

    fn run(instance: &Arc<Instance>, policy: AllocationPolicy, seed: u64) -> (Vec<Vec<usize>>, CheckedRoutes) {
        let mut market = Direct((0..instance.robots).map(|_| Bidder::new(Arc::clone(instance))).collect());
        // Robots in this process reply at once.
        let mut context = Context::from_waker(Waker::noop());
        let Poll::Ready(routes) = pin!(allocate(instance, policy, &mut market, 2_000, seed)).poll(&mut context) else {
            panic!("a robot did not reply")
        };
        let held: Vec<Vec<usize>> = market.0.iter_mut().map(|robot| robot.execute(&Order::none()).route).collect();
        assert_eq!(held, routes, "the robots have the routes");
        let checked = check_routes(instance, &routes).unwrap_or_else(|problem| panic!("{policy:?}: {problem}"));
        (routes, checked)
    }

    fn site(x: u8, y: u8, demand: u8, ready: u8, width: u8) -> Site {
        let (x, y, demand, ready) = (f64::from(x), f64::from(y), f64::from(demand), f64::from(ready));
        Site { x, y, demand, ready, due: ready + f64::from(width), service: 5.0 }
    }

    /// No policy is late, the repeated auctions leave no more jobs than TeSSI, and a seed determines them.
    #[test]
    fn allocations_keep_all_limits() {
        for seed in 0..256 {
            let mut chance = ChaCha8Rng::seed_from_u64(seed);
            let job = |chance: &mut ChaCha8Rng| {
                let [x, y] = [(); 2].map(|()| chance.random_range(0..50));
                site(x, y, chance.random_range(1..9), chance.random_range(0..200), chance.random_range(5..100))
            };
            let jobs = (0..chance.random_range(1..14)).map(|_| job(&mut chance)).collect();
            let depot = Site { due: 350.0, ..site(25, 25, 0, 0, 0) };
            let robots = chance.random_range(1..4);
            let instance = Arc::new(Instance::new("random".to_owned(), depot, jobs, robots, 20.0));
            let [consort, tessi, greedy] = AllocationPolicy::ALL.map(|policy| run(&instance, policy, seed));
            assert_eq!([&consort, &tessi, &greedy].map(|(_, checked)| checked.late), [0; 3], "seed {seed}");
            assert!(consort.1.unassigned <= tessi.1.unassigned, "seed {seed}: {consort:?} {tessi:?}");
            assert_eq!(run(&instance, AllocationPolicy::Consort, seed), consort, "seed {seed}");
        }
    }

    /// Three jobs on a line, requested in another order.
    #[test]
    fn only_the_instantaneous_auction_appends() {
        let jobs = [(30, 0), (10, 1), (20, 2)].map(|(x, ready)| site(x, 0, 1, ready, 255)).to_vec();
        let depot = Site { due: 1000.0, ..site(0, 0, 0, 0, 0) };
        let instance = Arc::new(Instance::new("line".to_owned(), depot, jobs, 1, 10.0));
        let distance = |policy| run(&instance, policy, 1).1.distance;
        assert_eq!(AllocationPolicy::ALL.map(distance), [60.0, 60.0, 80.0]);
    }
}
