//! Whether chaos finds what it should: deliberate mistakes, one at a time, under the same generated faults as ever.

use super::chaos_fleet::ChaosFleet;
use super::generate::generate;
use super::run::RunConfig;
use super::schedule::FaultKind;
use super::seed_sweep::SeedSweep;
use consort_protocol::mutants::{self, Mutant, MutantsNotBuilt};
use serde::Serialize;

/// How a mistake is looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MutantCheck {
    /// Which.
    pub mutant: Mutant,
    /// Within how many seeds, from 1 on, it must be found.
    pub seeds_max: u64,
}

/// Simulated minutes of each run of a hunt.
pub const MINUTES: f64 = 3.0;

/// Nodes of a hunted fleet.
pub const NODES: usize = 7;

/// All mistakes, each with the number of seeds within which it must be found: about three times what was
/// measured. The one at 90 takes a client whose acknowledgement is lost and which asks again under the same name.
pub const MUTANT_CHECKS: [MutantCheck; Mutant::ALL.len()] = [
    MutantCheck { mutant: Mutant::SkipFsync, seeds_max: 20 },
    MutantCheck { mutant: Mutant::DoubleVote, seeds_max: 20 },
    MutantCheck { mutant: Mutant::NoCheckQuorum, seeds_max: 3 },
    MutantCheck { mutant: Mutant::IgnoreEpoch, seeds_max: 30 },
    MutantCheck { mutant: Mutant::LeaseNotChecked, seeds_max: 30 },
    MutantCheck { mutant: Mutant::EarlyRelease, seeds_max: 30 },
    MutantCheck { mutant: Mutant::RefusedApplied, seeds_max: 30 },
    MutantCheck { mutant: Mutant::UncommittedReport, seeds_max: 3 },
    MutantCheck { mutant: Mutant::RequestForgotten, seeds_max: 90 },
    MutantCheck { mutant: Mutant::LostRelay, seeds_max: 3 },
    MutantCheck { mutant: Mutant::WaitSkipped, seeds_max: 3 },
    MutantCheck { mutant: Mutant::GuardSkipped, seeds_max: 3 },
    MutantCheck { mutant: Mutant::TwoRemoved, seeds_max: 6 },
];

/// What came of a hunt.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct MutantResult {
    /// The mistake.
    pub mutant: &'static str,
    /// Within how many seeds it must be found.
    pub within: u64,
    /// How many it took, if it was.
    pub seeds: Option<u64>,
    /// By which invariant.
    pub invariant: Option<String>,
    /// What was wrong, in words.
    pub why: Option<String>,
}

/// Looks for a mistake on so many threads; `each` is called after each run. A violation counts only if everything holds
/// for the same seed without the mistake: else it is the fleet's own.
///
/// # Errors
/// [`NotBuilt`]; nothing was run.
pub fn check_mutant(hunt: MutantCheck, jobs: usize, mut each: impl FnMut()) -> Result<MutantResult, MutantsNotBuilt> {
    mutants::activate(Some(hunt.mutant))?;
    mutants::activate(None)?;
    let cast = ChaosFleet::of(NODES);
    let order = |seed| {
        (
            RunConfig { seed, nodes: NODES, minutes: MINUTES, closed: false },
            generate(seed, &cast, MINUTES, &FaultKind::FAULTS),
        )
    };
    let choose = |mutant| mutants::activate(mutant).expect("it could be chosen a moment ago");
    let mut first = 1;
    let found = loop {
        let mistaken =
            SeedSweep { seeds: first..=hunt.seeds_max, jobs, config: &order, prepare: &|| choose(Some(hunt.mutant)) };
        let Some(found) = mistaken.run(|_| each()) else { break None };
        let seeds = found.seed..=found.seed;
        let sound = SeedSweep { seeds, jobs: 1, config: &order, prepare: &|| choose(None) }.run(|_| each()).is_none();
        if sound {
            break Some(found);
        }
        first = found.seed + 1;
        if first > hunt.seeds_max {
            break None;
        }
    };
    let violation = found.as_ref().and_then(|outcome| outcome.violation.clone());
    Ok(MutantResult {
        mutant: hunt.mutant.name(),
        within: hunt.seeds_max,
        seeds: found.map(|outcome| outcome.seed),
        invariant: violation.as_ref().map(|violation| violation.invariant.clone()),
        why: violation.map(|violation| violation.why),
    })
}
