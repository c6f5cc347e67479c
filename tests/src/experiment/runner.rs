//! Runs many trials on all cores.

use super::setup::ExperimentSetup;
use super::trial::{TrialOutcome, run_trial};
use super::trial_id::Trial;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread;

/// Runs trials on `jobs` threads, and calls `each` for each finished trial. The outcome of a trial
/// depends on the trial alone; the result is in the order of the trials.
pub fn run(
    setup: &ExperimentSetup,
    trials: &[Trial],
    jobs: usize,
    mut each: impl FnMut(&TrialOutcome),
) -> Vec<TrialOutcome> {
    let next = AtomicUsize::new(0);
    let (sender, finished) = mpsc::channel();
    thread::scope(|scope| {
        for _ in 0..jobs.clamp(1, trials.len().max(1)) {
            let (sender, next) = (sender.clone(), &next);
            scope.spawn(move || {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    let Some(trial) = trials.get(number) else { return };
                    if sender.send((number, run_trial(setup, trial))).is_err() {
                        return;
                    }
                }
            });
        }
        drop(sender);
        let mut all: Vec<(usize, TrialOutcome)> = finished.iter().inspect(|(_, outcome)| each(outcome)).collect();
        all.sort_by_key(|(number, _)| *number);
        all.into_iter().map(|(_, outcome)| outcome).collect()
    })
}
