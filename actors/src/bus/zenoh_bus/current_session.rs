//! The session of now: who uses it finds it here, and who finds it useless has it replaced.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError, RwLock};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use zenoh::Session;
use zenoh::session::ZenohId;

/// Where the session of now is found. The session closes when this is dropped.
pub(super) struct CurrentSession {
    session: RwLock<Session>,
    /// Which session is to be opened anew.
    stale: UnboundedSender<ZenohId>,
    /// How many sessions were opened for the sake of a neighbour that was not heard yet, by its address: its id changes with
    /// its own sessions.
    in_vain: Mutex<BTreeMap<String, u32>>,
}

impl CurrentSession {
    /// Begins with a session; whoever has the other half opens anew those whose ids arrive there.
    pub(super) fn new(session: Session) -> (CurrentSession, UnboundedReceiver<ZenohId>) {
        let (stale, asked) = unbounded_channel();
        (CurrentSession { session: RwLock::new(session), stale, in_vain: Mutex::default() }, asked)
    }

    /// The session of now. After it was closed everything that is attempted fails.
    pub(super) fn session(&self) -> Session {
        self.session.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// From now on there is another session.
    pub(super) fn set(&self, session: Session) {
        *self.session.write().unwrap_or_else(PoisonError::into_inner) = session;
    }

    /// Has a session replaced, if it is still that of now.
    pub(super) fn request_replacement(&self, stale: ZenohId) {
        // Otherwise there is nobody any more for whom to open one.
        let _ = self.stale.send(stale);
    }

    /// Counts one more session for the sake of a neighbour; returns how many there were.
    pub(super) fn count_attempt(&self, neighbour: &str) -> u32 {
        let mut in_vain = self.in_vain.lock().unwrap_or_else(PoisonError::into_inner);
        let count = in_vain.entry(neighbour.to_owned()).or_default();
        *count += 1;
        *count
    }

    /// A neighbour is heard, and hears.
    pub(super) fn reset_attempts(&self, neighbour: &str) {
        self.in_vain.lock().unwrap_or_else(PoisonError::into_inner).remove(neighbour);
    }
}
