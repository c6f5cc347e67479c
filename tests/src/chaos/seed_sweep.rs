//! Many runs on all cores.

use super::run::{RunConfig, RunOutcome, run};
use super::schedule::Schedule;
use std::ops::RangeInclusive;
use std::panic;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Once, mpsc};
use std::thread;

/// Name of the threads that run fleets.
const THREAD: &str = "chaos";

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
        silence_panics();
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
                let thread = thread::Builder::new().name(THREAD.to_owned());
                thread.spawn_scoped(scope, work).expect("a thread can be started");
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

/// Silences panics on the threads of runs. Injected skill panics are expected, and a panic of a run
/// is reported as its violation.
fn silence_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let default_hook = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if thread::current().name() != Some(THREAD) {
                default_hook(info);
            }
        }));
    });
}
