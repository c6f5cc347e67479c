//! The confirmed time of day of a session, which its parts and the handlers of reports share.

use super::voter_clocks::VoterClocks;
use consort_bus::clock::Clock;
use consort_protocol::ids::NodeId;
use consort_protocol::ledger::Ledger;
use consort_raft::Replica;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The time of day that a majority of the voters confirms.
#[derive(Clone)]
pub(super) struct ConfirmedTime {
    clocks: Arc<Mutex<VoterClocks>>,
    node: NodeId,
    clock: Clock,
    replica: Replica<Ledger>,
}

impl ConfirmedTime {
    /// Creates the time of a session of this node, which is unknown until the clocks of the voters have been read.
    pub(super) fn new(node: NodeId, clock: Clock, replica: Replica<Ledger>) -> ConfirmedTime {
        ConfirmedTime { clocks: Arc::default(), node, clock, replica }
    }

    /// Locks the readings of the clocks.
    pub(super) fn clocks(&self) -> MutexGuard<'_, VoterClocks> {
        // A panic under the lock leaves no partial reading.
        self.clocks.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the time of day, in milliseconds since 1970; `None` if it is unknown.
    pub(super) fn now_ms(&self) -> Option<u64> {
        let voters = self.replica.leadership().borrow().voters.values().cloned().collect();
        self.clocks().confirmed_ms(&voters, &self.node, self.clock.wall_ms(), self.clock.now())
    }
}
