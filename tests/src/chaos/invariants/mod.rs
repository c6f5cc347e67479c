//! What must hold at every step, whatever is done to a fleet: one file each.
//!
//! An invariant is told of everything that happens, in order, and looks at the fleet as it is at that instant. It keeps
//! only what it needs in order to judge the next step.

mod acknowledged;
mod alive;
mod committed;
mod custody;
mod guarded;
mod one_holder;
mod one_leader;
mod reference_ledger;
mod replayed;
mod settled;
mod signals;
mod single_voter_change;
mod under_lease;

use crate::{Fleet, Observation};
use consort_sim::world::LoggedEvent;
use std::time::Duration;

/// Something that must hold.
pub trait Invariant {
    /// Its name, which is that of its file.
    fn name(&self) -> &'static str;

    /// Something has happened.
    ///
    /// # Errors
    /// Why it does not hold any more, in words.
    fn observe(&mut self, at: Duration, entry: &Observation, fleet: &Fleet) -> Result<(), String>;

    /// Something has happened in the world.
    ///
    /// # Errors
    /// As [`see`](Invariant::see).
    fn observe_world(&mut self, _at: Duration, _entry: &LoggedEvent, _fleet: &Fleet) -> Result<(), String> {
        Ok(())
    }

    /// All is over: missions have ended, and everybody runs.
    ///
    /// # Errors
    /// As [`see`](Invariant::see).
    fn check_end(&mut self, _fleet: &Fleet) -> Result<(), String> {
        Ok(())
    }
}

/// All of them.
pub fn all() -> Vec<Box<dyn Invariant>> {
    vec![
        Box::new(alive::Alive),
        Box::<one_leader::OneLeader>::default(),
        Box::<committed::Committed>::default(),
        Box::<acknowledged::Acknowledged>::default(),
        Box::<one_holder::OneHolder>::default(),
        Box::<under_lease::UnderLease>::default(),
        Box::<settled::Settled>::default(),
        Box::<signals::Signals>::default(),
        Box::<custody::Custody>::default(),
        Box::<guarded::Guarded>::default(),
        Box::<single_voter_change::SingleVoterChange>::default(),
        Box::<replayed::Replayed>::default(),
    ]
}
