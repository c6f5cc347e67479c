//! The link of a robot to its driver: latest telemetry, and the record derived from it.

use super::energy_check::pricing_context;
use super::release::DriverActivity;
use super::worker_record::{Publication, WorkerRecord};
use crate::robot_driver::{MapOrders, OpenQuestion, RobotDriver, SharedWays};
use consort_protocol::ids::PlaceId;
use consort_protocol::knowledge::{Availability, Charging, RobotKnowledge};
use consort_protocol::units::{NodeTime, WorldTime};
use consort_skills::actions::{GoalId, RobotActions, Telemetry};
use consort_skills::descriptor::EstimateContext;
use consort_skills::environment::SpeedLimits;
use std::time::Duration;
use tokio::sync::watch;

/// Link of a robot to its driver.
pub(super) struct DriverLink {
    driver: RobotDriver,
    record: WorkerRecord,
    /// Time without a report after which the robot is out of service.
    report_timeout: Duration,
}

impl DriverLink {
    pub(super) fn new(driver: RobotDriver, record: WorkerRecord, report_timeout: Duration) -> DriverLink {
        DriverLink { driver, record, report_timeout }
    }

    /// Returns a clone of the driver for a skill.
    pub(super) fn driver(&self) -> RobotDriver {
        self.driver.clone()
    }

    /// Returns the question of the skill to people.
    pub(super) fn question(&self) -> &OpenQuestion {
        self.driver.question()
    }

    /// Returns the way that a skill requests from the devices of the building.
    pub(super) fn ways(&self) -> &SharedWays {
        self.driver.ways()
    }

    /// Returns a counter of received states, which notifies its receivers of each new state.
    pub(super) fn changes(&self) -> watch::Receiver<u64> {
        self.driver.changes()
    }

    /// Properties sensing (thesis, Listing 3.1): reads the latest driver report. `holding` is the
    /// availability of a robot with a role, `problem` a problem of the robot that has nothing to do
    /// with its driver, and `charging` its charging. Returns what is to be published.
    pub(super) fn sense(
        &mut self,
        holding: Option<Availability>,
        problem: Option<String>,
        charging: Option<Charging>,
        now: NodeTime,
    ) -> Option<Publication> {
        self.driver.refresh();
        let availability = match (holding, problem.or_else(|| self.driver_problem())) {
            (Some(holding), _) => holding,
            (None, Some(problem)) => Availability::out_of_service(problem),
            (None, None) => Availability::Free,
        };
        self.record.update(self.driver.telemetry(), availability, charging, now)
    }

    fn driver_problem(&self) -> Option<String> {
        match self.telemetry() {
            Some(report) if !report.able => Some("its driver reports that it cannot move".to_owned()),
            Some(_) if self.silent_for() < self.report_timeout => None,
            Some(_) | None => Some("its driver does not reply".to_owned()),
        }
    }

    /// Returns the robot's own record.
    pub(super) fn worker(&self) -> &RobotKnowledge {
        self.record.worker()
    }

    /// Returns the telemetry of the last [`sense`](DriverLink::sense).
    pub(super) fn telemetry(&self) -> Option<&Telemetry> {
        self.driver.telemetry()
    }

    /// Sets the orders of people about the map, as of the next [`sense`](DriverLink::sense).
    pub(super) fn set_map_orders(&self, orders: MapOrders) {
        self.driver.set_map_orders(MapOrders { speed: self.worker().speed, ..orders });
    }

    /// Returns the speed limits of people.
    pub(super) fn speed_limits(&self) -> SpeedLimits {
        self.driver.speed_limits().cloned().unwrap_or_default()
    }

    /// Returns the lanes that the driver has found closed, and the lanes and places that people have closed.
    pub(super) fn closed_lanes(&self) -> &[(PlaceId, PlaceId)] {
        self.telemetry().map_or(&[], |report| &report.closed)
    }

    /// Returns the lanes that the driver has found closed.
    pub(super) fn found_closed(&self) -> Vec<(PlaceId, PlaceId)> {
        self.driver.found_closed()
    }

    /// Returns the estimator's input for the robot at its current pose.
    pub(super) fn estimate_context(&self) -> EstimateContext {
        let worker = self.worker();
        EstimateContext {
            pose: Some(worker.pose),
            ..pricing_context(worker, self.closed_lanes(), &self.speed_limits())
        }
    }

    /// Returns the place of the robot, if its driver has reported.
    pub(super) fn place(&self) -> Option<PlaceId> {
        self.telemetry().map(|report| report.place.clone())
    }

    /// Returns the driver's clock.
    pub(super) fn world_time(&self) -> Option<WorldTime> {
        self.telemetry().map(|report| report.time)
    }

    /// Returns the age of the latest telemetry in milliseconds; 0 before the first.
    pub(super) fn telemetry_age_ms(&self) -> u64 {
        self.driver.telemetry_age_ms()
    }

    /// Returns the time since the latest state of the driver.
    pub(super) fn silent_for(&self) -> Duration {
        self.driver.silent_for()
    }

    /// Returns whether the robot is at rest, as far as is known.
    pub(super) fn activity(&self) -> DriverActivity {
        DriverActivity {
            is_idle: self.driver.is_idle(),
            silent_for: self.silent_for(),
            stop_lead: self.driver.stop_lead(),
        }
    }

    /// Returns the time by which the permission of the goals in progress ends before the lease.
    pub(super) fn stop_lead(&self) -> Duration {
        self.driver.stop_lead()
    }

    /// Lets the robot act until this time; `None` forbids it.
    pub(super) fn allow_until(&self, until: Option<NodeTime>) {
        self.driver.allow_until(until);
    }

    /// Returns the id of the next goal.
    pub(super) fn next_goal(&self) -> GoalId {
        self.driver.next_goal()
    }

    /// Begins an attempt at a task with this first goal.
    pub(super) fn begin_attempt(&self, first: GoalId) {
        self.driver.begin_attempt(first);
    }

    /// Cancels every goal in progress: the robot stops safely.
    pub(super) fn stop(&self) {
        self.driver.stop();
    }

    /// Checks whether the robot can move, by the latest report of its driver.
    pub(super) fn is_able(&mut self) -> bool {
        self.driver.refresh();
        self.telemetry().is_none_or(|report| report.able)
    }

    /// Checks whether no goal of the task with this first goal has moved an item, as far as can be said for
    /// certain.
    pub(super) fn moved_nothing(&self, first: GoalId) -> bool {
        self.driver.moved_nothing(first)
    }
}
