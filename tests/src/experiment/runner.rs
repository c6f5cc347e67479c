//! Many trials on all cores.

use super::setup::ExperimentSetup;
use super::trial::{TrialOutcome, run_trial};
use consort_sim::experiment::policy::Policy;
use consort_sim::experiment::results::Treatment;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread;

/// One trial, named.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Trial {
    /// Which of the stage's scenarios.
    pub scenario: usize,
    /// By which rule.
    pub policy: Policy,
    /// What is done to the fleet.
    pub treatment: Treatment,
    /// Counted from 1.
    pub repetition: u32,
}

/// All trials of a design, in the order in which their rows are written: by scenario, policy, treatment, repetition.
pub fn trials(stage: &ExperimentSetup) -> Vec<Trial> {
    let design = &stage.design;
    let mut trials = vec![];
    for scenario in 0..stage.scenarios.len() {
        for policy in &design.policies {
            for treatment in &design.treatments {
                trials.extend((1..=design.repetitions).map(|repetition| Trial {
                    scenario,
                    policy: *policy,
                    treatment: *treatment,
                    repetition,
                }));
            }
        }
    }
    trials
}

/// Carries trials out on so many threads, and tells of each as it ends. What comes of a trial depends on the trial alone, and
/// the answer is in the order of the trials.
pub fn run(
    stage: &ExperimentSetup,
    trials: &[Trial],
    jobs: usize,
    mut each: impl FnMut(&TrialOutcome),
) -> Vec<TrialOutcome> {
    let next = AtomicUsize::new(0);
    let (tell, outcomes) = mpsc::channel();
    thread::scope(|scope| {
        for _ in 0..jobs.clamp(1, trials.len().max(1)) {
            let (tell, next) = (tell.clone(), &next);
            scope.spawn(move || {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    let Some(trial) = trials.get(number) else { return };
                    if tell.send((number, run_trial(stage, trial))).is_err() {
                        return;
                    }
                }
            });
        }
        drop(tell);
        let mut all: Vec<(usize, TrialOutcome)> = outcomes.iter().inspect(|(_, outcome)| each(outcome)).collect();
        all.sort_by_key(|(number, _)| *number);
        all.into_iter().map(|(_, outcome)| outcome).collect()
    })
}
