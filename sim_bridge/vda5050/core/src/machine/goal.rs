//! The goal in progress.

use super::execution::{ActionRun, OrderRun};
use super::values::{GoalStatus, Work};
use crate::cause::Cause;
use crate::order_id::{Acts, OrderId, latest_of};
use std::ops::Range;
use std::time::Duration;

/// The goal in progress.
#[derive(Debug)]
pub(super) struct ActiveGoal {
    pub(super) id: u64,
    pub(super) fingerprint: u32,
    pub(super) work: Work,
    /// Goals with which an earlier process may have begun the work, besides this goal; `None` if no earlier
    /// process has begun it.
    pub(super) earlier: Option<Range<u64>>,
    /// End of the permission.
    pub(super) until: Duration,
    pub(super) waiting_since: Duration,
    pub(super) attempt: u32,
    pub(super) phase: Phase,
    pub(super) stop: Option<Stop>,
    pub(super) feedback_at: Duration,
}

/// What the goal waits for.
#[derive(Debug)]
pub(super) enum Phase {
    Waiting,
    Order(OrderRun),
    Action(ActionRun),
}

/// The vehicle has to stop: the goal was cancelled, or has failed.
#[derive(Debug, Default)]
pub(super) struct Stop {
    pub(super) failure: Option<Cause>,
    pub(super) sent_at: Option<Duration>,
}

impl ActiveGoal {
    /// Returns the id of the order for this attempt, after the latest actions.
    pub(super) fn order_id(&self, acted: Acts) -> OrderId {
        let is_drive = matches!(self.work, Work::Drive { .. });
        let acts = latest_of(acted.into_iter().flatten().filter(|(goal, _)| is_drive && *goal != self.id));
        OrderId { goal: self.id, work: self.fingerprint, attempt: self.attempt, acts }
    }

    /// Checks whether an order is for the work, and for this goal or a goal with which an earlier process may
    /// have begun it.
    pub(super) fn includes(&self, order: OrderId) -> bool {
        let is_earlier = self.earlier.as_ref().is_some_and(|goals| goals.contains(&order.goal));
        order.work == self.fingerprint && (order.goal == self.id || is_earlier)
    }

    pub(super) fn stop(&mut self, failure: Option<Cause>) {
        self.stop.get_or_insert(Stop { failure, sent_at: None });
    }

    /// Returns the end of the goal after the vehicle has stopped.
    pub(super) fn stopped(&mut self) -> Option<GoalStatus> {
        let stop = self.stop.as_mut()?;
        Some(stop.failure.take().map_or(GoalStatus::Canceled, GoalStatus::Aborted))
    }
}
