//! Leases of chargers during a session: the coordinator proposes their grants and ends, publishes them once they are
//! committed, and notifies the robots.

use super::session_context::SessionContext;
use crate::charger_users::charger_users;
use consort_protocol::chargers::{ChargerAction, ChargerLeases};
use consort_protocol::event::EventKind;
use consort_protocol::ledger::{Command, Ledger, Resource};
use consort_protocol::message::AwardNotice;
use consort_protocol::units::NodeTime;
use std::time::Duration;

/// Interval at which the records of the robots are compared with the leases. Raised: a charger is leased later.
const CHECK_INTERVAL: Duration = Duration::from_millis(100);

/// Leases of chargers during a session.
#[derive(Default)]
pub(super) struct ChargerDelivery {
    leases: ChargerLeases,
    /// Time of the latest comparison.
    checked_at: Option<NodeTime>,
}

impl ChargerDelivery {
    /// Performs what is due. `confirmed_ms` is the time of day that a majority of the voters confirms, in milliseconds
    /// since 1970.
    pub(super) fn follow(&mut self, context: &mut SessionContext, now: NodeTime, confirmed_ms: Option<u64>) {
        if self.checked_at.is_some_and(|at| now.since(at) < CHECK_INTERVAL) {
            return;
        }
        self.checked_at = Some(now);
        let read = |ledger: &Ledger| ledger.leases_resources().then(|| ledger.charger_leases());
        let Some(leases) = context.read_ledger(read) else { return };
        let parts = &context.settings.parts;
        let robots = charger_users(&parts.knowledge, &parts.node);
        for action in self.leases.due(&leases, &robots, now) {
            match action {
                ChargerAction::Notify { charger, robot, epoch } => {
                    context.notify(robot, &AwardNotice::Leased { resource: Resource::Charger(charger), epoch });
                }
                ChargerAction::Lease { .. } if !context.read_ledger(Ledger::has_room_for_lease) => {}
                ChargerAction::Lease { charger, robot } => {
                    let event = EventKind::ChargerLeased { charger: charger.clone(), robot: robot.clone() };
                    let (resource, at_ms) = (Resource::Charger(charger), confirmed_ms.unwrap_or(0));
                    context.propose_lease_change(Command::LeaseResource { resource, robot, at_ms }, event);
                }
                ChargerAction::Free { charger, robot, epoch, cause } => {
                    let event = EventKind::ChargerFreed { charger: charger.clone(), robot, cause: cause.to_string() };
                    let resource = Resource::Charger(charger);
                    context.propose_lease_change(Command::FreeResource { resource, epoch }, event);
                }
            }
        }
    }
}
