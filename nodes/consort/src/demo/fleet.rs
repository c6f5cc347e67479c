//! The interface of a fleet for the demo's runner.

use crate::exit::Failure;
use consort_bus::SharedBus;
use consort_protocol::ids::NodeId;
use std::future::Future;
use std::time::Duration;

/// A fleet that runs a demo.
pub trait DemoFleet {
    /// Returns the bus, as seen by an external client.
    fn bus(&self) -> SharedBus;

    /// Describes the fleet: its nodes, and how to inspect it.
    fn description(&self) -> String;

    /// Kills a node without warning.
    fn kill(&mut self, node: &NodeId) -> impl Future<Output = Result<(), Failure>>;

    /// Restarts a killed node, as a service manager would.
    fn restart(&mut self, node: &NodeId) -> impl Future<Output = Result<(), Failure>>;

    /// Returns a failure since the last call: a node that ended though it was not killed.
    fn unexpected_exit(&mut self) -> Option<String>;

    /// Waits for an interrupt (Ctrl-C), including an interrupt since the last call.
    fn interrupted(&mut self) -> impl Future<Output = ()>;

    /// Ends all nodes.
    fn shut_down(self) -> impl Future<Output = ()>;

    /// Returns the time since the fleet was started.
    fn elapsed(&self) -> Duration;
}
