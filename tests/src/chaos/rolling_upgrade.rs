//! Upgrade of a fleet: its nodes are restarted in turn, and a person then raises the wire version.

use crate::history::RecordingClient;
use consort_protocol::versions::VersionRange;
use std::collections::VecDeque;
use std::time::Duration;

/// An upgrade in progress.
pub(super) struct RollingUpgrade {
    /// Nodes that still run the previous program.
    waiting: VecDeque<String>,
    interval: Duration,
    /// Time of the next restart.
    due: Duration,
}

impl RollingUpgrade {
    /// Begins an upgrade of these nodes now.
    pub(super) fn new(nodes: Vec<String>, interval: Duration, now: Duration) -> RollingUpgrade {
        RollingUpgrade { waiting: nodes.into(), interval, due: now }
    }

    /// Returns the node that is to be restarted now.
    pub(super) fn next(&mut self, now: Duration) -> Option<String> {
        if now < self.due {
            return None;
        }
        self.due = now + self.interval;
        self.waiting.pop_front()
    }

    /// Checks whether all nodes have been restarted.
    pub(super) fn is_complete(&self) -> bool {
        self.waiting.is_empty()
    }
}

/// Starts a person who raises the wire version as soon as the fleet permits it.
pub(super) fn spawn_finish(client: RecordingClient) {
    tokio::spawn(async move { client.upgrade(VersionRange::OWN.newest).await });
}
