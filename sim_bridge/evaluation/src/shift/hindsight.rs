//! The oracle of a shift: a plan made with the knowledge of all requests.
//!
//! The requests are inserted in small groups in the order of their times: of the open jobs of a group, the job with the
//! greatest regret (the difference between its two cheapest robots) gets its cheapest position. Then jobs with
//! neighbouring times are released and inserted again, and the result is kept unless it is worse (a large neighbourhood
//! search, Shaw 1998). The plan is good, not optimal: a policy may be better.

use crate::seeds::generator;
use consort_protocol::timeline::Travel;
use rand::RngExt as _;

/// Number of jobs that are inserted together.
const GROUP: usize = 8;

/// Number of times that a group is released, for each job.
const ROUNDS_PER_JOB: usize = 10;

/// Delays below this number of seconds are rounding errors.
const ROUNDING_S: f64 = 1e-9;

/// Work of a request.
#[derive(Debug, Clone, PartialEq)]
pub struct ShiftJob<P> {
    /// Time of the request in seconds. No robot sets out before it.
    pub requested_s: f64,
    /// Place where the work begins.
    pub from: P,
    /// Place where it ends.
    pub to: P,
    /// Duration of the work in seconds, without the drive to its begin.
    pub duration_s: f64,
}

/// Job in the route of a robot.
#[derive(Debug, Clone, Copy)]
struct Stop {
    job: usize,
    set_out_s: f64,
    end_s: f64,
}

struct Planner<'a, P, T> {
    jobs: &'a [ShiftJob<P>],
    starts: &'a [P],
    travel: &'a T,
}

/// Plans jobs, given in the order of their requests, for robots that are free at these places at time 0. Returns the
/// jobs of each robot in their order. The plan minimises the sum of the times from the requests to the ends of the
/// jobs, as far as the method finds it. All places can be reached from each other.
///
/// # Panics
/// If there are jobs and no robots.
pub fn plan_in_hindsight<P>(jobs: &[ShiftJob<P>], starts: &[P], travel: &impl Travel<P>, seed: u64) -> Vec<Vec<usize>> {
    assert!(jobs.is_empty() || !starts.is_empty(), "no robot for {} jobs", jobs.len());
    let planner = Planner { jobs, starts, travel };
    let mut routes: Vec<Vec<Stop>> = vec![vec![]; starts.len()];
    let numbers: Vec<usize> = (0..jobs.len()).collect();
    for group in numbers.chunks(GROUP) {
        planner.insert_by_regret(&mut routes, group);
    }
    let mut chance = generator(seed, &["hindsight"]);
    let mut cost = planner.cost(&routes);
    for _ in 0..jobs.len() * ROUNDS_PER_JOB {
        let first = chance.random_range(0..jobs.len());
        let group = &numbers[first..jobs.len().min(first + chance.random_range(1..=GROUP))];
        let mut changed = routes.clone();
        planner.remove(&mut changed, group);
        planner.insert_by_regret(&mut changed, group);
        let changed_cost = planner.cost(&changed);
        if changed_cost <= cost {
            (routes, cost) = (changed, changed_cost);
        }
    }
    routes.iter().map(|route| route.iter().map(|stop| stop.job).collect()).collect()
}

impl<P, T: Travel<P>> Planner<'_, P, T> {
    /// Returns the stop for a job after another; after `None` it is the first of the robot.
    fn stop_after(&self, robot: usize, before: Option<Stop>, job: usize) -> Stop {
        let (place, free_s) = before.map_or((&self.starts[robot], 0.0), |stop| (&self.jobs[stop.job].to, stop.end_s));
        let ShiftJob { requested_s, from, duration_s, .. } = &self.jobs[job];
        let set_out_s = free_s.max(*requested_s);
        Stop { job, set_out_s, end_s: set_out_s + self.travel.seconds(place, from) + duration_s }
    }

    /// Computes the times of a route from a position on.
    fn update(&self, robot: usize, route: &mut [Stop], from: usize) {
        let mut last = from.checked_sub(1).map(|before| route[before]);
        for stop in route.iter_mut().skip(from) {
            *stop = self.stop_after(robot, last, stop.job);
            last = Some(*stop);
        }
    }

    /// Returns the time from the request of a job to its end, with the delays of the others.
    fn added_cost(&self, robot: usize, route: &[Stop], position: usize, job: usize) -> f64 {
        let before = position.checked_sub(1).map(|before| route[before]);
        let mut last = self.stop_after(robot, before, job);
        let mut cost = last.end_s - self.jobs[job].requested_s;
        for stop in &route[position..] {
            last = self.stop_after(robot, Some(last), stop.job);
            let delay_s = last.end_s - stop.end_s;
            cost += delay_s;
            if delay_s.abs() < ROUNDING_S {
                break; // the rest of the route is as before
            }
        }
        cost
    }

    /// Returns the cheapest position of a job in a route with its cost. A job is not inserted before a job for which
    /// the robot sets out before its request.
    fn cheapest(&self, robot: usize, route: &[Stop], job: usize) -> (f64, usize) {
        let requested_s = self.jobs[job].requested_s;
        let first = route.partition_point(|stop| stop.set_out_s < requested_s);
        let mut best = (f64::INFINITY, first);
        for position in first..=route.len() {
            let free_s = position.checked_sub(1).map_or(0.0, |before| route[before].end_s);
            if free_s - requested_s >= best.0 {
                break; // it would end later still
            }
            let cost = self.added_cost(robot, route, position, job);
            if cost < best.0 {
                best = (cost, position);
            }
        }
        best
    }

    fn insert_by_regret(&self, routes: &mut [Vec<Stop>], jobs: &[usize]) {
        let mut open = jobs.to_vec();
        while !open.is_empty() {
            let mut chosen: Option<(f64, usize, usize, usize)> = None;
            for (index, job) in open.iter().enumerate() {
                let (mut best, mut second) = ((f64::INFINITY, 0, 0), f64::INFINITY);
                for (robot, route) in routes.iter().enumerate() {
                    let (cost, position) = self.cheapest(robot, route, *job);
                    if cost < best.0 {
                        second = best.0;
                        best = (cost, robot, position);
                    } else {
                        second = second.min(cost);
                    }
                }
                let regret = second - best.0;
                if chosen.is_none_or(|(greatest, ..)| regret > greatest) {
                    chosen = Some((regret, index, best.1, best.2));
                }
            }
            let Some((_, index, robot, position)) = chosen else { return };
            let stop = Stop { job: open.remove(index), set_out_s: 0.0, end_s: 0.0 };
            routes[robot].insert(position, stop);
            self.update(robot, &mut routes[robot], position);
        }
    }

    fn remove(&self, routes: &mut [Vec<Stop>], jobs: &[usize]) {
        for (robot, route) in routes.iter_mut().enumerate() {
            if let Some(first) = route.iter().position(|stop| jobs.contains(&stop.job)) {
                route.retain(|stop| !jobs.contains(&stop.job));
                self.update(robot, route, first);
            }
        }
    }

    /// Returns the sum of the times from the requests to the ends.
    fn cost(&self, routes: &[Vec<Stop>]) -> f64 {
        routes.iter().flatten().map(|stop| stop.end_s - self.jobs[stop.job].requested_s).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places on a line, a metre apart, at a metre per second.
    struct Line;

    impl Travel<f64> for Line {
        fn seconds(&self, from: &f64, to: &f64) -> f64 {
            (to - from).abs()
        }
    }

    fn job(requested_s: f64, from: f64, to: f64) -> ShiftJob<f64> {
        ShiftJob { requested_s, from, to, duration_s: 100.0 + (to - from).abs() }
    }

    /// Drives the routes, and returns the sum of the times from the requests to the ends.
    fn drive(jobs: &[ShiftJob<f64>], starts: &[f64], routes: &[Vec<usize>]) -> f64 {
        let mut sum = 0.0;
        for (start, route) in starts.iter().zip(routes) {
            let (mut at, mut now) = (*start, 0.0_f64);
            for job in route.iter().map(|number| &jobs[*number]) {
                now = now.max(job.requested_s) + (job.from - at).abs() + job.duration_s;
                at = job.to;
                sum += now - job.requested_s;
            }
        }
        sum
    }

    /// Returns the least sum of all allocations.
    fn least(jobs: &[ShiftJob<f64>], starts: &[f64], routes: &mut [Vec<usize>], next: usize) -> f64 {
        if next == jobs.len() {
            return drive(jobs, starts, routes);
        }
        let mut best = f64::INFINITY;
        for robot in 0..starts.len() {
            for position in 0..=routes[robot].len() {
                routes[robot].insert(position, next);
                best = best.min(least(jobs, starts, routes, next + 1));
                routes[robot].remove(position);
            }
        }
        best
    }

    #[test]
    fn a_later_request_changes_the_robot_of_an_earlier_one() {
        // The second robot is nearer to both places, but takes the second job.
        let jobs = [job(0.0, 31.0, 31.0), job(1.0, 90.0, 90.0)];
        assert_eq!(plan_in_hindsight(&jobs, &[0.0, 60.0], &Line, 1), [vec![0], vec![1]]);
        assert_eq!(plan_in_hindsight(&jobs[..1], &[0.0, 60.0], &Line, 1), [vec![], vec![0]]);
    }

    #[test]
    fn plans_contain_each_job_once_and_are_close_to_the_optimum() {
        let (mut planned, mut optimal) = (0.0, 0.0);
        for seed in 0..40 {
            let mut chance = generator(seed, &["test"]);
            let mut place = || f64::from(chance.random_range(0_u8..100));
            let jobs: Vec<ShiftJob<f64>> =
                (0..5).map(|number| job(f64::from(number) * 40.0, place(), place())).collect();
            let starts = [place(), place()];
            let routes = plan_in_hindsight(&jobs, &starts, &Line, seed);
            let mut numbers = routes.concat();
            numbers.sort_unstable();
            assert_eq!(numbers, [0, 1, 2, 3, 4], "seed {seed}");
            let cost = drive(&jobs, &starts, &routes);
            let best = least(&jobs, &starts, &mut [vec![], vec![]], 0);
            assert!(cost >= best - 1e-6, "seed {seed}: {cost} is better than the optimum {best}");
            planned += cost;
            optimal += best;
        }
        assert!(planned <= optimal * 1.05, "{planned} instead of {optimal}");
    }

    #[test]
    fn no_requests_need_no_robots() {
        assert!(plan_in_hindsight::<f64>(&[], &[], &Line, 1).is_empty());
    }
}
