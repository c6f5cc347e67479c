//! Instance of the vehicle routing problem with time windows.

use consort_protocol::timeline::{Job, Timeline, Travel, Window};
use serde::{Deserialize, Serialize};

/// A job of an instance, or the depot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Site {
    /// Position, in units of length.
    pub x: f64,
    /// Position, in units of length.
    pub y: f64,
    /// Share of a robot's capacity.
    pub demand: f64,
    /// Earliest begin.
    pub ready: f64,
    /// Latest begin; of the depot, the latest return.
    pub due: f64,
    /// Duration of the job.
    pub service: f64,
}

/// An instance: jobs, and robots that begin and end at a depot. Robots travel a unit of length in a unit of time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Instance {
    /// Name of the instance.
    pub name: String,
    /// Place where all robots begin and end.
    pub depot: Site,
    /// The jobs.
    pub jobs: Vec<Site>,
    /// Number of robots.
    pub robots: usize,
    /// Capacity of each robot.
    pub capacity: f64,
    /// Distances from each site to each site, the depot last.
    #[serde(skip)]
    distances: Vec<f64>,
}

impl Instance {
    /// Returns an instance.
    pub fn new(name: String, depot: Site, jobs: Vec<Site>, robots: usize, capacity: f64) -> Instance {
        let sites: Vec<&Site> = jobs.iter().chain([&depot]).collect();
        let distances = sites.iter().flat_map(|from| sites.iter().map(|to| distance(from, to))).collect();
        Instance { name, depot, jobs, robots, capacity, distances }
    }

    /// Returns the number of the depot as a place. Jobs have the numbers from 0 on.
    pub fn depot_place(&self) -> usize {
        self.jobs.len()
    }

    /// Returns the distance between two places.
    pub fn distance(&self, from: usize, to: usize) -> f64 {
        self.distances[from * (self.jobs.len() + 1) + to]
    }

    /// Returns a job for timelines.
    pub fn job(&self, number: usize) -> Job<usize, usize> {
        let site = &self.jobs[number];
        let window = Window { earliest_s: site.ready, latest_s: site.due };
        Job { window, duration_s: site.service, load: site.demand, ..Job::at(number, number) }
    }

    /// Returns the timeline of a robot without jobs.
    pub fn timeline(&self) -> Timeline<usize, usize> {
        Timeline::new(self.depot_place(), self.depot.ready)
            .returning_to(self.depot_place(), self.depot.due)
            .with_capacity(self.capacity)
    }
}

impl Travel<usize> for Instance {
    fn seconds(&self, from: &usize, to: &usize) -> f64 {
        self.distance(*from, *to)
    }
}

/// Returns the Euclidean distance, truncated to a decimal place: the convention of exact methods, and of the best known
/// distances.
fn distance(from: &Site, to: &Site) -> f64 {
    ((from.x - to.x).hypot(from.y - to.y) * 10.0).floor() / 10.0
}
