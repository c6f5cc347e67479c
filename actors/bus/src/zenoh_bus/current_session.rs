//! The session in use, shared by its users, and requests to replace it.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError, RwLock};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use zenoh::Session;
use zenoh::session::ZenohId;

/// Holder of the session in use. The session closes when the holder is dropped.
pub(super) struct CurrentSession {
    session: RwLock<Session>,
    /// Sends the id of a session to replace.
    stale: UnboundedSender<ZenohId>,
    /// Number of sessions opened for a neighbour without a passed link check, by the neighbour's
    /// address. The address is the key because the neighbour's id changes with its own sessions.
    attempts: Mutex<BTreeMap<String, u32>>,
}

impl CurrentSession {
    /// Creates the holder. The returned receiver yields the ids of sessions to replace; its owner
    /// reopens them.
    pub(super) fn new(session: Session) -> (CurrentSession, UnboundedReceiver<ZenohId>) {
        let (stale, requests) = unbounded_channel();
        (CurrentSession { session: RwLock::new(session), stale, attempts: Mutex::default() }, requests)
    }

    /// Returns the session in use. Every operation on a closed session fails.
    pub(super) fn session(&self) -> Session {
        self.session.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Replaces the session in use.
    pub(super) fn set(&self, session: Session) {
        *self.session.write().unwrap_or_else(PoisonError::into_inner) = session;
    }

    /// Requests the replacement of a session. The request is ignored if another session is in use
    /// by then.
    pub(super) fn request_replacement(&self, stale: ZenohId) {
        // The send fails only after the bus has been dropped.
        let _ = self.stale.send(stale);
    }

    /// Counts a further session opened for a neighbour, and returns the total.
    pub(super) fn count_attempt(&self, address: &str) -> u32 {
        let mut attempts = self.attempts.lock().unwrap_or_else(PoisonError::into_inner);
        let count = attempts.entry(address.to_owned()).or_default();
        *count += 1;
        *count
    }

    /// Clears the count for a neighbour after a passed link check.
    pub(super) fn reset_attempts(&self, address: &str) {
        self.attempts.lock().unwrap_or_else(PoisonError::into_inner).remove(address);
    }
}
