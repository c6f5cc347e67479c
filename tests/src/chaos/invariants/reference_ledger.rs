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
    /// Ended missions are not dropped: the limits of the history are ignored.
    keeps_all: bool,
}

impl ReferenceLedger {
    /// Creates a ledger that keeps ended missions, whatever the limits of the history are.
    pub(super) fn keeping_all() -> ReferenceLedger {
        ReferenceLedger { keeps_all: true, ..ReferenceLedger::default() }
    }

    /// Applies new entries. [`committed`](super::committed) checks that the entries agree between
    /// nodes.
    pub(super) fn observe(&mut self, entry: &Observation) {
        if let Observation::EntryApplied { at, commands, .. } = entry {
            self.apply(*at, commands);
        }
    }

    /// Checks that the entry at `at` was not applied before.
    pub(super) fn is_new(&self, at: Epoch) -> bool {
        at.index > self.index
    }

    /// Applies the entry at `at`, unless it was applied before.
    pub(in crate::chaos) fn apply(&mut self, at: Epoch, commands: &[Command]) {
        if self.is_new(at) {
            self.index = at.index;
            for command in commands {
                self.apply_command(at, command);
            }
        }
    }

    /// Applies a command of the entry at `at`.
    pub(super) fn apply_command(&mut self, at: Epoch, command: &Command) {
        if !(self.keeps_all && matches!(command, Command::SetHistoryLimits(_))) {
            self.ledger.apply(at, command.clone());
        }
    }
}
