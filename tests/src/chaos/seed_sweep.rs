//! Many runs on all cores.

use super::run::{RunConfig, RunOutcome, run};
use super::schedule::Schedule;
use std::ops::RangeInclusive;
use std::panic;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Once, mpsc};
use std::thread;

/// The name of threads that run fleets.
const THREAD: &str = "chaos";

/// Runs that are done one after the other on each of `jobs` threads.
pub struct SeedSweep<'a> {
    /// The seeds, from the first to the last.
    pub seeds: RangeInclusive<u64>,
    /// How many threads.
    pub jobs: usize,
    /// What is run for a seed.
    pub config: &'a (dyn Fn(u64) -> (RunConfig, Schedule) + Sync),
    /// Called on each thread before its first run.
    pub prepare: &'a (dyn Fn() + Sync),
}

impl SeedSweep<'_> {
    /// Runs them all, and tells of each outcome as it comes, unless one shows a violation: then no larger seed is begun,
    /// and the violation of the smallest seed is given back. So the answer does not depend on which thread is faster.
    pub fn run(&self, mut each: impl FnMut(&RunOutcome)) -> Option<RunOutcome> {
        be_quiet();
        let next = AtomicU64::new(*self.seeds.start());
        let last = AtomicU64::new(*self.seeds.end());
        let (tell, outcomes) = mpsc::channel();
        thread::scope(|scope| {
            for _ in 0..self.jobs.max(1) {
                let (tell, next, last) = (tell.clone(), &next, &last);
                let work = move || {
                    (self.prepare)();
                    loop {
                        let seed = next.fetch_add(1, Ordering::Relaxed);
                        if seed > last.load(Ordering::Relaxed) {
                            return;
                        }
                        let (order, schedule) = (self.config)(seed);
                        let outcome = run(&order, &schedule);
                        if outcome.violation.is_some() {
                            last.fetch_min(seed, Ordering::Relaxed);
                        }
                        if tell.send(outcome).is_err() {
                            return;
                        }
                    }
                };
                let thread = thread::Builder::new().name(THREAD.to_owned());
                thread.spawn_scoped(scope, work).expect("the system has a thread left");
            }
            drop(tell);
            let mut found: Option<RunOutcome> = None;
            for outcome in outcomes {
                each(&outcome);
                if outcome.violation.is_some() && found.as_ref().is_none_or(|found| outcome.seed < found.seed) {
                    found = Some(outcome);
                }
            }
            found
        })
    }
}

/// Panics of skills that chaos makes panic are no news; those of a run are told as its violation.
fn be_quiet() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let usual = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if thread::current().name() != Some(THREAD) {
                usual(info);
            }
        }));
    });
}

/// The middle of some times and the one that only one in a hundred exceeds, by the nearest rank; `None` without any.
pub fn percentiles(times: &[u64]) -> Option<(u64, u64)> {
    let mut sorted = times.to_vec();
    sorted.sort_unstable();
    let rank = |percent: usize| sorted[(sorted.len() * percent).div_ceil(100).max(1) - 1];
    if sorted.is_empty() { None } else { Some((rank(50), rank(99))) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_times_that_were_measured() {
        assert_eq!(percentiles(&[]), None);
        assert_eq!(percentiles(&[7]), Some((7, 7)));
        assert_eq!(percentiles(&(1..=200).collect::<Vec<_>>()), Some((100, 198)));
    }
}
