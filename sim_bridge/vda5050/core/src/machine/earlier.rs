//! What earlier processes may have begun for the goals of this process.

use super::execution::{ActionRun, Verdict};
use super::goal::ActiveGoal;
use crate::cause::CauseTable;
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

    /// Compares a goal with the reports of an earlier process: `Absent` if it has not begun the action, and `None` if
    /// that is unknown. `state` is the latest state.
    ///
    /// The latest order contains the latest action that may have been sent. If this action is older than the first of the
    /// goals, or is for that goal with other work, the action was not begun.
    pub(super) fn verdict(&self, goal: &ActiveGoal, state: &VehicleState, causes: &CauseTable) -> Option<Verdict> {
        let before = self.before.as_ref().unwrap_or(state);
        let begun = before.action_ids().map(OrderId::of_action).chain([before.order.parse::<OrderId>()]);
        let latest = begun.filter_map(Result::ok).filter(|order| goal.includes(*order)).max();
        if let Some(latest) = latest {
            return ActionRun::adopt(latest.action(0), before).map(|mut run| run.judge(before, causes));
        }
        let since = goal.earlier.as_ref()?.start;
        let (acted_goal, acted_work) = before.order.parse::<OrderId>().ok()?.latest_act();
        let is_absent = acted_goal < since || acted_goal == since && acted_work != goal.fingerprint;
        is_absent.then_some(Verdict::Absent)
    }
}

/// Returns goal and work of the latest action that may have been sent; `None` if the order of the state does not show it.
pub(super) fn latest_act(state: &VehicleState) -> Option<(u64, u32)> {
    let order = state.order.parse::<OrderId>().ok()?;
    let reported = state.action_ids().filter_map(|id| OrderId::of_action(id).ok());
    reported.chain([order]).map(|order| order.latest_act()).max()
}
