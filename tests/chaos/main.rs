//! Fleets under generated faults: invariants hold, a seed determines a run, and injected bugs are
//! found.
//!
//! These tests run hundreds of fleets on all cores, for some minutes on two cores.
//! `consort-lab chaos` runs as many as time permits.

mod injected_bugs;
mod seeds;
mod shift;

use consort_tests::chaos::{RunConfig, RunOutcome, Schedule, SeedSweep};
use std::thread;

/// Virtual fleets allocate many small messages.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn jobs() -> usize {
    thread::available_parallelism().map_or(1, Into::into)
}

/// Executes a single run.
fn once(order: &RunConfig, schedule: &Schedule) -> RunOutcome {
    let again = (order.clone(), schedule.clone());
    let mut outcome = None;
    SeedSweep { seeds: order.seed..=order.seed, jobs: 1, config: &move |_| again.clone() }
        .run(|told| outcome = Some(told.clone()));
    outcome.expect("a run has an outcome")
}
