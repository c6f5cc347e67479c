//! Shifts with all policies.

use consort_evaluation::shift::{ShiftFigures, ShiftMetrics, ShiftPolicy};
use consort_tests::shift::{ShiftSetup, requests_per_hour, run};

/// Returns the figures without the duration of the run.
fn repeatable(setup: ShiftSetup) -> ShiftFigures {
    let figures = run(setup, |_| ());
    ShiftFigures { metrics: ShiftMetrics { wall_s: 0.0, ..figures.metrics }, ..figures }
}

#[test]
fn all_policies_complete_the_same_shift() {
    let [instantaneous, tessi, consort, oracle] = ShiftPolicy::ALL.map(|policy| {
        let figures = repeatable(ShiftSetup { robots: 3, missions: 6, policy, ..ShiftSetup::default() });
        assert_eq!((figures.missions, figures.completed), (6, 6), "{policy:?}");
        let metrics = figures.metrics;
        assert!(metrics.distance_m > 100.0 && metrics.energy > 0.0, "{policy:?}: {metrics:?}");
        assert!(metrics.waiting_s < metrics.completion_s, "{policy:?}: {metrics:?}");
        metrics
    });
    // The others promise the only arm, so the three carriers work at the same time.
    for metrics in [tessi, consort, oracle] {
        assert!(metrics.completion_s < instantaneous.completion_s / 2.0, "{metrics:?}\n{instantaneous:?}");
        assert!(metrics.per_hour > instantaneous.per_hour * 2.5, "{metrics:?}\n{instantaneous:?}");
    }
}

/// With 48 missions it is ten times the throughput (`docs/evaluation.md`).
#[test]
fn promises_of_the_only_arm_raise_the_throughput_five_times() {
    let [without, with] = [ShiftPolicy::Instantaneous, ShiftPolicy::Consort].map(|policy| {
        let setup = ShiftSetup { missions: 12, world_speed: 10.0, policy, ..ShiftSetup::default() };
        let figures = repeatable(setup);
        assert_eq!(figures.completed, setup.missions, "{figures:?}");
        figures.metrics
    });
    assert!(with.per_hour >= without.per_hour * 5.0, "{with:?}\n{without:?}");
}

#[test]
fn a_seed_determines_a_shift() {
    for policy in [ShiftPolicy::Tessi, ShiftPolicy::Oracle] {
        let setup = ShiftSetup { robots: 2, missions: 3, per_hour: Some(120.0), policy, ..ShiftSetup::default() };
        assert_eq!(repeatable(setup), repeatable(setup));
        assert_ne!(repeatable(setup), repeatable(ShiftSetup { seed: 2, ..setup }));
    }
}

/// Two hours, in which the carriers need more charge than they have.
#[test]
fn carriers_that_charge_by_themselves_are_not_stranded() {
    let (robots, chargers, hours) = (5, 2, 2.0);
    let per_hour = requests_per_hour(robots, chargers, 0.7);
    let missions = (per_hour * hours) as usize;
    let setup =
        ShiftSetup { robots, chargers, missions, per_hour: Some(per_hour), world_speed: 10.0, ..ShiftSetup::default() };
    let figures = run(setup, |_| ());
    assert!(figures.metrics.energy > robots as f64, "{figures:?}");
    assert_eq!((figures.stranded, figures.completed), (0, missions), "{figures:?}");
}
