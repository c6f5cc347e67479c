//! A shift under faults.

use consort_evaluation::shift::ShiftMetrics;
use consort_tests::chaos::{FaultyShift, run_shift};
use consort_tests::shift::{ShiftSetup, requests_per_hour};

/// Returns the setup of a shift in which the carriers charge.
fn setup(seed: u64, hours: f64) -> ShiftSetup {
    let (robots, chargers) = (6, 2);
    let per_hour = requests_per_hour(robots, chargers, 0.7);
    let missions = (per_hour * hours) as usize;
    let setup = ShiftSetup { robots, chargers, missions, seed, ..ShiftSetup::default() };
    ShiftSetup { arms: 2, per_hour: Some(per_hour), world_speed: 10.0, ..setup }
}

#[test]
fn invariants_hold_in_a_shift_under_faults() {
    for seed in [1, 2] {
        let setup = setup(seed, 1.0);
        let FaultyShift { figures, faults, violation } = run_shift(&setup);
        if let Some(violation) = violation {
            let events = violation.events_before.join("\n");
            panic!("seed {seed}: {}: {}\n{events}", violation.invariant, violation.reason);
        }
        assert!(faults > 0, "seed {seed}");
        assert!(figures.completed * 10 >= setup.missions * 9, "seed {seed}: {figures:?}");
        assert!(figures.metrics.energy > 0.5 * setup.robots as f64, "seed {seed}: {figures:?}");
    }
}

#[test]
fn a_seed_determines_a_shift_under_faults() {
    let repeatable = |seed| {
        let shift = run_shift(&setup(seed, 0.1));
        let metrics = ShiftMetrics { wall_s: 0.0, ..shift.figures.metrics };
        (metrics, shift.figures.completed, shift.faults)
    };
    assert_eq!(repeatable(3), repeatable(3));
    assert_ne!(repeatable(3), repeatable(4));
}
