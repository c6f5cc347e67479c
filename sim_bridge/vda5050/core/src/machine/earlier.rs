//! What earlier processes may have begun for the goals of this process.

use crate::incoming::VehicleState;
use crate::order_id::OrderId;
use std::collections::BTreeSet;
use std::ops::Range;

/// What is known about the orders of earlier processes.
#[derive(Debug, Default)]
pub(super) struct EarlierProcesses {
    /// The first goal of this process.
    first_goal: Option<u64>,
    /// State before the first order of this process, or before this process has the vehicle forget instant actions:
    /// it shows the latest order of an earlier process.
    before: Option<VehicleState>,
    /// Works that an earlier process may have begun, and that this process has continued or begun.
    taken_over: BTreeSet<u32>,
}

impl EarlierProcesses {
    /// Returns the goals with which an earlier process may have begun the work of a new goal, besides this goal.
    /// `None` if no earlier process has begun it. The node has the results of the goals of this process, so it
    /// decides itself to repeat them.
    pub(super) fn goals(&mut self, goal: u64, work: u32, since: Option<u64>) -> Option<Range<u64>> {
        let first = *self.first_goal.get_or_insert(goal);
        let is_open = |since: &u64| !self.taken_over.contains(&work) && (*since < first || first == goal);
        since.filter(is_open).map(|since| since..first)
    }

    /// Records that this process continues or begins a work. Later goals for it need not consider earlier processes.
    pub(super) fn take_over(&mut self, work: u32) {
        self.taken_over.insert(work);
    }

    /// Keeps the state before this process displaces reports of earlier processes for the first time.
    pub(super) fn keep_state(&mut self, state: &VehicleState) {
        self.before.get_or_insert_with(|| state.clone());
    }

    /// Checks whether the latest order of an earlier process shows that the action was begun with none of the goals.
    /// The order contains the latest action that may have been sent. This action has to be older than the first of
    /// the goals, or to be for that goal with other work. `state` is the latest state.
    pub(super) fn was_not_begun(&self, work: u32, goals: &Range<u64>, state: &VehicleState) -> bool {
        let before = self.before.as_ref().unwrap_or(state);
        let is_same = |order: OrderId| order.work == work && goals.contains(&order.goal);
        let is_other = |order: OrderId| {
            let (acted_goal, acted_work) = order.latest_act();
            acted_goal < goals.start || acted_goal == goals.start && acted_work != work
        };
        let is_reported = before.action_ids().any(|id| OrderId::of_action(id).is_ok_and(is_same));
        !is_reported && before.order.parse::<OrderId>().is_ok_and(is_other)
    }
}

/// Returns goal and work of the latest action that may have been sent; `None` if the order of the state does not show it.
pub(super) fn latest_act(state: &VehicleState) -> Option<(u64, u32)> {
    let order = state.order.parse::<OrderId>().ok()?;
    let reported = state.action_ids().filter_map(|id| OrderId::of_action(id).ok());
    reported.chain([order]).map(|order| order.latest_act()).max()
}
