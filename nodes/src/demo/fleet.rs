//! What the director needs of a stage.

use crate::exit::Failure;
use consort_actors::bus::SharedBus;
use consort_protocol::ids::NodeId;
use std::future::Future;
use std::time::Duration;

/// Where a demo is played.
pub trait DemoFleet {
    /// The bus, as an onlooker and a client have it.
    fn bus(&self) -> SharedBus;

    /// How the stage is introduced: what runs, and how it may be looked into.
    fn description(&self) -> String;

    /// Ends a node at once and without warning.
    fn kill(&mut self, node: &NodeId) -> impl Future<Output = Result<(), Failure>>;

    /// Starts a node that was killed, as a service manager would.
    fn restart(&mut self, node: &NodeId) -> impl Future<Output = Result<(), Failure>>;

    /// What has gone wrong by itself since it was last asked: a node that ended though nobody killed it.
    fn unexpected_exit(&mut self) -> Option<String>;

    /// Waits until somebody wants it all to end (Ctrl-C), or has wanted it since it was last asked.
    fn interrupted(&mut self) -> impl Future<Output = ()>;

    /// Ends everything.
    fn shut_down(self) -> impl Future<Output = ()>;

    /// Time since the stage was set.
    fn elapsed(&self) -> Duration;
}
