//! The ledger as the log alone gives it, kept by the judge.

use crate::Observation;
use consort_protocol::ledger::Ledger;
use consort_protocol::mutants;

/// A ledger that takes in each committed entry as soon as any node has, and is never restarted.
#[derive(Default)]
pub(super) struct ReferenceLedger {
    pub(super) ledger: Ledger,
    /// The last entry that it has taken in.
    pub(super) index: u64,
}

impl ReferenceLedger {
    /// Takes in what is new to it. That entries agree from node to node is seen to by [`committed`](super::committed).
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
