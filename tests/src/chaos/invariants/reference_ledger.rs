//! Reference ledger, computed from the log alone.

use crate::Observation;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, Ledger};

/// Ledger that applies each committed entry as soon as any node does, and never restarts.
#[derive(Default)]
pub(in crate::chaos) struct ReferenceLedger {
    pub(in crate::chaos) ledger: Ledger,
    /// Index of the last applied entry.
    pub(super) index: u64,
}

impl ReferenceLedger {
    /// Applies new entries. [`committed`](super::committed) checks that the entries agree between
    /// nodes.
    pub(super) fn observe(&mut self, entry: &Observation) {
        if let Observation::EntryApplied { at, commands, .. } = entry {
            self.apply(*at, commands);
        }
    }

    /// Applies the entry at `at`, unless it was applied before.
    pub(in crate::chaos) fn apply(&mut self, at: Epoch, commands: &[Command]) {
        if at.index > self.index {
            self.index = at.index;
            for command in commands {
                self.ledger.apply(at, command.clone());
            }
        }
    }
}
