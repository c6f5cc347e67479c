//! Check of routes, independent of the timelines that made them.

use super::instance::Instance;

/// Routes as they are driven.
#[derive(Debug, Clone, PartialEq)]
pub struct CheckedRoutes {
    /// Sum of all distances, with the ways from and to the depot.
    pub distance: f64,
    /// Jobs that begin after their latest begin, and robots that return too late.
    pub late: usize,
    /// Jobs that no robot does.
    pub unassigned: usize,
}

/// Routes are no allocation.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RouteProblem {
    /// More than one robot does a job, or a robot does it twice.
    #[error("job {0} is done twice")]
    Twice(usize),
    /// A robot has more than its capacity.
    #[error("robot {0} is over its capacity")]
    Overloaded(usize),
}

/// Drives the route of each robot.
///
/// # Errors
/// [`RouteProblem`]: the routes are no allocation of the instance.
///
/// # Panics
/// If a route contains a job that the instance does not have.
pub fn check_routes(instance: &Instance, routes: &[Vec<usize>]) -> Result<CheckedRoutes, RouteProblem> {
    let mut done = vec![false; instance.jobs.len()];
    let mut checked = CheckedRoutes { distance: 0.0, late: 0, unassigned: 0 };
    for (robot, route) in routes.iter().enumerate() {
        let (mut at, mut now, mut load) = (instance.depot_place(), instance.depot.ready, 0.0);
        for &number in route {
            if std::mem::replace(&mut done[number], true) {
                return Err(RouteProblem::Twice(number));
            }
            let site = &instance.jobs[number];
            let way = instance.distance(at, number);
            let begin = (now + way).max(site.ready);
            checked.late += usize::from(begin > site.due);
            checked.distance += way;
            load += site.demand;
            (at, now) = (number, begin + site.service);
        }
        if !route.is_empty() {
            let way = instance.distance(at, instance.depot_place());
            checked.late += usize::from(now + way > instance.depot.due);
            checked.distance += way;
        }
        if load > instance.capacity {
            return Err(RouteProblem::Overloaded(robot));
        }
    }
    checked.unassigned = done.iter().filter(|done| !**done).count();
    // Distances have a decimal place; the sum has rounding errors.
    checked.distance = (checked.distance * 10.0).round() / 10.0;
    Ok(checked)
}
