//! Invariants hold for the first seeds.

use crate::{jobs, once};
use consort_skills::workload::Workload;
use consort_tests::chaos::{
    ChaosFleet, Coverage, CoverageKind, FIRST_LARGE_SEED, FIRST_SEED_WITH_ALARMS, FIRST_SEED_WITH_SMALL_LIMITS,
    FIRST_SEED_WITH_STOPS, FaultKind, RunConfig, SeedSweep, generate,
};
use std::ops::RangeInclusive;

/// Seeds of open fleets. More seeds find more, and make the check in CI longer; sweeps of thousands of seeds are run
/// with `consort-lab chaos`.
const OPEN_SEEDS: RangeInclusive<u64> = 1..=45;

/// Seeds of closed fleets with all faults. Those from 91 on have schedules, from 121 on orders of people to robots and
/// chargers, and from 151 on closures.
const CLOSED_SEEDS: RangeInclusive<u64> = 1..=FIRST_SEED_WITH_ALARMS - 1;

/// Seeds of closed fleets with all of these, with alarms, speed limits, zones and changes of missions. In most of them
/// robots plan stops at chargers.
const STOP_SEEDS: RangeInclusive<u64> = FIRST_SEED_WITH_STOPS..=FIRST_SEED_WITH_STOPS + 5;

/// Seeds of closed fleets with all of these, and with the settings of a large fleet. The last two have the smallest limits,
/// and in the first of these two a robot is revoked.
const LARGE_SEEDS: RangeInclusive<u64> = FIRST_LARGE_SEED..=FIRST_LARGE_SEED + 3;

/// Seeds with missions that cannot be completed as the only faults.
const POISON_SEEDS: RangeInclusive<u64> = 1..=20;

/// What the limits of all seeds and the faults of open fleets cause, each at least once over many seeds.
const IN_SOME_RUN: [CoverageKind; 8] = [
    CoverageKind::MissionDropped,
    CoverageKind::SnapshotStored,
    CoverageKind::LogPurged,
    CoverageKind::SnapshotInstalled,
    CoverageKind::MissionRefused,
    CoverageKind::NodeLeft,
    CoverageKind::NodeRejoined,
    CoverageKind::FleetUpgraded,
];

/// What the smallest limits cause in every run.
const IN_EVERY_RUN: [CoverageKind; 5] = [
    CoverageKind::MissionDropped,
    CoverageKind::OutcomeForgotten,
    CoverageKind::SnapshotStored,
    CoverageKind::LogPurged,
    CoverageKind::MissionRefused,
];

/// What the runs of some seeds caused.
#[derive(Default)]
struct Sum {
    charging_stops: usize,
    coverage: Coverage,
}

impl Sum {
    /// Asserts that each of these kinds happened at least once.
    fn assert_covers(&self, kinds: &[CoverageKind]) {
        let missing = self.coverage.missing(kinds);
        assert!(missing.is_empty(), "never happened: {missing} (counted: {})", self.coverage);
    }
}

/// Runs these seeds with open or closed fleets and these faults. In every run with the smallest limits, each kind that they
/// cause must happen.
fn everything_holds(seeds: RangeInclusive<u64>, minutes: f64, closed: bool, kinds: &[FaultKind]) -> Sum {
    let order = |seed| RunConfig { seed, nodes: 7, minutes, closed, mutant: None, workload: Workload::default() };
    let composition = ChaosFleet::of(7);
    let (mut missions, mut runs, mut sum, mut uncovered) = (0, 0, Sum::default(), vec![]);
    let found =
        SeedSweep { seeds, jobs: jobs(), config: &|seed| (order(seed), generate(seed, &composition, minutes, kinds)) }
            .run(|outcome| {
                missions += outcome.counters.acknowledged;
                sum.charging_stops += outcome.counters.charging_stops;
                sum.coverage.merge(&outcome.counters.coverage);
                let missing = outcome.counters.coverage.missing(&IN_EVERY_RUN);
                if outcome.seed >= FIRST_SEED_WITH_SMALL_LIMITS && !missing.is_empty() {
                    uncovered.push(format!("seed {}: {missing}", outcome.seed));
                }
                runs += 1;
            });
    if let Some(outcome) = found
        && let Some(violation) = outcome.violation
    {
        let schedule = generate(outcome.seed, &composition, minutes, kinds);
        let events = violation.events_before.join("\n");
        panic!("seed {}: {}: {}\n{events}\n{schedule}", outcome.seed, violation.invariant, violation.reason);
    }
    assert!(missions >= runs, "only {missions} missions were submitted in {runs} runs");
    assert!(uncovered.is_empty(), "never happened in {}", uncovered.join("; "));
    sum
}

#[test]
fn invariants_hold_for_the_first_seeds() {
    everything_holds(OPEN_SEEDS, 3.0, false, &FaultKind::FAULTS).assert_covers(&IN_SOME_RUN);
}

#[test]
fn invariants_hold_in_closed_fleets_with_a_hostile_node() {
    let sum = everything_holds(CLOSED_SEEDS, 2.0, true, &FaultKind::FAULTS);
    sum.assert_covers(&IN_SOME_RUN);
    sum.assert_covers(&[CoverageKind::AttackerRevoked]);
}

#[test]
fn invariants_hold_in_closed_fleets_with_planned_stops_at_chargers() {
    let Sum { charging_stops, .. } = everything_holds(STOP_SEEDS, 2.0, true, &FaultKind::FAULTS);
    assert!(charging_stops >= 3, "{charging_stops}");
}

#[test]
fn invariants_hold_with_the_settings_of_a_large_fleet() {
    let sum = everything_holds(LARGE_SEEDS, 2.0, true, &FaultKind::FAULTS);
    sum.assert_covers(&[CoverageKind::RobotRevoked, CoverageKind::RevokedRoleAwarded, CoverageKind::RepetitionRefused]);
}

#[test]
fn missions_that_cannot_be_completed_disturb_no_others() {
    everything_holds(POISON_SEEDS, 3.0, false, &[FaultKind::Poison]);
}

#[test]
fn a_seed_determines_a_run_to_the_byte() {
    let composition = ChaosFleet::of(5);
    let runs: Vec<_> = (11..=12)
        .map(|seed| {
            let order = RunConfig {
                seed,
                nodes: 5,
                minutes: 1.0,
                closed: seed == 12,
                mutant: None,
                workload: Workload::default(),
            };
            let schedule = generate(seed, &composition, 1.0, &FaultKind::FAULTS);
            let (one, other) = (once(&order, &schedule), once(&order, &schedule));
            assert_eq!(one, other, "seed {seed}");
            assert!(!one.digest.is_empty(), "seed {seed}: {:?}", one.violation);
            one.digest
        })
        .collect();
    assert_ne!(runs[0], runs[1], "another seed is another run");
}
