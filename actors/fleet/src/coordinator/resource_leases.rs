//! Leases of chargers and devices during a session: the coordinator proposes their grants and ends, publishes them once they
//! are committed, and notifies the robots.

use super::session_context::SessionContext;
use crate::charger_users::charger_users;
use crate::device_reports::device_reports;
use consort_gossip::SharedKnowledge;
use consort_protocol::chargers::ChargerLeases;
use consort_protocol::devices::{DeviceLeases, DeviceUser};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{DeviceId, NodeId, RobotId};
use consort_protocol::knowledge::DeviceClaims;
use consort_protocol::ledger::{Command, Ledger, Resource, ResourceLease};
use consort_protocol::message::AwardNotice;
use consort_protocol::resource_leases::ResourceAction;
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Interval at which the records of the robots are compared with the leases. Raised: a resource is leased later.
const CHECK_INTERVAL: Duration = Duration::from_millis(100);

/// Leases of chargers and devices during a session.
#[derive(Default)]
pub(super) struct ResourceDelivery {
    chargers: ChargerLeases,
    devices: DeviceLeases,
    /// Time of the latest comparison.
    checked_at: Option<NodeTime>,
}

impl ResourceDelivery {
    /// Performs what is due. `confirmed_ms` is the time of day that a majority of the voters confirms, in milliseconds
    /// since 1970.
    pub(super) fn follow(&mut self, context: &mut SessionContext, now: NodeTime, confirmed_ms: Option<u64>) {
        if self.checked_at.is_some_and(|at| now.since(at) < CHECK_INTERVAL) {
            return;
        }
        self.checked_at = Some(now);
        let read = |ledger: &Ledger| (ledger.charger_leases(), ledger.device_leases());
        let leases = context.read_ledger(|ledger| ledger.leases_resources().then(|| read(ledger)));
        let Some((chargers, devices)) = leases else { return };
        let parts = &context.settings.parts;
        let mut actions = self.chargers.due(&chargers, &charger_users(&parts.knowledge, &parts.node), now);
        actions.extend(self.device_actions(context, &devices, now));
        for action in actions {
            perform(action, context, confirmed_ms.unwrap_or(0));
        }
    }

    fn device_actions(
        &mut self,
        context: &SessionContext,
        leases: &BTreeMap<DeviceId, ResourceLease>,
        now: NodeTime,
    ) -> Vec<ResourceAction> {
        let parts = &context.settings.parts;
        let mut robots = device_users(&parts.knowledge, &parts.node);
        if leases.is_empty() && !robots.iter().any(DeviceUser::asks) {
            return vec![];
        }
        let known: BTreeSet<RobotId> = robots.iter().map(|user| user.robot.clone()).collect();
        let users: BTreeSet<RobotId> = leases.values().map(|lease| lease.robot.clone()).collect();
        robots.extend(users.into_iter().filter(|robot| !known.contains(robot)).map(forgotten));
        context.read_ledger(|ledger| {
            let removed: BTreeSet<&RobotId> = ledger
                .robot_orders()
                .filter(|(_, orders)| orders.maintenance.is_some())
                .map(|(robot, _)| robot)
                .collect();
            robots.iter_mut().for_each(|user| user.is_in_maintenance = removed.contains(&user.robot));
        });
        let reports = device_reports(&parts.knowledge, &context.settings.devices, &parts.node);
        self.devices.due(leases, &robots, &reports, now)
    }
}

/// Performs an action. `at_ms` is the confirmed time of day; 0 if it is unknown.
fn perform(action: ResourceAction, context: &mut SessionContext, at_ms: u64) {
    match action {
        ResourceAction::Notify { resource, robot, epoch } => {
            context.notify(robot, &AwardNotice::Leased { resource, epoch });
        }
        ResourceAction::Lease { .. } if !context.read_ledger(Ledger::has_room_for_lease) => {}
        ResourceAction::Lease { resource, robot } => {
            let event = match resource.clone() {
                Resource::Charger(charger) => EventKind::ChargerLeased { charger, robot: robot.clone() },
                Resource::Device(device) => EventKind::DeviceLeased { device, robot: robot.clone() },
            };
            context.propose_lease_change(Command::LeaseResource { resource, robot, at_ms }, event);
        }
        ResourceAction::Free { resource, robot, epoch, cause } => {
            let cause = cause.to_string();
            let event = match resource.clone() {
                Resource::Charger(charger) => EventKind::ChargerFreed { charger, robot, cause },
                Resource::Device(device) => EventKind::DeviceFreed { device, robot, cause },
            };
            context.propose_lease_change(Command::FreeResource { resource, epoch }, event);
        }
    }
}

/// Returns a robot without a record: nodes forget those of lost robots after some time.
fn forgotten(robot: RobotId) -> DeviceUser {
    DeviceUser { robot, claims: None, is_alive: false, is_in_maintenance: false }
}

/// Returns all robots with a known record. `own` is the node that asks, which is up.
fn device_users(knowledge: &SharedKnowledge, own: &NodeId) -> Vec<DeviceUser> {
    let users: Vec<(NodeId, Option<DeviceClaims>)> = knowledge.read(|base| {
        let robots = base.iter().filter(|(_, known)| known.record.knowledge.robot.is_some());
        robots.map(|(node, known)| (node.clone(), known.record.knowledge.devices.claims.clone())).collect()
    });
    let user = |(node, claims): (NodeId, Option<DeviceClaims>)| {
        let is_alive = node == *own || knowledge.is_alive(&node);
        DeviceUser { robot: RobotId::from(node), claims, is_alive, is_in_maintenance: false }
    };
    users.into_iter().map(user).collect()
}
