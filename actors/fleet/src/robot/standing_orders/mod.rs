//! The orders, closures and alarms of people that a robot follows, as last received. A robot without contact to the
//! coordinator follows them until their end.

use crate::recurrence::until_text;
use crate::robot_driver::MapOrders;
use consort_protocol::ids::PlaceId;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::MapPart;
use consort_protocol::message::{AlarmNotice, ClosureNotice, OrderNotice, OrdersNotice, SpeedLimitNotice};
use consort_protocol::units::{MetresPerSecond, NodeTime};
use std::collections::BTreeSet;
use std::time::Duration;

/// Time within which a coordinator that reaches a robot sends its orders. Until then a robot that has started leaves
/// its place only for a role. Raised: a robot without a coordinator charges later. A guess: some repetitions of a
/// notice.
const FIRST_NOTICE_WAIT: Duration = Duration::from_secs(10);

/// Least time for which a robot follows a hold, a closure or a speed limit that is not confirmed. The coordinator repeats it
/// more often.
const UNCONFIRMED_ORDER: Duration = Duration::from_secs(3);

/// Orders of people to this robot.
#[derive(Debug, Default)]
pub(super) struct StandingOrders {
    /// Position in the ledger of the latest notice.
    as_of: Epoch,
    hold: Option<StandingOrder>,
    /// Hold by a node that no poll has confirmed as the coordinator yet.
    unconfirmed_hold: Option<StandingOrder>,
    maintenance: Option<StandingOrder>,
    closures: Vec<StandingClosure>,
    /// Other closures by such a node.
    unconfirmed_closures: Vec<StandingClosure>,
    stay: Option<StandingOrder>,
    speed_limits: Vec<StandingSpeedLimit>,
    /// Speed limits by such a node.
    unconfirmed_limits: Vec<StandingSpeedLimit>,
    alarm: Option<StandingAlarm>,
    /// Time from which the robot may act without a role.
    acts_alone_from: NodeTime,
}

#[derive(Debug)]
struct StandingClosure {
    part: MapPart,
    order: StandingOrder,
}

#[derive(Debug)]
struct StandingSpeedLimit {
    part: MapPart,
    speed: MetresPerSecond,
    /// End of the limit; `None` for no end.
    until: Option<NodeTime>,
}

#[derive(Debug)]
struct StandingAlarm {
    order: StandingOrder,
    /// Assembly places; empty if the robot stands still.
    places: BTreeSet<PlaceId>,
    closes: BTreeSet<MapPart>,
}

#[derive(Debug)]
struct StandingOrder {
    text: String,
    /// End of the order; `None` for no end.
    until: Option<NodeTime>,
}

/// Returns the end of an order.
fn end_of(remaining_ms: Option<u64>, now: NodeTime) -> Option<NodeTime> {
    remaining_ms.map(|remaining_ms| now + Duration::from_millis(remaining_ms))
}

/// Lets an order end at this time, or before.
fn end_by(until: &mut Option<NodeTime>, end: NodeTime) {
    *until = Some(until.map_or(end, |until| until.min(end)));
}

/// Checks whether an order has not ended.
fn is_before_end(until: Option<NodeTime>, now: NodeTime) -> bool {
    until.is_none_or(|until| now < until)
}

impl StandingOrder {
    fn new(OrderNotice { text, remaining_ms }: OrderNotice, now: NodeTime) -> StandingOrder {
        StandingOrder { text, until: end_of(remaining_ms, now) }
    }

    fn is_in_force(&self, now: NodeTime) -> bool {
        is_before_end(self.until, now)
    }
}

impl StandingSpeedLimit {
    fn new(SpeedLimitNotice { part, speed, remaining_ms }: SpeedLimitNotice, now: NodeTime) -> StandingSpeedLimit {
        StandingSpeedLimit { part, speed, until: end_of(remaining_ms, now) }
    }
}

impl StandingClosure {
    fn new(ClosureNotice { part, mut order, until_ms }: ClosureNotice, now: NodeTime) -> StandingClosure {
        order.text = format!("{part} is {}{}", order.text, until_text(until_ms));
        StandingClosure { part, order: StandingOrder::new(order, now) }
    }
}

impl StandingAlarm {
    fn new(AlarmNotice { order, places, closes }: AlarmNotice, now: NodeTime) -> StandingAlarm {
        StandingAlarm { order: StandingOrder::new(order, now), places, closes }
    }
}

impl StandingOrders {
    /// Creates the orders of a robot that starts now: they are unknown.
    pub(super) fn new(now: NodeTime) -> StandingOrders {
        StandingOrders { acts_alone_from: now + FIRST_NOTICE_WAIT, ..StandingOrders::default() }
    }

    /// Receives the orders from the coordinator. A notice that is older than the latest has no effect.
    pub(super) fn receive(&mut self, notice: OrdersNotice, now: NodeTime) {
        let OrdersNotice { as_of, hold, maintenance, closures, stay, speed_limits, alarm } = notice;
        if as_of < self.as_of {
            return;
        }
        let standing = |order: Option<OrderNotice>| order.map(|order| StandingOrder::new(order, now));
        let (hold, maintenance, stay) = (standing(hold), standing(maintenance), standing(stay));
        let closures = closures.into_iter().map(|closure| StandingClosure::new(closure, now)).collect();
        let speed_limits = speed_limits.into_iter().map(|limit| StandingSpeedLimit::new(limit, now)).collect();
        let alarm = alarm.map(|alarm| StandingAlarm::new(alarm, now));
        *self = StandingOrders {
            as_of,
            hold,
            maintenance,
            closures,
            stay,
            speed_limits,
            alarm,
            acts_alone_from: now,
            ..StandingOrders::default()
        };
    }

    /// Receives orders from a node that may be the coordinator: for a short time a hold, a new alarm, or an alarm that stops
    /// robots lets the robot stand still, and closures and speed limits count, but nothing else. They outlast the `lease`
    /// that the robot may have received with them.
    pub(super) fn receive_unconfirmed(&mut self, notice: &OrdersNotice, lease: Duration, now: NodeTime) {
        let end = now + UNCONFIRMED_ORDER.max(lease);
        let is_new = self.alarm_in_force(now).is_none();
        let stops = |alarm: &&AlarmNotice| is_new || alarm.places.is_empty();
        let alarm = notice.alarm.as_ref().filter(stops).map(|alarm| &alarm.order);
        let hold = notice.hold.as_ref().or(alarm);
        self.unconfirmed_hold = hold.cloned().map(|hold| StandingOrder::new(hold, now));
        let is_other = |closure: &&ClosureNotice| self.closures.iter().all(|known| known.part != closure.part);
        let others = notice.closures.iter().filter(is_other).cloned();
        self.unconfirmed_closures = others.map(|closure| StandingClosure::new(closure, now)).collect();
        let of_closures = self.unconfirmed_closures.iter_mut().map(|closure| &mut closure.order);
        self.unconfirmed_hold.iter_mut().chain(of_closures).for_each(|order| end_by(&mut order.until, end));
        let limits = notice.speed_limits.iter().cloned().map(|limit| StandingSpeedLimit::new(limit, now));
        self.unconfirmed_limits = limits.collect();
        self.unconfirmed_limits.iter_mut().for_each(|limit| end_by(&mut limit.until, end));
    }

    /// Accepts any position from now on: the ledger of a new leader contains everything that was committed before, and
    /// a position that only the former leader stated counts no longer.
    pub(super) fn change_session(&mut self) {
        self.as_of = Epoch::default();
    }

    /// Waits for a notice before the robot acts without a role: it has lost its role, perhaps with an item.
    pub(super) fn await_notice(&mut self, now: NodeTime) {
        self.acts_alone_from = self.acts_alone_from.max(now + FIRST_NOTICE_WAIT);
    }

    /// Accepts any position from now on: the positions of another cluster are counted anew. A cluster without orders
    /// sends none, and its people cannot end those of the former one: they end by themselves.
    pub(super) fn change_cluster(&mut self, now: NodeTime) {
        self.change_session();
        let end = now + FIRST_NOTICE_WAIT;
        let of_closures = self.closures.iter_mut().map(|closure| &mut closure.order);
        let of_alarm = self.alarm.iter_mut().map(|alarm| &mut alarm.order);
        let others = of_closures.chain(of_alarm);
        let orders = self.hold.iter_mut().chain(&mut self.maintenance).chain(&mut self.stay).chain(others);
        let ends = orders.map(|order| &mut order.until);
        for until in ends.chain(self.speed_limits.iter_mut().map(|limit| &mut limit.until)) {
            end_by(until, end);
        }
    }

    /// Returns the reason for which the robot must not leave its place by itself, as `has the parcel of fetch-1`.
    pub(super) fn reason_to_stay(&self, now: NodeTime) -> Option<&str> {
        self.stay.as_ref().filter(|stay| stay.is_in_force(now)).map(|stay| stay.text.as_str())
    }

    /// Checks whether the robot may act without a role: a coordinator has sent its orders, or none does.
    pub(super) fn may_act_alone(&self, now: NodeTime) -> bool {
        now >= self.acts_alone_from
    }

    /// Checks whether the plan of the robot is suspended: it has to stand still, or to drive to an assembly place.
    pub(super) fn is_held(&self, now: NodeTime) -> bool {
        self.holds(now).next().is_some() || self.alarm_in_force(now).is_some()
    }

    /// Returns the places to one of which the robot has to drive; `None` if it has to stand still, or to go on.
    pub(super) fn assembly_places(&self, now: NodeTime) -> Option<&BTreeSet<PlaceId>> {
        let alarm = self.alarm_in_force(now).filter(|_| self.holds(now).next().is_none());
        alarm.map(|alarm| &alarm.places).filter(|places| !places.is_empty())
    }

    /// Checks whether the robot is in maintenance.
    pub(super) fn is_in_maintenance(&self, now: NodeTime) -> bool {
        self.maintenance.as_ref().is_some_and(|order| order.is_in_force(now))
    }

    /// Returns the closed lanes by their ends, and each closed place twice, also those of closed zones.
    pub(super) fn closed(&self, now: NodeTime) -> Vec<(PlaceId, PlaceId)> {
        let of_alarm = self.alarm_in_force(now).into_iter().flat_map(|alarm| &alarm.closes);
        self.closures_in_force(now).map(|closure| &closure.part).chain(of_alarm).flat_map(MapPart::pairs).collect()
    }

    /// Returns the orders about the map.
    pub(super) fn map_orders(&self, now: NodeTime) -> MapOrders {
        let limits = self.speed_limits.iter().chain(&self.unconfirmed_limits);
        let limits = limits.filter(|limit| is_before_end(limit.until, now));
        let of_limit = |limit: &StandingSpeedLimit| {
            let speed = limit.speed;
            limit.part.pairs().into_iter().map(move |lane| (lane, speed))
        };
        MapOrders { closed: self.closed(now), limits: limits.flat_map(of_limit).collect(), speed: None }
    }

    /// Returns the closures, each as `IC Room 6 is closed by Nia: a spill, until 2026-12-31 17:00 UTC`.
    pub(super) fn closure_texts(&self, now: NodeTime) -> Vec<&str> {
        self.closures_in_force(now).map(|closure| closure.order.text.as_str()).collect()
    }

    fn holds(&self, now: NodeTime) -> impl Iterator<Item = &StandingOrder> {
        self.hold.iter().chain(&self.unconfirmed_hold).filter(move |hold| hold.is_in_force(now))
    }

    fn alarm_in_force(&self, now: NodeTime) -> Option<&StandingAlarm> {
        self.alarm.as_ref().filter(|alarm| alarm.order.is_in_force(now))
    }

    fn closures_in_force(&self, now: NodeTime) -> impl Iterator<Item = &StandingClosure> {
        self.closures.iter().chain(&self.unconfirmed_closures).filter(move |closure| closure.order.is_in_force(now))
    }

    /// Returns the order for which the robot takes no role, as text; `None` if there is none.
    pub(super) fn problem(&self, now: NodeTime) -> Option<&str> {
        let alarm = self.alarm_in_force(now).map(|alarm| &alarm.order);
        let maintenance = self.maintenance.as_ref().filter(|order| order.is_in_force(now));
        self.holds(now).chain(alarm).chain(maintenance).next().map(|order| order.text.as_str())
    }
}

#[cfg(test)]
mod tests;
