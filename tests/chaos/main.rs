//! Fleets under generated faults: that everything holds, that one seed is one run, and that mistakes are found.
//!
//! Hundreds of fleets, on all cores: some minutes on two. `consort chaos` runs as many as there is time for.

mod mistakes;
mod seeds;

use consort_protocol::mutants::{Mutant, choose};
use consort_tests::chaos::{Many, Order, Outcome, Schedule};
use std::thread;

fn jobs() -> usize {
    thread::available_parallelism().map_or(1, Into::into)
}

/// One run, perhaps of a fleet that makes a mistake.
fn once(order: &Order, schedule: &Schedule, mutant: Option<Mutant>) -> Outcome {
    let again = (order.clone(), schedule.clone());
    let mut outcome = None;
    Many {
        seeds: order.seed..=order.seed,
        jobs: 1,
        order: &move |_| again.clone(),
        prepare: &|| choose(mutant).expect("tests are built with mutants"),
    }
    .run(|told| outcome = Some(told.clone()));
    outcome.expect("a run has an outcome")
}
