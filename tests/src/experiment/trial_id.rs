//! Identity of a trial, and the list of trials of a design.

use super::setup::ExperimentSetup;
use consort_evaluation::policy::Policy;
use consort_evaluation::results::Treatment;

/// Identifies a trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Trial {
    /// Index of the scenario in the setup.
    pub scenario: usize,
    /// The allocation policy.
    pub policy: Policy,
    /// The injected fault.
    pub treatment: Treatment,
    /// Number of the repetition, from 1.
    pub repetition: u32,
}

/// Returns all trials of a design, in the order of their rows: by scenario, policy, treatment,
/// repetition.
pub fn trials(setup: &ExperimentSetup) -> Vec<Trial> {
    let design = &setup.design;
    let mut trials = vec![];
    for scenario in 0..setup.scenarios.len() {
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
