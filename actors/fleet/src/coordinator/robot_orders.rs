//! Orders of people during a session: the coordinator sends them to the robots with the closures and alarms, publishes
//! the changes of all of them, and proposes the end of orders whose time has passed, or whose robot has left the fleet.
//!
//! A robot that holds a role also gets its orders with each renewal of its lease.

use super::session_context::SessionContext;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{AlarmId, NodeId, RobotId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Alarm, Closure, Command, Ledger, RobotOrders};
use consort_protocol::message::OrdersNotice;
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Interval for repeating a notice that a robot has not acknowledged, and of proposals to end orders.
const RETRY_INTERVAL: Duration = Duration::from_millis(500);

/// Interval of the search for robots that need a notice, while no orders change.
const CHECK_INTERVAL: Duration = Duration::from_millis(100);

/// Interval for repeating the orders of a robot that has acknowledged them: its node may have restarted.
/// A guess.
const REPEAT_INTERVAL: Duration = Duration::from_secs(2);

/// Orders during a session.
pub(super) struct OrderDelivery {
    sent: BTreeMap<RobotId, SentOrders>,
    /// Orders when they were last compared, and the position of their latest change.
    published: PublishedOrders,
    position: Epoch,
    /// Time of the latest search for robots that need a notice.
    checked_at: NodeTime,
    /// Time of the latest proposal to end orders.
    ended_at: Option<NodeTime>,
}

/// Orders as last published: the next changes are found by comparison.
struct PublishedOrders {
    robots: BTreeMap<RobotId, RobotOrders>,
    /// Closures by their texts: a closed zone is the same if its places change.
    closures: BTreeMap<String, Closure>,
    alarms: BTreeMap<AlarmId, Alarm>,
}

impl PublishedOrders {
    fn of(ledger: &Ledger) -> PublishedOrders {
        PublishedOrders {
            robots: ledger.robot_orders().map(|(robot, orders)| (robot.clone(), orders.clone())).collect(),
            closures: ledger.closures().map(|closure| (closure.part.to_string(), closure)).collect(),
            alarms: ledger.alarms().map(|alarm| (alarm.alarm.clone(), alarm.clone())).collect(),
        }
    }

    /// Returns the changes from these orders to the `present` ones.
    fn changes(&self, present: &PublishedOrders) -> Vec<EventKind> {
        let robots = changes(&self.robots, &present.robots).map(|(robot, orders)| EventKind::RobotOrders {
            robot: robot.clone(),
            orders: orders.cloned().unwrap_or_default(),
        });
        let closures = changes(&self.closures, &present.closures).filter_map(|(text, closure)| {
            let part = closure.or_else(|| self.closures.get(text))?.part.clone();
            Some(EventKind::ClosureChanged { part, order: closure.map(|closure| closure.order.clone()) })
        });
        let alarms = changes(&self.alarms, &present.alarms)
            .map(|(alarm, raised)| EventKind::AlarmChanged { alarm: alarm.clone(), raised: raised.cloned() });
        robots.chain(closures).chain(alarms).collect()
    }
}

/// Latest notice to a robot.
struct SentOrders {
    as_of: Epoch,
    /// True if it contains an order, a closure or an alarm.
    has_orders: bool,
    at: NodeTime,
    is_acknowledged: bool,
}

impl SentOrders {
    /// Checks whether the robot needs another notice. `position` is that of the latest change of any order.
    fn needs_repetition(&self, position: Epoch, now: NodeTime) -> bool {
        let age = now.since(self.at);
        match self.is_acknowledged {
            _ if self.as_of != position => true,
            false => age >= RETRY_INTERVAL,
            true => self.has_orders && age >= REPEAT_INTERVAL,
        }
    }
}

impl OrderDelivery {
    /// Creates the state of a session. Orders that are in the ledger before the session are not published.
    pub(super) fn new(context: &SessionContext) -> OrderDelivery {
        let (published, position) =
            context.read_ledger(|ledger| (PublishedOrders::of(ledger), ledger.orders_changed()));
        OrderDelivery { sent: BTreeMap::new(), published, position, checked_at: NodeTime::ZERO, ended_at: None }
    }

    /// Sends and publishes the orders that have changed. `confirmed_ms` is the time of day that a majority of the
    /// voters confirms, in milliseconds since 1970.
    pub(super) fn follow(&mut self, context: &mut SessionContext, now: NodeTime, confirmed_ms: Option<u64>) {
        let position = context.read_ledger(Ledger::orders_changed);
        let has_changed = position != self.position;
        if has_changed {
            self.position = position;
            self.publish(context);
        }
        // A ledger that never had orders has none to send.
        if position == Epoch::default() || !has_changed && now.since(self.checked_at) < CHECK_INTERVAL {
            return;
        }
        self.checked_at = now;
        for (robot, notice) in self.due(context, now, confirmed_ms) {
            context.notify_orders(robot, notice);
        }
        let may_propose = self.ended_at.is_none_or(|at| now.since(at) >= RETRY_INTERVAL);
        if let Some(command) = may_propose.then(|| end_of_orders(context, confirmed_ms)).flatten() {
            self.ended_at = Some(now);
            context.propose(command);
        }
    }

    /// Records that a robot has acknowledged the notice of this position.
    pub(super) fn acknowledge(&mut self, robot: &RobotId, as_of: Epoch) {
        if let Some(sent) = self.sent.get_mut(robot).filter(|sent| sent.as_of == as_of) {
            sent.is_acknowledged = true;
        }
    }

    /// Returns the notices that are due, to robots that this node can reach.
    fn due(
        &mut self,
        context: &SessionContext,
        now: NodeTime,
        confirmed_ms: Option<u64>,
    ) -> Vec<(RobotId, OrdersNotice)> {
        let parts = &context.settings.parts;
        let robots: Vec<NodeId> = parts.knowledge.read(|base| {
            let robots = base.iter().filter(|(_, stored)| stored.record.knowledge.robot.is_some());
            robots.map(|(node, _)| node.clone()).collect()
        });
        let mut due = vec![];
        for node in robots.into_iter().filter(|node| *node == parts.node || parts.knowledge.is_alive(node)) {
            let robot = RobotId::from(node);
            if self.sent.get(&robot).is_none_or(|sent| sent.needs_repetition(self.position, now)) {
                let notice = context.read_ledger(|ledger| OrdersNotice::of(ledger, &robot, confirmed_ms));
                let (as_of, has_orders) = (notice.as_of, !notice.is_empty());
                self.sent.insert(robot.clone(), SentOrders { as_of, has_orders, at: now, is_acknowledged: false });
                due.push((robot, notice));
            }
        }
        due
    }

    /// Publishes the orders and closures that have changed since the last comparison.
    fn publish(&mut self, context: &SessionContext) {
        let present = context.read_ledger(PublishedOrders::of);
        for event in self.published.changes(&present) {
            context.publish_event(event);
        }
        self.published = present;
    }
}

/// Returns the command that ends orders to robots that have left the fleet, or orders whose time has passed.
fn end_of_orders(context: &SessionContext, confirmed_ms: Option<u64>) -> Option<Command> {
    let knowledge = &context.settings.parts.knowledge;
    let ordered: Vec<NodeId> =
        context.read_ledger(|ledger| ledger.robot_orders().map(|(robot, _)| NodeId::from(robot.clone())).collect());
    let leaving: Vec<NodeId> = knowledge.read(|base| {
        let is_leaving = |node: &NodeId| base.get(node).is_some_and(|known| known.record.knowledge.leaving);
        ordered.into_iter().filter(is_leaving).collect()
    });
    let robots: BTreeSet<RobotId> =
        leaving.into_iter().filter(|node| !knowledge.is_alive(node)).map(RobotId::from).collect();
    if !robots.is_empty() {
        return Some(Command::EndOrders { robots });
    }
    let now_ms = confirmed_ms?;
    context.read_ledger(|ledger| ledger.has_order_to_expire(now_ms)).then_some(Command::ExpireOrders { now_ms })
}

/// Returns the keys with changed values, each with its present value.
fn changes<'a, K: Ord, V: PartialEq>(
    before: &'a BTreeMap<K, V>,
    present: &'a BTreeMap<K, V>,
) -> impl Iterator<Item = (&'a K, Option<&'a V>)> {
    let keys: BTreeSet<&K> = before.keys().chain(present.keys()).collect();
    let changed = keys.into_iter().filter(move |key| before.get(*key) != present.get(*key));
    changed.map(move |key| (key, present.get(key)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::ledger::{MapPart, RobotOrder, Zone};

    fn at(ms: u64) -> NodeTime {
        NodeTime::at(Duration::from_millis(ms))
    }

    #[test]
    fn a_notice_is_repeated_until_it_is_acknowledged_and_rarely_afterwards() {
        let [held, released] = [5, 6].map(|index| Epoch { term: 1, index });
        let mut sent = SentOrders { as_of: held, has_orders: true, at: at(0), is_acknowledged: false };
        assert!(!sent.needs_repetition(held, at(499)) && sent.needs_repetition(held, at(500)));
        assert!(sent.needs_repetition(released, at(1)), "released");
        sent.is_acknowledged = true;
        assert!(!sent.needs_repetition(held, at(1_999)) && sent.needs_repetition(held, at(2_000)));
        let without = SentOrders { has_orders: false, ..sent };
        assert!(!without.needs_repetition(held, at(9_000)));
        assert!(without.needs_repetition(released, at(1)));
    }

    #[test]
    fn a_zone_that_is_closed_again_with_other_places_changes_once() {
        let published = |places: &[&str], reason: &str| {
            let places = places.iter().map(|name| name.parse().unwrap()).collect();
            let part = MapPart::Zone(Zone { name: "icu".parse().unwrap(), places });
            let order = RobotOrder { by: "Nia".to_owned(), reason: reason.to_owned(), since_ms: 1, until_ms: None };
            let closures = BTreeMap::from([(part.to_string(), Closure { part, order })]);
            PublishedOrders { robots: BTreeMap::new(), closures, alarms: BTreeMap::new() }
        };
        let (before, present) = (published(&["A"], "smoke"), published(&["B"], "fire"));
        let Closure { part, order } = present.closures["zone icu"].clone();
        let closed = EventKind::ClosureChanged { part: part.clone(), order: Some(order) };
        assert_eq!(before.changes(&present), [closed]);
        let open = PublishedOrders { robots: BTreeMap::new(), closures: BTreeMap::new(), alarms: BTreeMap::new() };
        assert_eq!(present.changes(&open), [EventKind::ClosureChanged { part, order: None }]);
    }
}
