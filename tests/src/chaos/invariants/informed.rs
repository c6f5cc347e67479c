//! Robots that state an order in their own record, and since when.

use crate::Fleet;
use consort_protocol::ids::{NodeId, RobotId};
use consort_protocol::knowledge::Availability;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Robots that have received an order.
#[derive(Default)]
pub(super) struct Informed(BTreeMap<RobotId, Duration>);

impl Informed {
    /// Adopts the robots that state the order now.
    pub(super) fn follow(&mut self, at: Duration, robots: BTreeSet<RobotId>) {
        self.0.retain(|robot, _| robots.contains(robot));
        for robot in robots {
            self.0.entry(robot).or_insert(at);
        }
    }

    /// Returns the time since which a robot states the order.
    pub(super) fn since(&self, robot: &RobotId) -> Option<Duration> {
        self.0.get(robot).copied()
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }
}

/// Returns the problem for which a robot is out of service by its own record.
pub(super) fn stated_problem(fleet: &Fleet, robot: &RobotId) -> Option<String> {
    match fleet.knowledge_of(robot.as_str(), &NodeId::from(robot.clone()))?.availability {
        Availability::OutOfService { problem } => Some(problem),
        _ => None,
    }
}
