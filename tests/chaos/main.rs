//! Fleets under generated faults: that everything holds, that one seed is one run, and that mistakes are found.
//!
//! Hundreds of fleets, on all cores: some minutes on two. `consort chaos` runs as many as there is time for.

mod injected_bugs;
mod seeds;

use consort_protocol::mutants::{Mutant, activate};
use consort_tests::chaos::{RunConfig, RunOutcome, Schedule, SeedSweep};
use std::thread;

fn jobs() -> usize {
    thread::available_parallelism().map_or(1, Into::into)
}

/// One run, perhaps of a fleet that makes a mistake.
fn once(order: &RunConfig, schedule: &Schedule, mutant: Option<Mutant>) -> RunOutcome {
    let again = (order.clone(), schedule.clone());
    let mut outcome = None;
    SeedSweep {
        seeds: order.seed..=order.seed,
        jobs: 1,
        config: &move |_| again.clone(),
        prepare: &|| activate(mutant).expect("tests are built with mutants"),
    }
    .run(|told| outcome = Some(told.clone()));
    outcome.expect("a run has an outcome")
}
