//! What earlier processes may have begun for the goals of this process.

use super::execution::{ActionRun, Verdict};
use super::goal::ActiveGoal;
use crate::cause::CauseTable;
use crate::incoming::VehicleState;
use crate::order_id::{Acts, OrderId};
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

    /// Compares a goal with the reports of an earlier process: `Absent` if it has not begun the action, or has cancelled
    /// it, and `None` if that is unknown. `state` is the latest state.
    ///
    /// The id of the latest order names all actions since the oldest that it names. If that one is not younger than the
    /// first of the goals, and no action since that goal has the work, the action was not begun.
    pub(super) fn verdict(&self, goal: &ActiveGoal, state: &VehicleState, causes: &CauseTable) -> Option<Verdict> {
        let before = self.before.as_ref().unwrap_or(state);
        let begun = before.action_ids().map(OrderId::of_action).chain([before.order.parse::<OrderId>()]);
        let latest = begun.filter_map(Result::ok).filter(|order| goal.includes(*order)).max();
        if let Some(latest) = latest {
            let verdict = ActionRun::adopt(latest.action(0), before).map(|mut run| run.judge(before, causes));
            return if before.has_cancelled_action(latest) { Some(Verdict::Absent) } else { verdict };
        }
        let since = goal.earlier.as_ref()?.start;
        let acts = before.order.parse::<OrderId>().ok()?.latest_acts();
        let are_known = acts.iter().flatten().any(|(acted, _)| *acted <= since);
        let may_have_begun = acts.iter().flatten().any(|(acted, work)| *acted >= since && *work == goal.fingerprint);
        (are_known && !may_have_begun).then_some(Verdict::Absent)
    }
}

/// Returns the latest actions that may have been sent; none if the order of the state does not show them.
pub(super) fn latest_acts(state: &VehicleState) -> Acts {
    let Ok(order) = state.order.parse::<OrderId>() else { return Acts::default() };
    let mut reported = Vec::from_iter(state.action_ids().filter_map(|id| OrderId::of_action(id).ok()));
    reported.sort();
    // Instant actions after the order.
    let add =
        |acts: Acts, act: &OrderId| if acts[0] < Some((act.goal, act.work)) { act.acts_after(acts) } else { acts };
    reported.iter().fold(order.latest_acts(), add)
}
