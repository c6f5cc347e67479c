//! Ledger of a run, for bugs that depend on it.

use crate::chaos::invariants::ReferenceLedger;
use consort_fleet::observe::Observer;
use consort_protocol::event::Event;
use consort_protocol::ids::NodeId;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, Ledger};
use std::sync::{Arc, Mutex, PoisonError};

/// Ledger of the run as known to the injected bugs. Clones share the ledger.
#[derive(Clone, Default)]
pub(super) struct KnownLedger(Arc<Mutex<ReferenceLedger>>);

impl KnownLedger {
    pub(super) fn read<R>(&self, inspect: impl FnOnce(&Ledger) -> R) -> R {
        inspect(&self.0.lock().unwrap_or_else(PoisonError::into_inner).ledger)
    }
}

impl Observer for KnownLedger {
    fn on_event(&self, _: &Event) {}

    fn on_applied(&self, _: &NodeId, at: Epoch, commands: &[Command]) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).apply(at, commands);
    }
}
