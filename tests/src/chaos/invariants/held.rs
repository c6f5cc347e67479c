//! A held robot stands still.
//!
//! A robot in a role stands still once the lease that it may have had at the time of the hold is over: each later
//! renewal contains the hold. A robot without a role, which charges by itself, stands still after it has received
//! the hold; its own record then states it. Around the end of a hold the robot may move, since clocks drift.

use super::InvariantViolation;
use super::active_goals::ActiveGoals;
use super::informed::{Informed, stated_problem};
use super::obeyed::Obeyed;
use super::reference_ledger::ReferenceLedger;
use crate::Fleet;
use crate::chaos::dates::DATE_MS;
use crate::order_bounds::stops_within;
use consort_protocol::ids::RobotId;
use consort_protocol::ledger::RobotOrder;
use std::collections::BTreeMap;
use std::time::Duration;

pub(super) struct Held {
    lease: Duration,
    reference: ReferenceLedger,
    /// Holds in the ledger, with the times of their latest changes.
    holds: BTreeMap<RobotId, (RobotOrder, Duration)>,
    /// Held robots that state the hold in their record.
    informed: Informed,
    active: ActiveGoals,
}

impl Held {
    pub(super) fn new(lease: Duration) -> Held {
        Held {
            lease,
            reference: ReferenceLedger::default(),
            holds: BTreeMap::new(),
            informed: Informed::default(),
            active: ActiveGoals::default(),
        }
    }

    /// Records which held robots state the hold; `states_hold` reads the record of a robot.
    fn inform(&mut self, at: Duration, states_hold: impl Fn(&RobotId) -> bool) {
        self.informed.follow(at, self.holds.keys().filter(|robot| states_hold(robot)).cloned().collect());
    }

    fn check(&self, at: Duration) -> Result<(), InvariantViolation> {
        for (robot, (order, since)) in &self.holds {
            if may_be_over(order, at) {
                continue;
            }
            let is_over = |since: &Duration| at > self.active.stopped_from(*since) + stops_within(self.lease);
            for ((_, id), goal) in self.active.goals.iter().filter(|((other, _), _)| other == robot) {
                let must_stand = match goal.in_role {
                    true => is_over(since),
                    false => self.informed.since(robot).as_ref().is_some_and(is_over),
                };
                if must_stand {
                    let held_s = at.saturating_sub(*since).as_secs_f64();
                    let reason = format!("{robot} pursues goal {id}, {held_s:.1} s after it was {}", order.hold_text());
                    return Err(reason.into());
                }
            }
        }
        Ok(())
    }
}

/// Returns the end of an order since the start of the fleet.
fn ends_after(order: &RobotOrder) -> Duration {
    order.until_ms.map_or(Duration::MAX, |until_ms| Duration::from_millis(until_ms.saturating_sub(DATE_MS)))
}

/// Returns the largest time by which a robot may end an order too early: the dates of two coordinators and the clock of
/// the robot drift by up to 5 %, and dates are read every 5 s.
fn tolerance(at: Duration) -> Duration {
    at / 10 + Duration::from_secs(5)
}

/// Checks whether the time of an order may have passed for a robot.
pub(super) fn may_be_over(order: &RobotOrder, at: Duration) -> bool {
    at > ends_after(order).saturating_sub(tolerance(at))
}

impl Obeyed for Held {
    const NAME: &'static str = "held";

    fn followed(&mut self) -> (&mut ReferenceLedger, &mut ActiveGoals) {
        (&mut self.reference, &mut self.active)
    }

    /// Adopts the holds of the ledger.
    fn update(&mut self, at: Duration) {
        let held = self.reference.ledger.robot_orders();
        let held: BTreeMap<RobotId, RobotOrder> =
            held.filter_map(|(robot, orders)| Some((robot.clone(), orders.hold.clone()?))).collect();
        self.holds.retain(|robot, (order, _)| held.get(robot) == Some(&*order));
        for (robot, order) in held {
            self.holds.entry(robot).or_insert((order, at));
        }
    }

    fn check_goals(&mut self, at: Duration, fleet: &Fleet) -> Result<(), InvariantViolation> {
        if self.holds.is_empty() {
            self.informed.clear();
            return Ok(());
        }
        self.inform(at, |robot| stated_problem(fleet, robot).is_some_and(|problem| problem.starts_with("held by ")));
        self.check(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slug;
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::{Command, OrderChange, OrderRequest};
    use consort_skills::actions::Dock;
    use std::collections::BTreeSet;

    fn secs(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    /// Returns the state after garnet was held for a minute at 100 s, while it pursued a goal.
    fn held(in_role: bool) -> Held {
        let mut state = Held::new(secs(4));
        let change = OrderChange::Hold { until_ms: DATE_MS + 160_000, reason: String::new() };
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms: DATE_MS + 100_000, request: None };
        let hold = Command::OrderRobots { robots: BTreeSet::from([slug("garnet")]), order };
        state.reference.apply(Epoch { term: 1, index: 1 }, &[Command::first_wire_version(3), hold]);
        if in_role {
            state.active.roles.insert((slug("garnet"), "lab-samples-1".parse().unwrap(), slug("r1")));
        }
        state.active.begin(&slug("garnet"), 7, &Dock { charger: None }.into());
        state.update(secs(100));
        state
    }

    #[test]
    fn a_held_robot_that_pursues_a_goal_in_a_role_is_found() {
        let mut state = held(true);
        assert_eq!(state.check(secs(107)), Ok(()), "its lease");
        let violation = state.check(secs(108)).unwrap_err().0;
        assert_eq!(violation, "garnet pursues goal 7, 8.0 s after it was held by Nia");
        assert_eq!(state.check(secs(159)), Ok(()), "the hold may be over");
        state.active.server_changed = secs(105);
        assert_eq!(state.check(secs(108)), Ok(()), "the driver server permits it");
        state.active.server_changed = Duration::ZERO;
        state.active.goals.clear();
        assert_eq!(state.check(secs(108)), Ok(()));
    }

    #[test]
    fn a_robot_without_a_role_may_move_until_it_states_the_hold() {
        let mut state = held(false);
        state.inform(secs(120), |_| false);
        assert_eq!(state.check(secs(130)), Ok(()), "it has not received the hold");
        state.inform(secs(120), |_| true);
        state.inform(secs(121), |_| true);
        assert_eq!(state.check(secs(127)), Ok(()));
        assert!(state.check(secs(128)).is_err());
        state.inform(secs(128), |_| false);
        assert_eq!(state.check(secs(128)), Ok(()), "its node has restarted");
    }
}
