//! Invariants: conditions that hold at every step under all faults. Each has its own file.
//!
//! An invariant receives everything that happens, in order, and reads the state of the fleet at
//! that instant. It stores only the state that it needs to check the next step.

mod acknowledged;
mod active_goals;
mod alarm;
mod alive;
mod audited;
mod authority;
mod bounded;
mod canceled;
mod charged;
mod closed;
mod committed;
mod custody;
mod deadlines;
mod guarded;
mod held;
mod informed;
mod limited;
mod obeyed;
mod occurrences;
mod one_holder;
mod one_leader;
mod one_per_charger;
mod pinned;
mod promised;
mod reference_ledger;
mod replayed;
mod revoked;
mod settled;
mod signals;
mod single_voter_change;
#[cfg(test)]
pub(super) mod test_missions;
mod under_lease;
mod under_orders;

pub(super) use occurrences::all_handled;
pub(super) use reference_ledger::ReferenceLedger;

use super::person_action::CancelSelection;
use crate::{Fleet, Observation};
use consort_world::world::LoggedEvent;
use std::collections::BTreeMap;
use std::time::Duration;

/// Description of the violation of an invariant.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct InvariantViolation(pub String);

impl From<String> for InvariantViolation {
    fn from(description: String) -> InvariantViolation {
        InvariantViolation(description)
    }
}

/// A condition that must hold.
pub(crate) trait Invariant {
    /// Returns its name, which is that of its file.
    fn name(&self) -> &'static str;

    /// Checks an entry of the event log.
    ///
    /// # Errors
    /// The violation.
    fn observe(&mut self, at: Duration, entry: &Observation, fleet: &Fleet) -> Result<(), InvariantViolation>;

    /// Checks an event of the world.
    ///
    /// # Errors
    /// Same as [`observe`](Invariant::observe).
    fn observe_world(&mut self, _at: Duration, _entry: &LoggedEvent, _fleet: &Fleet) -> Result<(), InvariantViolation> {
        Ok(())
    }

    /// Checks the state of the fleet at an instant: after every event, and at least every 20 ms.
    ///
    /// # Errors
    /// Same as [`observe`](Invariant::observe).
    fn check_state(&mut self, _at: Duration, _fleet: &Fleet) -> Result<(), InvariantViolation> {
        Ok(())
    }

    /// Checks the final state: all missions have ended and all nodes run.
    ///
    /// # Errors
    /// Same as [`observe`](Invariant::observe).
    fn check_end(&mut self, _fleet: &Fleet) -> Result<(), InvariantViolation> {
        Ok(())
    }
}

/// Returns all invariants of a fleet that keeps `ended_missions_max` ended missions whole, with leases of this duration.
/// `cancelations` are the missions that people cancel at once, by the names of these people.
pub(in crate::chaos) fn all(
    ended_missions_max: usize,
    lease: Duration,
    cancelations: BTreeMap<String, CancelSelection>,
) -> Vec<Box<dyn Invariant>> {
    vec![
        Box::new(alive::Alive),
        Box::<authority::Authority>::default(),
        Box::<one_leader::OneLeader>::default(),
        Box::<committed::Committed>::default(),
        Box::<acknowledged::Acknowledged>::default(),
        Box::new(bounded::Bounded::new(ended_missions_max)),
        Box::<one_holder::OneHolder>::default(),
        Box::<under_lease::UnderLease>::default(),
        Box::<settled::Settled>::default(),
        Box::<signals::Signals>::default(),
        Box::<custody::Custody>::default(),
        Box::<deadlines::Deadlines>::default(),
        Box::<guarded::Guarded>::default(),
        Box::<single_voter_change::SingleVoterChange>::default(),
        Box::<occurrences::Occurrences>::default(),
        Box::new(held::Held::new(lease)),
        Box::new(closed::Closed::new(lease)),
        Box::new(limited::Limited::new(lease)),
        Box::new(alarm::UnderAlarm::new(lease)),
        Box::<under_orders::UnderOrders>::default(),
        Box::<audited::Audited>::default(),
        Box::new(canceled::Canceled::new(cancelations)),
        Box::<pinned::Pinned>::default(),
        Box::<one_per_charger::OnePerCharger>::default(),
        Box::<charged::Charged>::default(),
        Box::<promised::Promised>::default(),
        Box::<replayed::Replayed>::default(),
        Box::<revoked::Revoked>::default(),
    ]
}
