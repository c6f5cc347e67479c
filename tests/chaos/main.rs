//! Fleets under generated faults: that everything holds, that one seed is one run, and that mistakes are found.
//!
//! A debug build runs a handful of fleets. `cargo test --release -p consort-tests --test chaos` runs hundreds, and looks
//! for every mutant; the check of the project does both.

mod mistakes;
mod seeds;

use consort_protocol::mutants::{Mutant, choose};
use consort_tests::chaos::{Many, Order, Outcome, Schedule};
use std::thread;

/// Whether there is time for many runs.
const OPTIMISED: bool = !cfg!(debug_assertions);

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
