//! Timers of the gossiper, in the order in which they are due.

use crate::swim::{Suspicion, Timer};
use consort_protocol::ids::NodeId;
use consort_protocol::units::NodeTime;
use std::collections::BTreeMap;

/// A timer.
#[derive(Debug)]
pub(super) enum ScheduledTimer {
    Heartbeat,
    Round,
    Announce,
    Swim(Timer),
    /// A node with a vanished token should have answered by now. The number distinguishes this
    /// query from earlier ones.
    QueryTimeout(NodeId, u64),
    /// The node was then suspected, and should have refuted the suspicion by now.
    SuspicionTimeout(Suspicion, NodeId, u64),
}

/// Scheduled timers, and the source of the numbers that distinguish timers, rounds and queries.
#[derive(Debug, Default)]
pub(super) struct Agenda {
    timers: BTreeMap<(NodeTime, u64), ScheduledTimer>,
    /// Last assigned number. It orders timers that are due at the same instant.
    last_number: u64,
}

impl Agenda {
    /// Schedules a timer.
    pub(super) fn at(&mut self, due: NodeTime, timer: ScheduledTimer) {
        let number = self.number();
        self.timers.insert((due, number), timer);
    }

    /// Assigns the next number.
    pub(super) fn number(&mut self) -> u64 {
        self.last_number += 1;
        self.last_number
    }

    /// Returns the time of the next timer.
    pub(super) fn next_due(&self) -> Option<NodeTime> {
        self.timers.first_key_value().map(|((at, _), _)| *at)
    }

    /// Removes and returns the next timer that is due.
    pub(super) fn take_due(&mut self, now: NodeTime) -> Option<ScheduledTimer> {
        self.timers.first_entry().filter(|entry| entry.key().0 <= now).map(|entry| entry.remove())
    }
}
