//! The robot's side of an allocation.

use super::instance::Instance;
use consort_protocol::timeline::{Insertion, Job, Timeline};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What becomes of the changes since the last settlement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Settlement {
    /// They stay open.
    Open,
    /// They are promised.
    Keep,
    /// They are undone.
    Undo,
}

/// Order to a robot. The parts are executed from the first to the last.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Order {
    /// What becomes of the changes before.
    pub settlement: Settlement,
    /// Jobs that the robot gives up.
    pub release: Vec<usize>,
    /// Jobs that the robot gets, each at its best position, in this order.
    pub award: Vec<usize>,
    /// Jobs are appended to the others only.
    pub append: bool,
}

impl Order {
    /// Returns an order that changes nothing.
    pub fn none() -> Order {
        Order { settlement: Settlement::Open, release: vec![], award: vec![], append: false }
    }
}

/// Reply of a robot: its timeline, and the price of each further job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Prices {
    /// Its jobs in their order.
    pub route: Vec<usize>,
    /// Distance of its route.
    pub travel: f64,
    /// Additional distance for each job of the instance; infinity for its own jobs, and for those that do not fit.
    pub added: Vec<f64>,
    /// Begin of each job of the instance, infinity where `added` is; empty unless jobs are appended.
    pub begins: Vec<f64>,
}

/// A robot that prices jobs by its own timeline.
#[derive(Debug, Clone)]
pub struct Bidder {
    instance: Arc<Instance>,
    promised: Timeline<usize, usize>,
    timeline: Timeline<usize, usize>,
}

impl Bidder {
    /// Returns a robot without jobs.
    pub fn new(instance: Arc<Instance>) -> Bidder {
        let timeline = instance.timeline();
        Bidder { instance, promised: timeline.clone(), timeline }
    }

    /// Executes an order. A job that does not fit is not inserted: the reply shows the route.
    pub fn execute(&mut self, order: &Order) -> Prices {
        let instance = &*self.instance;
        match order.settlement {
            Settlement::Open => {}
            Settlement::Keep => self.promised.clone_from(&self.timeline),
            Settlement::Undo => self.timeline.clone_from(&self.promised),
        }
        if !order.release.is_empty() {
            self.timeline.remove(|job| order.release.contains(job), instance);
        }
        for &number in order.award.iter().filter(|number| **number < instance.jobs.len()) {
            let job = instance.job(number);
            if let Some(insertion) = insertion(&self.timeline, &job, order.append, instance) {
                self.timeline.insert(job, insertion.position, instance);
            }
        }
        self.prices(order.append)
    }

    fn prices(&self, append: bool) -> Prices {
        let instance = &*self.instance;
        let jobs = instance.jobs.len();
        let route: Vec<usize> = self.timeline.jobs().map(|job| job.key).collect();
        let found = (0..jobs).map(|number| {
            let is_other = !route.contains(&number);
            is_other.then(|| insertion(&self.timeline, &instance.job(number), append, instance)).flatten()
        });
        let found: Vec<Option<Insertion>> = found.collect();
        let each = |value: fn(Insertion) -> f64| found.iter().map(|found| found.map_or(f64::INFINITY, value)).collect();
        Prices {
            travel: self.timeline.travel_s(instance),
            route,
            added: each(|found| found.added_travel_s),
            begins: if append { each(|found| found.begin_s) } else { vec![] },
        }
    }
}

fn insertion(
    timeline: &Timeline<usize, usize>,
    job: &Job<usize, usize>,
    append: bool,
    instance: &Instance,
) -> Option<Insertion> {
    if append { timeline.last_insertion(job, instance) } else { timeline.best_insertion(job, instance) }
}
