//! Every order of a person, to robots or as a closure, is in the audit trail exactly once.
//!
//! An acknowledged order is in the log, no order is executed twice, and at the end the trail of the coordinator has an
//! entry for each order that has changed anything. Each order is given by another person.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{AuditAction, Command, Ledger};
use std::collections::BTreeMap;
use std::time::Duration;

#[derive(Default)]
pub(super) struct Audited {
    reference: ReferenceLedger,
    /// How often the order of each person has changed the orders to robots, or the closures.
    changes: BTreeMap<String, usize>,
}

/// Returns the person as named in the request; the coordinator of a closed fleet adds the signer.
fn person(by: &str) -> &str {
    by.split(", according to ").next().unwrap_or(by)
}

impl Audited {
    fn apply(&mut self, at: Epoch, commands: &[Command]) -> Result<(), InvariantViolation> {
        if !self.reference.is_new(at) {
            return Ok(());
        }
        for command in commands {
            let before = self.changed();
            self.reference.apply_command(at, command);
            let by = match command {
                Command::OrderRobots { order, .. } => &order.by,
                Command::ChangeClosures { order, .. } => &order.by,
                _ => continue,
            };
            let has_changed = self.changed() != before;
            let changes = self.changes.entry(person(by).to_owned()).or_default();
            *changes += usize::from(has_changed);
            if *changes > 1 {
                return Err(format!("the order of {by} was executed twice").into());
            }
        }
        self.reference.index = at.index;
        Ok(())
    }

    /// Returns the orders to all robots and the closures, as text.
    fn changed(&self) -> String {
        let ledger = &self.reference.ledger;
        format!("{:?}", (ledger.robot_orders().collect::<Vec<_>>(), ledger.closures().collect::<Vec<_>>()))
    }

    fn acknowledge(&self, by: &str) -> Result<(), InvariantViolation> {
        match self.changes.contains_key(by) {
            true => Ok(()),
            false => Err(format!("the order of {by} was acknowledged, but no ledger contains it").into()),
        }
    }

    fn check_trail(&self, ledger: &Ledger) -> Result<(), InvariantViolation> {
        let mut entries: BTreeMap<&str, usize> = BTreeMap::new();
        for entry in ledger.audit_trail().filter(|entry| is_order(entry.action)) {
            *entries.entry(person(&entry.by)).or_default() += 1;
        }
        let all = self.changes.keys().map(String::as_str).chain(entries.keys().copied());
        for by in all {
            let (found, expected) = (entries.get(by).copied(), self.changes.get(by).copied());
            let (found, expected) = (found.unwrap_or_default(), expected.unwrap_or_default());
            if found != expected {
                let reason = format!("the audit trail has {found} entries for the order of {by}, not {expected}");
                return Err(reason.into());
            }
        }
        Ok(())
    }
}

fn is_order(action: AuditAction) -> bool {
    matches!(
        action,
        AuditAction::Hold
            | AuditAction::Release
            | AuditAction::BeginMaintenance
            | AuditAction::EndMaintenance
            | AuditAction::Close
            | AuditAction::Open
    )
}

impl Invariant for Audited {
    fn name(&self) -> &'static str {
        "audited"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        match entry {
            Observation::EntryApplied { at, commands, .. } => self.apply(*at, commands),
            Observation::OrderAcknowledged { by, .. } => self.acknowledge(by),
            _ => Ok(()),
        }
    }

    fn check_end(&mut self, fleet: &Fleet) -> Result<(), InvariantViolation> {
        fleet.ledger(|ledger| self.check_trail(ledger)).unwrap_or(Ok(()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slug;
    use consort_protocol::ledger::{ClosureChange, MapPart, OrderChange, OrderRequest};
    use std::collections::BTreeSet;

    fn order(by: &str, at_ms: u64, change: OrderChange) -> Command {
        let order = OrderRequest { change, by: by.to_owned(), at_ms, request: None };
        Command::OrderRobots { robots: BTreeSet::from([slug("garnet")]), order }
    }

    fn hold(by: &str, at_ms: u64) -> Command {
        order(by, at_ms, OrderChange::Hold { until_ms: at_ms + 60_000, reason: String::new() })
    }

    fn close(by: &str, at_ms: u64) -> Command {
        let change = ClosureChange::Close { until_ms: None, reason: String::new() };
        let order = OrderRequest { change, by: by.to_owned(), at_ms, request: None };
        Command::ChangeClosures { parts: BTreeSet::from([MapPart::Place(slug("Ward"))]), order }
    }

    fn applied(commands: Vec<Command>) -> Result<Audited, InvariantViolation> {
        let mut state = Audited::default();
        let commands = [Command::first_wire_version(3)].into_iter().chain(commands);
        for (command, index) in commands.zip(1..) {
            state.apply(Epoch { term: 1, index }, &[command])?;
        }
        Ok(state)
    }

    #[test]
    fn an_order_that_is_lost_or_executed_twice_is_found() {
        let release = order("Abe, according to the dashboard", 3, OrderChange::Release);
        let useless = order("Eve", 4, OrderChange::Release);
        let state = applied(vec![hold("Nia", 1), release, useless, close("Bea", 5)]);
        let state = state.unwrap_or_else(|found| panic!("{found:?}"));
        for by in ["Nia", "Abe", "Eve", "Bea"] {
            assert_eq!(state.acknowledge(by), Ok(()), "{by}");
        }
        let violation = state.acknowledge("Ida").unwrap_err().0;
        assert_eq!(violation, "the order of Ida was acknowledged, but no ledger contains it");
        assert_eq!(state.check_trail(&state.reference.ledger), Ok(()));
        let violation = state.check_trail(&Ledger::default()).unwrap_err().0;
        assert_eq!(violation, "the audit trail has 0 entries for the order of Abe, not 1");
        let violation = applied(vec![hold("Nia", 1), hold("Nia", 2)]).map(|_| ()).unwrap_err().0;
        assert_eq!(violation, "the order of Nia was executed twice");
        let violation = applied(vec![close("Bea", 1), close("Bea", 2)]).map(|_| ()).unwrap_err().0;
        assert_eq!(violation, "the order of Bea was executed twice");
    }
}
