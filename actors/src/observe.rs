//! Somebody who looks over a node's shoulder: a test, a simulation, a tool that keeps statistics.
//!
//! What is told here is told in place, at once and in order, by no bus: faults between nodes hide nothing. A node without
//! an observer pays nothing for it.

use consort_protocol::event::Event;
use consort_protocol::ids::NodeId;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::Command;
use std::sync::Arc;

/// Is told what happens on a node. It is called from within the node's tasks, so it neither waits nor panics.
pub trait Observer: Send + Sync + 'static {
    /// The node tells of something on its event stream.
    fn on_event(&self, event: &Event);

    /// The node's copy of the ledger has taken in the entry at `at`: commands in their order, or none for one of Raft's own.
    /// After a restart the entries behind the last snapshot are taken in anew.
    fn on_applied(&self, node: &NodeId, at: Epoch, commands: &[Command]);
}

/// An observer that several nodes share.
pub type SharedObserver = Arc<dyn Observer>;

/// Each in turn.
impl Observer for Vec<SharedObserver> {
    fn on_event(&self, event: &Event) {
        self.iter().for_each(|observer| observer.on_event(event));
    }

    fn on_applied(&self, node: &NodeId, at: Epoch, commands: &[Command]) {
        self.iter().for_each(|observer| observer.on_applied(node, at, commands));
    }
}
