//! Chaos finds injected bugs and shrinks their schedules.

use crate::{jobs, once};
use consort_skills::workload::Workload;
use consort_tests::chaos::mutants::Mutant;
use consort_tests::chaos::mutation_checks::{MUTANT_CHECKS, check_mutant};
use consort_tests::chaos::{ChaosAction, ChaosFleet, FaultKind, RunConfig, generate, shrink};

#[test]
fn every_mutant_is_found_within_its_number_of_seeds() {
    let mut missed = vec![];
    for wanted in MUTANT_CHECKS {
        let found = check_mutant(wanted, jobs(), || ());
        if found.seed.is_none() {
            missed.push(found);
        }
    }
    assert!(missed.is_empty(), "not found: {missed:?}");
}

#[test]
fn a_violation_is_shrunk_to_the_necessary_actions() {
    let order = RunConfig {
        seed: 3,
        nodes: 5,
        minutes: 1.0,
        closed: false,
        mutant: Some(Mutant::WaitSkipped),
        workload: Workload::default(),
    };
    let schedule = generate(order.seed, &ChaosFleet::of(5), order.minutes, &FaultKind::FAULTS);
    let fails = |schedule: &_| {
        let violation = once(&order, schedule).violation;
        violation.is_some_and(|violation| violation.invariant == "signals")
    };
    assert!(fails(&schedule), "{schedule}");
    let smallest = shrink(&schedule, 60, fails);
    // A single mission suffices to pass a wait too early.
    assert!(matches!(&smallest.steps[..], [step] if matches!(step.action, ChaosAction::Submit { .. })), "{smallest}");
}
