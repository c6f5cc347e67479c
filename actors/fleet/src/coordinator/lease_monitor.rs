//! The leases in force, shared between the session and the handlers of reports.

use consort_protocol::lease::{LeaseMonitor, LeaseTerms};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Leases in force. Reports renew them and the reconciliation ends them, so access is shared.
#[derive(Clone)]
pub(super) struct SharedLeaseMonitor(Arc<Mutex<LeaseMonitor>>);

impl SharedLeaseMonitor {
    pub(super) fn new(terms: LeaseTerms) -> SharedLeaseMonitor {
        SharedLeaseMonitor(Arc::new(Mutex::new(LeaseMonitor::new(terms))))
    }

    /// Locks the leases. A decision and its effect must happen under the same lock.
    pub(super) fn lock(&self) -> MutexGuard<'_, LeaseMonitor> {
        // A panic under the lock leaves no partial write, because each write is a single step.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
