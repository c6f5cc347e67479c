//! The execution of plans, as a value: the active plan and the times of its periodic checks.

use super::active_plan::{ActivePlan, PlanAction};
use consort_protocol::lease::Epoch;
use consort_protocol::units::NodeTime;
use std::time::Duration;

/// Interval at which the remaining plan is priced while a task is running.
const PRICING_INTERVAL: Duration = Duration::from_secs(1);

/// Minimum interval of queries for awaited signals: a published signal may have been lost.
const SIGNAL_QUERY_INTERVAL: Duration = Duration::from_secs(1);

/// Execution of the robot's plan.
pub(super) struct Execution {
    /// The active plan, if the robot has started its role.
    pub(super) plan: Option<ActivePlan>,
    /// Number of skills started so far.
    skill_runs: u64,
    priced_at: NodeTime,
    signals_queried_at: NodeTime,
}

impl Execution {
    pub(super) fn new(now: NodeTime) -> Execution {
        Execution { plan: None, skill_runs: 0, priced_at: now, signals_queried_at: now }
    }

    /// Returns the plan of this award.
    pub(super) fn plan_of(&mut self, epoch: Epoch) -> Option<&mut ActivePlan> {
        self.plan.as_mut().filter(|active| active.award.epoch == epoch)
    }

    /// Returns the plan, unless its role is being released.
    pub(super) fn continuing_plan(&mut self) -> Option<&mut ActivePlan> {
        self.plan.as_mut().filter(|active| !active.is_releasing())
    }

    /// Takes the plan of this award.
    pub(super) fn take_plan(&mut self, epoch: Epoch) -> Option<ActivePlan> {
        self.plan.take_if(|active| active.award.epoch == epoch)
    }

    /// Returns the next action of the plan.
    pub(super) fn next_action(&mut self, now: NodeTime) -> Option<PlanAction> {
        self.plan.as_mut()?.next_action(now)
    }

    /// Returns the number of the next skill run.
    pub(super) fn next_run(&mut self) -> u64 {
        self.skill_runs += 1;
        self.skill_runs
    }

    /// Checks whether the remaining plan is to be priced again.
    pub(super) fn is_pricing_due(&self, now: NodeTime) -> bool {
        now.since(self.priced_at) >= PRICING_INTERVAL
    }

    /// Marks the remaining plan as priced.
    pub(super) fn set_priced(&mut self, now: NodeTime) {
        self.priced_at = now;
    }

    /// Checks whether a query for awaited signals is due, and marks it as sent.
    pub(super) fn take_signal_query(&mut self, now: NodeTime) -> bool {
        let is_due = now.since(self.signals_queried_at) >= SIGNAL_QUERY_INTERVAL;
        if is_due {
            self.signals_queried_at = now;
        }
        is_due
    }
}
