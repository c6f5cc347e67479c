//! The node of a device: it runs the driver, serves the robots that have leases, and reports the state of the device in
//! its record. The decisions are in `control`.

mod claims;
mod control;

use claims::{LeasedClaim, served_claim};
use consort_bus::clock::Clock;
use consort_gossip::{GossipHandle, SharedKnowledge};
use consort_protocol::devices::Device;
use consort_protocol::ids::{DeviceId, NodeId, RobotId};
use consort_protocol::knowledge::DeviceReport;
use consort_protocol::ledger::{Ledger, Resource};
use consort_protocol::units::WorldTime;
use consort_raft::Replica;
use consort_skills::actions::RobotBackend;
use control::{DeviceControl, HostAction, HostInput};
use std::time::Duration;
use tracing::{debug, info};

/// Interval of the steps. Raised: robots wait longer at devices.
const STEP_INTERVAL: Duration = Duration::from_millis(200);

/// Time for which the driver may serve after each step: some intervals.
const PERMISSION: Duration = Duration::from_secs(3);

/// A device that this node serves with a driver.
pub(crate) struct DeviceHost {
    pub(crate) device: Device,
    /// Driver, which knows the device by its name as a robot.
    pub(crate) driver: Box<dyn RobotBackend>,
    pub(crate) clock: Clock,
    pub(crate) gossip: GossipHandle,
    pub(crate) knowledge: SharedKnowledge,
    /// The node's copy of the ledger, if any: it contains the alarms.
    pub(crate) replica: Option<Replica<Ledger>>,
    /// First goal id, different for each incarnation of the node.
    pub(crate) first_goal: u64,
}

impl DeviceHost {
    /// Serves the device until gossip stops.
    pub(crate) async fn run(self) {
        let DeviceHost { device, mut driver, clock, gossip, knowledge, replica, first_goal } = self;
        let (name, own, started) = (device.name.clone(), device.host.clone(), clock.now());
        let Ok(robot) = RobotId::new(name.as_str()) else { return };
        let mut control = DeviceControl::new(device, first_goal);
        let mut published: Option<DeviceReport> = None;
        let mut claim: Option<LeasedClaim> = None;
        loop {
            let now = clock.now();
            driver.advance(WorldTime::from_secs(now.since(started).as_secs_f64()));
            // The copy of a node that is no member of consensus stays empty.
            let member = replica.as_ref().filter(|replica| replica.leadership().borrow().is_member(replica.id()));
            let in_force = member.map(|replica| replica.read(|ledger| lease_in_force(ledger, &name)));
            claim = knowledge.read(|base| served_claim(base, &name, in_force.as_ref(), claim.as_ref()));
            let user = match in_force {
                Some(lease) => lease.map(|(robot, _)| NodeId::from(robot)),
                None => claim.as_ref().map(|claim| claim.node.clone()),
            };
            let input = HostInput {
                claim: claim.as_ref().map(|claim| claim.served.clone()),
                is_robot_lost: user.is_some_and(|node| node != own && !knowledge.is_alive(&node)),
                is_alarm: member.is_some_and(|replica| replica.read(Ledger::has_alarm)),
                responds: driver.telemetry(&robot).is_some(),
                status: control.goal().and_then(|goal| driver.status(&robot, goal)),
            };
            let (actions, report) = control.step(&input, now);
            for action in actions {
                debug!(device = %name, ?action, "driver of a device");
                match action {
                    HostAction::Start(id, goal) => {
                        driver.permit(&robot, id, PERMISSION);
                        driver.start(&robot, id, goal);
                    }
                    HostAction::Permit(id) => driver.permit(&robot, id, PERMISSION),
                    HostAction::Cancel(id) => driver.cancel(&robot, id),
                }
            }
            if published.as_ref() != Some(&report) {
                info!(device = %name, state = ?report.state, "device");
                published = Some(report.clone());
                let device = name.clone();
                let publish = gossip.update_with(move |knowledge| _ = knowledge.devices.reports.insert(device, report));
                if publish.is_err() {
                    return;
                }
            }
            tokio::time::sleep(STEP_INTERVAL).await;
        }
    }
}

/// Returns the lease of a device in the ledger: its robot, and its position in the log.
fn lease_in_force(ledger: &Ledger, device: &DeviceId) -> Option<(RobotId, u64)> {
    let lease = ledger.resource_leases().get(&Resource::Device(device.clone()))?;
    Some((lease.robot.clone(), lease.epoch.index))
}
