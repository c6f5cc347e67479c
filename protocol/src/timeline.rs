//! Timeline of a robot: jobs in the order in which the robot does them, with the travel between them.
//!
//! A timeline is a simple temporal network in the form of a chain. Each job begins within its window, and after the
//! robot has ended the job before it, has waited for its release, and has travelled. Two passes solve the network: the earliest begins from the
//! front, and the latest begins from the back. With both, a position for another job is checked in constant time:
//!
//! ```text
//!            ended a      job begins                   b must begin
//!   ── a ────────┤ travel ├──── job ────┤ travel ├──── by its latest begin ── b ──
//! ```
//!
//! ```
//! use consort_protocol::timeline::{Job, Timeline, Travel, Window};
//!
//! /// Places on a line, a metre apart, and a robot that drives a metre per second.
//! struct Line;
//! impl Travel<f64> for Line {
//!     fn seconds(&self, from: &f64, to: &f64) -> f64 {
//!         (to - from).abs()
//!     }
//! }
//! let job = |key, place, earliest_s| Job {
//!     window: Window { earliest_s, latest_s: 100.0 },
//!     duration_s: 5.0,
//!     ..Job::at(key, place)
//! };
//! let mut timeline = Timeline::new(0.0, 0.0);
//! timeline.insert(job("far", 30.0, 60.0), 0, &Line);
//! let near = job("near", 10.0, 0.0);
//! let best = timeline.best_insertion(&near, &Line).expect("there is time before the other job");
//! assert_eq!((best.position, best.begin_s, best.added_travel_s), (0, 10.0, 0.0));
//! ```

use serde::{Deserialize, Serialize};

/// Duration of drives.
pub trait Travel<P> {
    /// Returns the seconds from one place to another; infinity without a route.
    fn seconds(&self, from: &P, to: &P) -> f64;
}

/// Time window in which a job begins.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Window {
    /// Earliest begin in seconds.
    pub earliest_s: f64,
    /// Latest begin in seconds.
    pub latest_s: f64,
}

impl Window {
    /// Any time from 0 on.
    pub const ANY: Window = Window { earliest_s: 0.0, latest_s: f64::INFINITY };
}

/// Work that a robot does at a time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Job<K, P> {
    /// Name of the job.
    pub key: K,
    /// Place where it begins.
    pub from: P,
    /// Place where it ends.
    pub to: P,
    /// Time in which it begins.
    pub window: Window,
    /// Release in seconds: the robot does not leave for it earlier.
    pub release_s: f64,
    /// Duration in seconds.
    pub duration_s: f64,
    /// Share of the robot's capacity that it takes.
    pub load: f64,
}

impl<K, P: Clone> Job<K, P> {
    /// Returns a job at a place that takes no time and no capacity.
    pub fn at(key: K, place: P) -> Job<K, P> {
        let (from, window) = (place.clone(), Window::ANY);
        Job { key, from, to: place, window, release_s: 0.0, duration_s: 0.0, load: 0.0 }
    }
}

impl<K, P> Job<K, P> {
    /// Returns the begin in seconds, if the robot is free at a time and travels for a time.
    fn begin_after(&self, free_s: f64, travel_s: f64) -> f64 {
        (free_s.max(self.release_s) + travel_s).max(self.window.earliest_s)
    }
}

/// Position for a job in a timeline.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Insertion {
    /// Number of jobs before it.
    pub position: usize,
    /// Seconds of additional travel.
    pub added_travel_s: f64,
    /// Begin of the job in seconds.
    pub begin_s: f64,
    /// Seconds by which the next job begins later. The jobs after that begin later by at most as much.
    pub delay_s: f64,
}

#[derive(Debug, Clone, PartialEq)]
struct Entry<K, P> {
    job: Job<K, P>,
    /// Earliest begin after the jobs before it.
    begin_s: f64,
    /// Latest begin with which all later jobs still begin within their windows.
    latest_s: f64,
}

impl<K, P> Entry<K, P> {
    fn end_s(&self) -> f64 {
        self.begin_s + self.job.duration_s
    }
}

/// Jobs of a robot in their order.
#[derive(Debug, Clone, PartialEq)]
pub struct Timeline<K, P> {
    from: P,
    from_s: f64,
    /// Place where the robot must be in the end, and the time in seconds.
    home: Option<(P, f64)>,
    capacity: f64,
    entries: Vec<Entry<K, P>>,
    load: f64,
}

impl<K: PartialEq, P> Timeline<K, P> {
    /// Returns the timeline of a robot that is free at a place from a time on, in seconds.
    pub fn new(from: P, from_s: f64) -> Timeline<K, P> {
        Timeline { from, from_s, home: None, capacity: f64::INFINITY, entries: vec![], load: 0.0 }
    }

    /// Requires the robot to be at a place in the end, by a time in seconds.
    #[must_use]
    pub fn returning_to(self, home: P, by_s: f64) -> Timeline<K, P> {
        Timeline { home: Some((home, by_s)), ..self }
    }

    /// Limits the sum of the loads of all jobs.
    #[must_use]
    pub fn with_capacity(self, capacity: f64) -> Timeline<K, P> {
        Timeline { capacity, ..self }
    }

    /// Sets the jobs in their order, whether or not they begin within their windows.
    #[must_use]
    pub fn with_jobs(mut self, jobs: impl IntoIterator<Item = Job<K, P>>, travel: &impl Travel<P>) -> Timeline<K, P> {
        self.entries = jobs.into_iter().map(|job| Entry { job, begin_s: 0.0, latest_s: 0.0 }).collect();
        self.load = self.entries.iter().map(|entry| entry.job.load).sum();
        self.update(travel);
        self
    }

    /// Returns the jobs in their order.
    pub fn jobs(&self) -> impl ExactSizeIterator<Item = &Job<K, P>> {
        self.entries.iter().map(|entry| &entry.job)
    }

    /// Returns the jobs in their order, with the earliest begin of each in seconds.
    pub fn begins(&self) -> impl Iterator<Item = (&Job<K, P>, f64)> {
        self.entries.iter().map(|entry| (&entry.job, entry.begin_s))
    }

    /// Returns the time from which the robot has nothing to do, in seconds.
    pub fn free_from_s(&self) -> f64 {
        self.entries.last().map_or(self.from_s, Entry::end_s)
    }

    /// Returns the seconds of travel in all, with the way home.
    pub fn travel_s(&self, travel: &impl Travel<P>) -> f64 {
        let mut at = &self.from;
        let mut sum = 0.0;
        for Entry { job, .. } in &self.entries {
            sum += travel.seconds(at, &job.from);
            at = &job.to;
        }
        let home = self.home.as_ref().filter(|_| !self.entries.is_empty());
        sum + home.map_or(0.0, |(home, _)| travel.seconds(at, home))
    }

    /// Returns the position with the least additional travel; the first of equal ones. `None` if the job fits nowhere.
    pub fn best_insertion(&self, job: &Job<K, P>, travel: &impl Travel<P>) -> Option<Insertion> {
        self.cheapest_insertion(job, travel, |insertion| insertion.added_travel_s)
    }

    /// Returns the position with the least cost; the first of equal ones. `None` if the job fits nowhere.
    pub fn cheapest_insertion<C: PartialOrd>(
        &self,
        job: &Job<K, P>,
        travel: &impl Travel<P>,
        cost_of: impl Fn(&Insertion) -> C,
    ) -> Option<Insertion> {
        if self.load + job.load > self.capacity {
            return None;
        }
        let mut best: Option<(C, Insertion)> = None;
        for position in 0..=self.entries.len() {
            // At all later positions it begins later still.
            let free_s = position.checked_sub(1).map_or(self.from_s, |before| self.entries[before].end_s());
            if free_s > job.window.latest_s {
                break;
            }
            if let Some(insertion) = self.check_position(job, position, travel) {
                let cost = cost_of(&insertion);
                if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                    best = Some((cost, insertion));
                }
            }
        }
        best.map(|(_, insertion)| insertion)
    }

    /// Returns the insertion after all jobs, if the job fits there.
    pub fn last_insertion(&self, job: &Job<K, P>, travel: &impl Travel<P>) -> Option<Insertion> {
        if self.load + job.load > self.capacity {
            return None;
        }
        self.check_position(job, self.entries.len(), travel)
    }

    fn check_position(&self, job: &Job<K, P>, position: usize, travel: &impl Travel<P>) -> Option<Insertion> {
        let (before, free_s) = match position.checked_sub(1).map(|before| &self.entries[before]) {
            Some(before) => (&before.job.to, before.end_s()),
            None => (&self.from, self.from_s),
        };
        let there_s = travel.seconds(before, &job.from);
        let begin_s = job.begin_after(free_s, there_s);
        if begin_s > job.window.latest_s {
            return None;
        }
        let end_s = begin_s + job.duration_s;
        let (onwards_s, direct_s, by_s) = match (self.entries.get(position), &self.home) {
            (Some(next), _) => {
                let next_place = &next.job.from;
                (travel.seconds(&job.to, next_place), travel.seconds(before, next_place), next.latest_s)
            }
            // Without a job the robot stays where it is.
            (None, Some((home, by_s))) if self.entries.is_empty() => (travel.seconds(&job.to, home), 0.0, *by_s),
            (None, Some((home, by_s))) => (travel.seconds(&job.to, home), travel.seconds(before, home), *by_s),
            (None, None) => (0.0, 0.0, f64::INFINITY),
        };
        let next = self.entries.get(position);
        let delay_s = next.map_or(0.0, |next| (next.job.begin_after(end_s, onwards_s) - next.begin_s).max(0.0));
        let leaves_s = next.map_or(end_s, |next| end_s.max(next.job.release_s));
        // An unreachable place is infinitely far.
        (leaves_s + onwards_s <= by_s && (there_s + onwards_s).is_finite()).then_some(Insertion {
            position,
            added_travel_s: there_s + onwards_s - direct_s,
            begin_s,
            delay_s,
        })
    }

    /// Inserts a job at a position of [`best_insertion`](Self::best_insertion).
    ///
    /// # Panics
    /// If the position is behind the end.
    pub fn insert(&mut self, job: Job<K, P>, position: usize, travel: &impl Travel<P>) {
        self.load += job.load;
        self.entries.insert(position, Entry { job, begin_s: 0.0, latest_s: 0.0 });
        self.update(travel);
    }

    /// Removes the jobs for which `matches` is true. All others still begin within their windows if no detour is faster
    /// than the direct way, and if each job lasts at least as long as the way from its begin to its end.
    pub fn remove(&mut self, mut matches: impl FnMut(&K) -> bool, travel: &impl Travel<P>) {
        self.entries.retain(|entry| !matches(&entry.job.key));
        // The sum of what is left: differences would accumulate rounding errors.
        self.load = self.entries.iter().map(|entry| entry.job.load).sum();
        self.update(travel);
    }

    /// Solves the network: earliest begins from the front, latest begins from the back.
    fn update(&mut self, travel: &impl Travel<P>) {
        let (mut at, mut free_s) = (&self.from, self.from_s);
        for entry in &mut self.entries {
            entry.begin_s = entry.job.begin_after(free_s, travel.seconds(at, &entry.job.from));
            (at, free_s) = (&entry.job.to, entry.end_s());
        }
        let mut next = self.home.as_ref().map(|(home, by_s)| (home, *by_s));
        for Entry { job, latest_s, .. } in self.entries.iter_mut().rev() {
            let by_s = next.map_or(f64::INFINITY, |(place, by_s)| by_s - travel.seconds(&job.to, place));
            *latest_s = job.window.latest_s.min(by_s - job.duration_s);
            next = Some((&job.from, *latest_s));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Places on a line, a metre apart, at a metre per second.
    struct Line;

    impl Travel<f64> for Line {
        fn seconds(&self, from: &f64, to: &f64) -> f64 {
            (to - from).abs()
        }
    }

    fn job(key: usize, place: f64, earliest_s: f64, latest_s: f64) -> Job<usize, f64> {
        Job { window: Window { earliest_s, latest_s }, duration_s: 2.0, load: 1.0, ..Job::at(key, place) }
    }

    /// Checks an order of jobs by driving it, and returns the travel.
    fn drive(jobs: &[Job<usize, f64>], home: (f64, f64), capacity: f64) -> Option<f64> {
        let (mut at, mut now, mut travelled) = (0.0_f64, 0.0_f64, 0.0);
        for job in jobs {
            let way = (job.from - at).abs();
            now = (now + way).max(job.window.earliest_s);
            if now > job.window.latest_s {
                return None;
            }
            (at, now, travelled) = (job.to, now + job.duration_s, travelled + way);
        }
        let way = if jobs.is_empty() { 0.0 } else { (home.0 - at).abs() };
        let load: f64 = jobs.iter().map(|job| job.load).sum();
        (now + way <= home.1 && load <= capacity).then_some(travelled + way)
    }

    proptest! {
        /// The chosen position is the best of all positions at which the robot can drive the jobs.
        #[test]
        fn the_best_position_is_found(
            offers in prop::collection::vec((0_u8..40, 0_u8..60, 0_u8..30, 0_u8..20), 1..12),
            home in (0_u8..20, 60_u8..120),
            capacity in 3_u8..12,
        ) {
            let (home, capacity) = ((f64::from(home.0), f64::from(home.1)), f64::from(capacity));
            let mut timeline = Timeline::new(0.0, 0.0).returning_to(home.0, home.1).with_capacity(capacity);
            for (key, (place, earliest, width, way)) in offers.into_iter().enumerate() {
                let mut job = job(key, f64::from(place), f64::from(earliest), f64::from(earliest) + f64::from(width));
                job.to += f64::from(way);
                job.duration_s += f64::from(way);
                let known: Vec<Job<usize, f64>> = timeline.jobs().cloned().collect();
                let before = drive(&known, home, capacity).expect("all jobs so far were inserted");
                prop_assert_eq!(timeline.travel_s(&Line), before);
                let with = |position: usize| {
                    let mut order = known.clone();
                    order.insert(position, job.clone());
                    Some((position, drive(&order, home, capacity)? - before))
                };
                let mut best: Option<(usize, f64)> = None;
                for (position, added) in (0..=known.len()).filter_map(with) {
                    if best.is_none_or(|(_, least)| added < least) {
                        best = Some((position, added));
                    }
                }
                let found = timeline.best_insertion(&job, &Line);
                prop_assert_eq!(found.map(|found| (found.position, found.added_travel_s)), best);
                let last = timeline.last_insertion(&job, &Line).map(|found| found.added_travel_s);
                prop_assert_eq!(last, with(known.len()).map(|(_, added)| added));
                if let Some(found) = found {
                    timeline.insert(job, found.position, &Line);
                    let begin_s = timeline.begins().find(|(job, _)| job.key == key).map(|(_, begin_s)| begin_s);
                    prop_assert_eq!(begin_s, Some(found.begin_s));
                } else if key % 3 == 0 {
                    timeline.remove(|other| other % 2 == 0, &Line);
                }
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// No insertion moves a job out of its window, or lets the robot leave before a release.
        #[test]
        fn insertions_keep_windows_and_releases(
            offers in prop::collection::vec((0_u8..40, 0_u8..60, 0_u8..30, 0_u8..60), 1..10),
        ) {
            let mut timeline = Timeline::new(0.0, 0.0);
            for (key, (place, earliest, width, release)) in offers.into_iter().enumerate() {
                let (place, earliest, release_s) = (f64::from(place), f64::from(earliest), f64::from(release));
                let job = Job { release_s, ..job(key, place, earliest, earliest + f64::from(width)) };
                let Some(found) = timeline.best_insertion(&job, &Line) else { continue };
                timeline.insert(job, found.position, &Line);
                let (mut at, mut free_s) = (0.0_f64, 0.0_f64);
                for (job, begin_s) in timeline.begins() {
                    let way = (job.from - at).abs();
                    prop_assert_eq!(begin_s, (free_s.max(job.release_s) + way).max(job.window.earliest_s));
                    prop_assert!(begin_s <= job.window.latest_s, "{job:?} begins at {begin_s}");
                    (at, free_s) = (job.to, begin_s + job.duration_s);
                }
                let begin_s = timeline.begins().find(|(job, _)| job.key == key).map(|(_, begin_s)| begin_s);
                prop_assert_eq!(begin_s, Some(found.begin_s));
            }
        }
    }

    #[test]
    fn a_job_at_an_unreachable_place_fits_nowhere() {
        struct Island;
        impl Travel<f64> for Island {
            fn seconds(&self, from: &f64, to: &f64) -> f64 {
                if (*from < 100.0) == (*to < 100.0) { (to - from).abs() } else { f64::INFINITY }
            }
        }
        let mut timeline = Timeline::new(0.0, 0.0);
        let at =
            |key, place| Job { window: Window { earliest_s: 0.0, latest_s: f64::MAX }, ..job(key, place, 0.0, 0.0) };
        assert_eq!(timeline.best_insertion(&at(0, 200.0), &Island), None);
        timeline.insert(at(1, 50.0), 0, &Island);
        assert_eq!(timeline.best_insertion(&at(2, 200.0), &Island), None);
        assert_eq!(timeline.best_insertion(&at(3, 70.0), &Island).map(|found| found.position), Some(1));
    }
}
