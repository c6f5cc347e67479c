//! Log of the copies of the ledger, as voters show them, and what must hold in it while robots are under orders.

use crate::own_records::{INTERVAL, view_of};
use consort_bus::SharedBus;
use consort_protocol::ids::{NodeId, RobotId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::view::{FleetView, RobotView};
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::time::{Instant, sleep_until};

/// What a copy states about a robot.
#[derive(Debug, Clone, PartialEq)]
struct CopyState {
    /// Time of the reply.
    at: Instant,
    robot: RobotId,
    /// Number of the last entry of the ledger that the copy contains.
    revision: u64,
    /// Number of the entry with the award of the role that the robot holds.
    award: Option<u64>,
    /// Persons that hold the robot, have it in maintenance, or have raised an alarm.
    ordered_by: Vec<String>,
}

/// The log. Clones share the same states.
#[derive(Debug, Clone, Default)]
pub struct LedgerCopies(Arc<Mutex<Vec<CopyState>>>);

impl CopyState {
    /// Returns what a view states. `alarms` are the persons who have raised alarms, by the same copy or an earlier one.
    /// Returns `None` if the view is of no copy.
    fn of(robot: &RobotId, view: RobotView, alarms: &[String], at: Instant) -> Option<CopyState> {
        let revision = view.ledger?.revision;
        let epoch = view.node.holds.and_then(|held| held.epoch);
        let award = epoch.and_then(|epoch| epoch.rsplit_once('.')?.1.parse().ok());
        let orders = view.node.orders;
        let orders = orders.hold.into_iter().chain(orders.maintenance).map(|order| order.by);
        let ordered_by = orders.chain(alarms.iter().cloned()).collect();
        Some(CopyState { at, robot: robot.clone(), revision, award, ordered_by })
    }

    fn is_ordered_by(&self, person: &str) -> bool {
        self.ordered_by.iter().any(|by| by.contains(person))
    }
}

impl LedgerCopies {
    /// Records for ever what the copy of a node states about these robots while they are under orders.
    pub async fn record(self, bus: SharedBus, keys: Keys, node: NodeId, robots: Vec<RobotId>) {
        loop {
            let asked = Instant::now();
            let fleet: Option<FleetView> = view_of(&bus, &keys, &node, Key::ViewFleet).await;
            let alarms = fleet.and_then(|fleet| fleet.alarms).unwrap_or_default();
            let alarms: Vec<String> = alarms.into_iter().map(|alarm| alarm.order.by).collect();
            for robot in &robots {
                let view: Option<RobotView> = view_of(&bus, &keys, &node, Key::ViewRobot(robot.clone())).await;
                let state = view.and_then(|view| CopyState::of(robot, view, &alarms, Instant::now()));
                self.lock().extend(state.filter(|state| !state.ordered_by.is_empty()));
            }
            sleep_until(asked + INTERVAL).await;
        }
    }

    fn lock(&self) -> MutexGuard<'_, Vec<CopyState>> {
        // Each write is a single step.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Checks that a robot gets no role in the period in which an order of this person is in force. Returns the number of
    /// checked copies: those that show the order.
    ///
    /// # Errors
    /// Description of an award.
    pub fn check_no_award(&self, robot: &RobotId, person: &str, in_force: &Range<Instant>) -> Result<usize, String> {
        let log = self.lock();
        let shows_order =
            |state: &&CopyState| state.robot == *robot && state.at < in_force.end && state.is_ordered_by(person);
        // The order is in force from this entry on, and until each of these copies.
        let first = log.iter().filter(shows_order).map(|state| state.revision).min();
        let mut awards = log.iter().filter(shows_order).filter_map(|state| state.award);
        match first.and_then(|first| awards.find(|award| *award > first).map(|award| (award, first))) {
            Some((award, first)) => Err(format!(
                "{robot} got a role at {award} of the ledger, and is under orders of {person} since {first}"
            )),
            None => Ok(log.iter().filter(shows_order).count()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slug;
    use serde_json::{Value, json};
    use std::time::Duration;

    /// Returns the view of a robot by a copy.
    fn view(revision: u64, epoch: Option<&str>, orders: &Value) -> RobotView {
        let holds = epoch.map(|epoch| json!({ "mission": "lab-samples-1", "role": "r1", "epoch": epoch }));
        let ledger = json!({ "revision": revision, "age_ms": 0, "linearizable": false });
        let view = json!({ "node": "ada", "seen_by": "s1", "holds": holds, "orders": orders, "ledger": ledger });
        serde_json::from_value(view).unwrap()
    }

    fn order(by: &str) -> Value {
        json!({ "by": by, "reason": "soak", "since_ms": 1, "until_ms": null })
    }

    #[test]
    fn a_role_that_was_awarded_under_orders_is_found() {
        let (start, ada) = (Instant::now(), slug::<RobotId>("ada"));
        let at = |seconds| start + Duration::from_secs(seconds);
        let maintenance = json!({ "maintenance": order("person 1, attempt 1") });
        let raised = ["person 1, attempt 3".to_owned()];
        for (orders, alarms) in [(&maintenance, [].as_slice()), (&json!({}), raised.as_slice())] {
            let log = LedgerCopies::default();
            let add = |seconds, view, alarms: &[String]| {
                log.lock().extend(CopyState::of(&ada, view, alarms, at(seconds)));
            };
            let check = |person, until_s| log.check_no_award(&ada, person, &(start..at(until_s)));
            add(1, view(10, None, &json!({})), &[]);
            add(2, view(20, Some("2.15"), orders), alarms);
            add(3, view(18, Some("2.15"), orders), alarms);
            add(4, view(30, None, orders), alarms);
            assert_eq!(check("person 1,", 9), Ok(3), "it had the role");
            add(5, view(40, Some("3.35"), orders), alarms);
            assert_eq!(check("person 1,", 5), Ok(3), "the order ends");
            let violation = "ada got a role at 35 of the ledger, and is under orders of person 1, since 18";
            assert_eq!(check("person 1,", 9), Err(violation.to_owned()));
            assert_eq!(check("person 2,", 9), Ok(0));
            assert!(log.check_no_award(&slug("bob"), "person 1,", &(start..at(9))).is_ok());
        }
    }

    #[test]
    fn a_view_without_a_ledger_is_no_copy() {
        let view = RobotView { ledger: None, ..view(10, None, &json!({})) };
        assert_eq!(CopyState::of(&slug("ada"), view, &[], Instant::now()), None);
    }
}
