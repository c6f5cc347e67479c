//! The checks: one injected bug at a time, which chaos must find under the usual generated faults.

use super::alarms::FIRST_SEED as FIRST_SEED_WITH_ALARMS;
use super::chaos_fleet::ChaosFleet;
use super::closures::FIRST_SEED as FIRST_SEED_WITH_CLOSURES;
use super::control_flow::FIRST_SEED;
use super::fault_kind::FaultKind;
use super::generate::generate;
use super::mutants::Mutant;
use super::orders::FIRST_SEED as FIRST_SEED_WITH_ORDERS;
use super::run::RunConfig;
use super::seed_sweep::SeedSweep;
use consort_skills::workload::Workload;
use serde::Serialize;

/// A mutation check.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MutantCheck {
    /// The injected bug.
    pub mutant: Mutant,
    /// Kinds of generated faults.
    pub faults: &'static [FaultKind],
    /// First seed.
    pub first_seed: u64,
    /// Last seed: chaos must find the bug at this seed or before.
    pub last_seed: u64,
}

impl MutantCheck {
    const fn new(mutant: Mutant, last_seed: u64) -> MutantCheck {
        MutantCheck::under(mutant, &FaultKind::FAULTS, last_seed)
    }

    /// Creates a check with few kinds of faults, which are more frequent then.
    const fn under(mutant: Mutant, faults: &'static [FaultKind], last_seed: u64) -> MutantCheck {
        MutantCheck { mutant, faults, first_seed: 1, last_seed }
    }

    /// Creates a check over `seeds` seeds whose runs may have orders of people and chargers, without faults.
    const fn with_orders(mutant: Mutant, seeds: u64) -> MutantCheck {
        MutantCheck::without_faults(FIRST_SEED_WITH_ORDERS, mutant, seeds)
    }

    /// Creates a check over `seeds` seeds whose runs may also have closures, without faults.
    const fn with_closures(mutant: Mutant, seeds: u64) -> MutantCheck {
        MutantCheck::without_faults(FIRST_SEED_WITH_CLOSURES, mutant, seeds)
    }

    /// Creates a check over `seeds` seeds whose runs may also have alarms and speed limits, without faults.
    const fn with_alarms(mutant: Mutant, seeds: u64) -> MutantCheck {
        MutantCheck::without_faults(FIRST_SEED_WITH_ALARMS, mutant, seeds)
    }

    /// Creates a check over `seeds` seeds from the first on, without faults.
    const fn without_faults(first_seed: u64, mutant: Mutant, seeds: u64) -> MutantCheck {
        MutantCheck { first_seed, ..MutantCheck::under(mutant, &[FaultKind::None], first_seed + seeds - 1) }
    }

    /// Creates a check over `seeds` seeds whose runs may have a schedule and missions with control flow.
    const fn with_schedules(mutant: Mutant, seeds: u64) -> MutantCheck {
        MutantCheck { first_seed: FIRST_SEED, last_seed: FIRST_SEED + seeds - 1, ..MutantCheck::new(mutant, 0) }
    }
}

/// Simulated minutes of each run of a check.
pub(crate) const MINUTES: f64 = 3.0;

/// Nodes of the fleet in a check.
pub(crate) const NODES: usize = 7;

/// All injected bugs with the seeds within which chaos must find each: about three times
/// the measured number. The bug with 90 seeds needs a lost acknowledgement and a client that
/// repeats the request under the same name. Half of the runs with schedules have none, and the numbers for bugs that
/// need orders of people, chargers, closures, alarms, speed limits, promises or revocations are guesses.
pub const MUTANT_CHECKS: [MutantCheck; Mutant::ALL.len()] = [
    MutantCheck::new(Mutant::SkipFsync, 20),
    MutantCheck::new(Mutant::DoubleVote, 20),
    MutantCheck::new(Mutant::NoCheckQuorum, 3),
    MutantCheck::new(Mutant::IgnoreEpoch, 30),
    MutantCheck::new(Mutant::LeaseNotChecked, 30),
    MutantCheck::new(Mutant::EarlyRelease, 30),
    MutantCheck::new(Mutant::RefusedApplied, 30),
    MutantCheck::new(Mutant::UncommittedReport, 3),
    MutantCheck::new(Mutant::RequestForgotten, 90),
    MutantCheck::new(Mutant::LostRelay, 3),
    MutantCheck::new(Mutant::WaitSkipped, 3),
    MutantCheck::new(Mutant::GuardSkipped, 3),
    MutantCheck::new(Mutant::TwoRemoved, 6),
    MutantCheck::new(Mutant::StaleRead, 30),
    MutantCheck::new(Mutant::SignersUnchecked, 3),
    MutantCheck::new(Mutant::AuthorsUnchecked, 12),
    MutantCheck::under(Mutant::RefusalsUnsigned, &[FaultKind::Hostile], 24),
    MutantCheck::under(Mutant::RecordsUnverified, &[FaultKind::Hostile], 12),
    MutantCheck::under(Mutant::BeaconsBelieved, &[FaultKind::Hostile], 12),
    MutantCheck::under(Mutant::SuspensionNotCounted, &[FaultKind::Suspend], 6),
    MutantCheck::under(Mutant::GraceTooSmall, &[FaultKind::LeaseEnd, FaultKind::Drift], 90),
    MutantCheck::under(Mutant::OwnClock, &[FaultKind::WrongDate], 12),
    MutantCheck::under(Mutant::ReleasedInMotion, &[FaultKind::Leave], 60),
    MutantCheck::new(Mutant::OutcomesForgotten, 3),
    MutantCheck::new(Mutant::HistoryKept, 3),
    MutantCheck::under(Mutant::CircularWaitKept, &[FaultKind::CircularWait], 18),
    MutantCheck::under(Mutant::KeptTooLong, &[FaultKind::LeaseEnd], 39),
    MutantCheck::under(Mutant::IdentityKept, &[FaultKind::StaleMajority], 3),
    MutantCheck::under(Mutant::StoppedWithBus, &[FaultKind::BlockedBus], 15),
    MutantCheck::with_schedules(Mutant::OccurrenceRepeated, 12),
    MutantCheck::with_orders(Mutant::HoldIgnored, 12),
    MutantCheck::with_orders(Mutant::OrderForgotten, 6),
    MutantCheck::with_orders(Mutant::ClaimsHidden, 20),
    MutantCheck::with_closures(Mutant::ClosureIgnored, 15),
    MutantCheck::with_alarms(Mutant::AlarmIgnored, 20),
    MutantCheck::with_alarms(Mutant::LimitIgnored, 15),
    MutantCheck::under(Mutant::HoldersUnfit, &[FaultKind::None], 12),
    MutantCheck::with_orders(Mutant::LeaseIgnored, 20),
    MutantCheck::under(Mutant::RevocationsUnread, &[FaultKind::Revoke], 12),
];

/// Result of a mutation check.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct MutantResult {
    /// The injected bug.
    pub mutant: &'static str,
    /// Last seed at which chaos may find the bug.
    pub last_seed: u64,
    /// Seed at which the bug was found, if it was.
    pub seed: Option<u64>,
    /// The violated invariant.
    pub invariant: Option<String>,
    /// Reason of the violation.
    pub reason: Option<String>,
}

/// Runs a mutation check on `jobs` threads; calls `each` after each run. A violation counts only if
/// everything holds for the same seed without the bug. Otherwise the fleet itself has a bug.
pub fn check_mutant(check: MutantCheck, jobs: usize, mut each: impl FnMut()) -> MutantResult {
    let composition = ChaosFleet::of(NODES);
    let config = |seed, mutant| {
        (
            RunConfig {
                seed,
                nodes: NODES,
                minutes: MINUTES,
                closed: check.mutant.needs_closed_fleet(),
                mutant,
                workload: Workload::default(),
            },
            generate(seed, &composition, MINUTES, check.faults),
        )
    };
    let mut first = check.first_seed;
    let found = loop {
        let mutated =
            SeedSweep { seeds: first..=check.last_seed, jobs, config: &|seed| config(seed, Some(check.mutant)) };
        let Some(found) = mutated.run(|_| each()) else { break None };
        let seeds = found.seed..=found.seed;
        let holds_without_mutant =
            SeedSweep { seeds, jobs: 1, config: &|seed| config(seed, None) }.run(|_| each()).is_none();
        if holds_without_mutant {
            break Some(found);
        }
        first = found.seed + 1;
        if first > check.last_seed {
            break None;
        }
    };
    let violation = found.as_ref().and_then(|outcome| outcome.violation.clone());
    MutantResult {
        mutant: check.mutant.name(),
        last_seed: check.last_seed,
        seed: found.map(|outcome| outcome.seed),
        invariant: violation.as_ref().map(|violation| violation.invariant.clone()),
        reason: violation.map(|violation| violation.reason),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_some_checks_have_schedules_and_missions_with_control_flow_or_orders() {
        for check in MUTANT_CHECKS {
            let is_from = |first| check.first_seed == first && check.last_seed >= first;
            let (with_orders, with_schedules) = (is_from(FIRST_SEED_WITH_ORDERS), is_from(FIRST_SEED));
            let without = check.first_seed == 1 && (1..FIRST_SEED).contains(&check.last_seed);
            let is_expected = match check.mutant {
                Mutant::OccurrenceRepeated => with_schedules,
                Mutant::HoldIgnored | Mutant::OrderForgotten | Mutant::ClaimsHidden | Mutant::LeaseIgnored => {
                    with_orders
                }
                Mutant::ClosureIgnored => is_from(FIRST_SEED_WITH_CLOSURES),
                Mutant::AlarmIgnored | Mutant::LimitIgnored => is_from(FIRST_SEED_WITH_ALARMS),
                _ => without,
            };
            assert!(is_expected, "{check:?}");
        }
    }
}
