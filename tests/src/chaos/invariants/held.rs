//! A held robot stands still.
//!
//! A robot in a role stands still once the lease that it may have had at the time of the hold is over: each later
//! renewal contains the hold. A robot without a role, which charges by itself, stands still after it has received
//! the hold; its own record then states it. Around the end of a hold the robot may move, since clocks drift.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::chaos::chaos_fleet::{DATE_MS, WORLD};
use crate::{Fleet, Observation};
use consort_fleet::robot_driver::CLIENT_TIMEOUT;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::knowledge::Availability;
use consort_protocol::lease::LEASE_REACTION;
use consort_protocol::ledger::RobotOrder;
use consort_world::world::{LoggedEvent, WorldEvent as InWorld};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Time for messages on their way, and for a former coordinator that renews leases until it steps down.
const DELIVERY: Duration = Duration::from_secs(2);

pub(super) struct Held {
    lease: Duration,
    reference: ReferenceLedger,
    /// Holds in the ledger, with the times of their latest changes.
    holds: BTreeMap<RobotId, (RobotOrder, Duration)>,
    /// Held robots without a role that state the hold in their record, and since when.
    informed: BTreeMap<RobotId, Duration>,
    roles: BTreeSet<(NodeId, MissionId, RoleId)>,
    /// Active goals in the world; true for those that were begun in a role.
    goals: BTreeMap<(RobotId, u64), bool>,
    /// Time of the latest start or end of the driver server, which then permits all goals for a while.
    server_changed: Duration,
}

impl Held {
    pub(super) fn new(lease: Duration) -> Held {
        Held {
            lease,
            reference: ReferenceLedger::default(),
            holds: BTreeMap::new(),
            informed: BTreeMap::new(),
            roles: BTreeSet::new(),
            goals: BTreeMap::new(),
            server_changed: Duration::ZERO,
        }
    }

    /// Returns the longest time from a hold until the robot is at rest. Clocks differ by up to 10 %.
    fn stops_within(&self) -> Duration {
        (self.lease + self.lease / 10).max(CLIENT_TIMEOUT) + LEASE_REACTION + DELIVERY
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

    /// Follows the roles in which the robots act, by their own events.
    fn follow_role(&mut self, entry: &Observation) {
        let node = entry.node();
        if let Observation::TestAction { action: "killed" | "ended" | "left", .. } = entry {
            self.roles.retain(|(robot, ..)| robot != node);
        }
        match entry.event_kind() {
            Some(EventKind::Started { mission, role, .. } | EventKind::Resumed { mission, role }) => {
                self.roles.insert((node.clone(), mission.clone(), role.clone()));
            }
            Some(
                EventKind::Suspended { mission, role }
                | EventKind::GaveUp { mission, role, .. }
                | EventKind::TaskFailed { mission, role, .. }
                | EventKind::Halted { mission, role, .. },
            ) => {
                self.roles.remove(&(node.clone(), mission.clone(), role.clone()));
            }
            _ => {}
        }
    }

    fn begins_goal(&mut self, robot: &RobotId, goal: u64) {
        let in_role = self.roles.iter().any(|(node, ..)| node.as_str() == robot.as_str());
        self.goals.insert((robot.clone(), goal), in_role);
    }

    /// Records which held robots without a role state the hold; `states_hold` reads the record of a robot.
    fn inform(&mut self, at: Duration, states_hold: impl Fn(&RobotId) -> bool) {
        let informed: Vec<RobotId> = self.holds.keys().filter(|robot| states_hold(robot)).cloned().collect();
        self.informed.retain(|robot, _| informed.contains(robot));
        for robot in informed {
            self.informed.entry(robot).or_insert(at);
        }
    }

    fn check(&self, at: Duration) -> Result<(), InvariantViolation> {
        for (robot, (order, since)) in &self.holds {
            if at > ends_after(order).saturating_sub(tolerance(at)) {
                continue;
            }
            let is_over = |since: &Duration| at > (*since).max(self.server_changed) + self.stops_within();
            for ((_, goal), in_role) in self.goals.iter().filter(|((other, _), _)| other == robot) {
                let must_stand = match in_role {
                    true => is_over(since),
                    false => self.informed.get(robot).is_some_and(is_over),
                };
                if must_stand {
                    let held_s = at.saturating_sub(*since).as_secs_f64();
                    let reason =
                        format!("{robot} pursues goal {goal}, {held_s:.1} s after it was {}", order.hold_text());
                    return Err(reason.into());
                }
            }
        }
        Ok(())
    }
}

/// Returns the end of a hold since the start of the fleet.
fn ends_after(order: &RobotOrder) -> Duration {
    order.until_ms.map_or(Duration::MAX, |until_ms| Duration::from_millis(until_ms.saturating_sub(DATE_MS)))
}

/// Returns the largest time by which a robot may end a hold too early: the dates of two coordinators and the clock of the
/// robot drift by up to 5 %, and dates are read every 5 s.
fn tolerance(at: Duration) -> Duration {
    at / 10 + Duration::from_secs(5)
}

impl Invariant for Held {
    fn name(&self) -> &'static str {
        "held"
    }

    fn observe(&mut self, at: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        match entry {
            Observation::EntryApplied { .. } => {
                self.reference.observe(entry);
                self.update(at);
            }
            Observation::TestAction { node, .. } if node.as_str() == WORLD => self.server_changed = at,
            _ => {}
        }
        self.follow_role(entry);
        Ok(())
    }

    fn observe_world(&mut self, _: Duration, entry: &LoggedEvent, _: &Fleet) -> Result<(), InvariantViolation> {
        match &entry.event {
            InWorld::GoalStarted { robot, id, .. } => self.begins_goal(robot, id.0),
            InWorld::GoalEnded { robot, id, .. } => {
                self.goals.remove(&(robot.clone(), id.0));
            }
            InWorld::Stranded { robot } => self.goals.retain(|(other, _), _| other != robot),
            _ => {}
        }
        Ok(())
    }

    fn check_state(&mut self, at: Duration, fleet: &Fleet) -> Result<(), InvariantViolation> {
        if self.holds.is_empty() {
            self.informed.clear();
            return Ok(());
        }
        self.inform(at, |robot| {
            let record = fleet.knowledge_of(robot.as_str(), &NodeId::from(robot.clone()));
            record.is_some_and(|record| match record.availability {
                Availability::OutOfService { problem } => problem.starts_with("held by "),
                _ => false,
            })
        });
        self.check(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slug;
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::{Command, OrderChange, OrderRequest};

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
            state.roles.insert((slug("garnet"), "lab-samples-1".parse().unwrap(), slug("r1")));
        }
        state.begins_goal(&slug("garnet"), 7);
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
        state.server_changed = secs(105);
        assert_eq!(state.check(secs(108)), Ok(()), "the driver server permits it");
        state.server_changed = Duration::ZERO;
        state.goals.clear();
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
