//! The robot actor follows the devices of the building: it publishes its claims, and lets its skills enter.

use super::state::RobotState;
use crate::device_reports::device_reports;
use crate::robot::device_access::{AT_PLACE_M, AccessSituation, DeviceAccess};
use consort_protocol::ids::{DeviceId, NodeId};
use consort_protocol::units::NodeTime;
use consort_skills::environment::Routes;
use tracing::debug;

/// Greatest distance from the straight line of a way at which the robot may be on it, in metres: half of the width of a wide
/// door. Raised: a robot whose pose is wrong keeps more doors after a restart.
const ON_WAY_M: f64 = 1.0;

impl RobotState {
    /// Sets the orders of people about the map, and the lanes of devices that no robot can use.
    pub(super) fn update_map_orders(&mut self, now: NodeTime) {
        let mut orders = self.orders.map_orders(now);
        orders.closed.extend(self.devices.iter().flat_map(DeviceAccess::closed).cloned());
        self.driver.set_map_orders(orders);
    }

    /// Decides which devices the robot claims, and whether it may enter.
    pub(super) fn follow_devices(&mut self, now: NodeTime) {
        let has_coordinator = self.lease.has_coordinator(now);
        let (Some(access), Some(devices)) = (&mut self.devices, &self.settings.devices) else { return };
        let Some(report) = self.driver.telemetry() else { return };
        let links = &self.settings.links;
        let routes = self.settings.pricing.estimator.environment().find::<Routes>();
        let pose = routes.and_then(|routes| routes.pose(&report.place));
        let is_near = pose.is_none_or(|pose| pose.distance(report.pose).get() <= AT_PLACE_M);
        let reports = device_reports(&links.knowledge, devices, &NodeId::from(self.settings.robot.clone()));
        let requested = self.driver.ways().requested(now);
        let ahead = routes.map_or(vec![], |routes| routes.ways_at(&report.place, report.pose, ON_WAY_M));
        let is_at_rest = self.driver.activity().is_idle;
        let granted = access.decide(&AccessSituation {
            place: &report.place,
            is_at_place: is_near && is_at_rest,
            is_at_rest,
            pose: report.pose,
            requested: requested.as_ref(),
            ahead: &ahead,
            reports: &reports,
            has_coordinator,
            now,
        });
        self.driver.ways().grant(granted);
        self.publish_claims();
    }

    /// Receives the lease of a device, by its position in the log.
    pub(super) fn receive_device_lease(&mut self, device: &DeviceId, lease: u64, now: NodeTime) {
        let Some(access) = &mut self.devices else { return };
        access.receive_lease(device, lease);
        self.publish_claims();
        self.follow_devices(now);
    }

    /// Publishes the claims, if they have changed.
    pub(super) fn publish_claims(&mut self) {
        let Some(access) = &mut self.devices else { return };
        if !access.must_publish() {
            return;
        }
        let claims = access.claims().cloned();
        debug!(robot = %self.settings.robot, ?claims, "claims of devices change");
        if self.settings.links.gossip.update_with(move |knowledge| knowledge.devices.claims = claims).is_err() {
            debug!(robot = %self.settings.robot, "gossip has stopped");
        }
    }
}
