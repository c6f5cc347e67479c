//! Reference ledger, computed from the log alone.

use crate::Observation;
use consort_protocol::ledger::Ledger;
use consort_protocol::mutants;

/// Ledger that applies each committed entry as soon as any node does, and never restarts.
#[derive(Default)]
pub(super) struct ReferenceLedger {
    pub(super) ledger: Ledger,
    /// Index of the last applied entry.
    pub(super) index: u64,
}

impl ReferenceLedger {
    /// Applies new entries. [`committed`](super::committed) checks that the entries agree between
    /// nodes.
    pub(super) fn observe(&mut self, entry: &Observation) {
        if let Observation::EntryApplied { at, commands, .. } = entry
            && at.index > self.index
        {
            self.index = at.index;
            for command in commands.iter() {
                mutants::without_mutant(|| self.ledger.apply(*at, command.clone()));
            }
        }
    }
}
