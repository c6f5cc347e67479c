//! What the invariants of orders have in common: they compare the goals in progress with the ledger.

use super::active_goals::ActiveGoals;
use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::event::EventKind;
use consort_world::world::LoggedEvent;
use std::time::Duration;

/// An order of people that robots obey within a bound.
pub(super) trait Obeyed {
    /// Name of the invariant.
    const NAME: &'static str;

    /// Returns what the invariant follows.
    fn followed(&mut self) -> (&mut ReferenceLedger, &mut ActiveGoals);

    /// Reads the orders of the ledger, which may have changed at `at`.
    fn update(&mut self, at: Duration);

    /// Checks an event of a node.
    ///
    /// # Errors
    /// The violation.
    fn check_event(&self, _event: &EventKind) -> Result<(), InvariantViolation> {
        Ok(())
    }

    /// Checks the goals in progress.
    ///
    /// # Errors
    /// The violation.
    fn check_goals(&mut self, at: Duration, fleet: &Fleet) -> Result<(), InvariantViolation>;
}

impl<T: Obeyed> Invariant for T {
    fn name(&self) -> &'static str {
        T::NAME
    }

    fn observe(&mut self, at: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        if matches!(entry, Observation::EntryApplied { .. }) {
            self.followed().0.observe(entry);
            self.update(at);
        }
        self.followed().1.observe(at, entry);
        entry.event_kind().map_or(Ok(()), |event| self.check_event(event))
    }

    fn observe_world(&mut self, _: Duration, entry: &LoggedEvent, _: &Fleet) -> Result<(), InvariantViolation> {
        self.followed().1.observe_world(entry);
        Ok(())
    }

    fn check_state(&mut self, at: Duration, fleet: &Fleet) -> Result<(), InvariantViolation> {
        self.check_goals(at, fleet)
    }
}
