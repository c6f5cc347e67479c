//! Many runs on all cores.

use super::quiet_thread::quiet_thread;
use super::run::{RunConfig, RunOutcome, run};
use super::schedule::Schedule;
use std::ops::RangeInclusive;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc;
use std::thread;

/// Sweep over seeds. Each of the `jobs` threads executes its runs in sequence.
pub struct SeedSweep<'a> {
    /// The seeds, from the first to the last.
    pub seeds: RangeInclusive<u64>,
    /// Number of threads.
    pub jobs: usize,
    /// Returns the configuration and the schedule of a seed.
    pub config: &'a (dyn Fn(u64) -> (RunConfig, Schedule) + Sync),
}

impl SeedSweep<'_> {
    /// Executes the runs and passes each outcome to `each`. After a violation, no larger seed
    /// begins, and the violation of the smallest seed is returned. So the result does not depend on
    /// the speed of the threads.
    pub fn run(&self, mut each: impl FnMut(&RunOutcome)) -> Option<RunOutcome> {
        let next = AtomicU64::new(*self.seeds.start());
        let last = AtomicU64::new(*self.seeds.end());
        let (sender, outcomes) = mpsc::channel();
        thread::scope(|scope| {
            for _ in 0..self.jobs.max(1) {
                let (sender, next, last) = (sender.clone(), &next, &last);
                let work = move || loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed > last.load(Ordering::Relaxed) {
                        return;
                    }
                    let (config, schedule) = (self.config)(seed);
                    let outcome = run(&config, &schedule);
                    if outcome.violation.is_some() {
                        last.fetch_min(seed, Ordering::Relaxed);
                    }
                    if sender.send(outcome).is_err() {
                        return;
                    }
                };
                quiet_thread().spawn_scoped(scope, work).expect("a thread can be started");
            }
            drop(sender);
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
