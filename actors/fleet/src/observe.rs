//! Observers of a node, for tests, simulations and statistics.
//!
//! Observers are called in place, immediately and in order. No bus lies between, so faults between
//! nodes hide nothing from an observer. A node without an observer has no cost.

use consort_protocol::event::Event;
use consort_protocol::ids::NodeId;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Command;
use std::sync::Arc;

/// Receives the events of a node. It is called from within the node's tasks, so it must neither
/// block nor panic.
pub trait Observer: Send + Sync + 'static {
    /// Called for each event that the node emits on its event stream.
    fn on_event(&self, event: &Event);

    /// Called after the node's copy of the ledger has applied the entry at `at`: its commands in
    /// order, or none for an entry of Raft itself. After a restart the entries after the last
    /// snapshot are applied again.
    fn on_applied(&self, node: &NodeId, at: Epoch, commands: &[Command]);
}

/// Observer shared by several nodes.
pub type SharedObserver = Arc<dyn Observer>;

/// Calls each observer in turn.
impl Observer for Vec<SharedObserver> {
    fn on_event(&self, event: &Event) {
        self.iter().for_each(|observer| observer.on_event(event));
    }

    fn on_applied(&self, node: &NodeId, at: Epoch, commands: &[Command]) {
        self.iter().for_each(|observer| observer.on_applied(node, at, commands));
    }
}
