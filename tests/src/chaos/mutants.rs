//! Whether chaos finds what it should: deliberate mistakes, one at a time, under the same generated faults as ever.

use super::cast::Cast;
use super::generate::generate;
use super::many::Many;
use super::run::Order;
use super::schedule::Kind;
use consort_protocol::mutants::{self, Mutant, NotBuilt};
use serde::Serialize;

/// How a mistake is looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hunt {
    /// Which.
    pub mutant: Mutant,
    /// Within how many seeds, from 1 on, it must be found.
    pub within: u64,
}

/// Simulated minutes of each run of a hunt.
pub const MINUTES: f64 = 3.0;

/// Nodes of a hunted fleet.
pub const NODES: usize = 7;

/// All mistakes, each with the number of seeds within which it must be found: about three times what was
/// measured. The one at 90 takes a client whose acknowledgement is lost and which asks again under the same name.
pub const HUNTS: [Hunt; Mutant::ALL.len()] = [
    Hunt { mutant: Mutant::SkipFsync, within: 20 },
    Hunt { mutant: Mutant::DoubleVote, within: 20 },
    Hunt { mutant: Mutant::DeafLeader, within: 3 },
    Hunt { mutant: Mutant::IgnoreEpoch, within: 30 },
    Hunt { mutant: Mutant::LeaseNotChecked, within: 30 },
    Hunt { mutant: Mutant::EarlyRelease, within: 30 },
    Hunt { mutant: Mutant::RefusedApplied, within: 30 },
    Hunt { mutant: Mutant::UncommittedReport, within: 3 },
    Hunt { mutant: Mutant::RequestForgotten, within: 90 },
    Hunt { mutant: Mutant::LostRelay, within: 3 },
    Hunt { mutant: Mutant::WaitSkipped, within: 3 },
    Hunt { mutant: Mutant::GuardSkipped, within: 3 },
    Hunt { mutant: Mutant::TwoRemoved, within: 6 },
];

/// What came of a hunt.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Hunted {
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
pub fn hunt(hunt: Hunt, jobs: usize, mut each: impl FnMut()) -> Result<Hunted, NotBuilt> {
    mutants::choose(Some(hunt.mutant))?;
    mutants::choose(None)?;
    let cast = Cast::of(NODES);
    let order = |seed| {
        (Order { seed, nodes: NODES, minutes: MINUTES, closed: false }, generate(seed, &cast, MINUTES, &Kind::FAULTS))
    };
    let choose = |mutant| mutants::choose(mutant).expect("it could be chosen a moment ago");
    let mut first = 1;
    let found = loop {
        let mistaken = Many { seeds: first..=hunt.within, jobs, order: &order, prepare: &|| choose(Some(hunt.mutant)) };
        let Some(found) = mistaken.run(|_| each()) else { break None };
        let seeds = found.seed..=found.seed;
        let sound = Many { seeds, jobs: 1, order: &order, prepare: &|| choose(None) }.run(|_| each()).is_none();
        if sound {
            break Some(found);
        }
        first = found.seed + 1;
        if first > hunt.within {
            break None;
        }
    };
    let violation = found.as_ref().and_then(|outcome| outcome.violation.clone());
    Ok(Hunted {
        mutant: hunt.mutant.name(),
        within: hunt.within,
        seeds: found.map(|outcome| outcome.seed),
        invariant: violation.as_ref().map(|violation| violation.invariant.clone()),
        why: violation.map(|violation| violation.why),
    })
}
