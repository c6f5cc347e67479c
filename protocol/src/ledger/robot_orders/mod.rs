//! Orders of people in the ledger: hold and maintenance of robots, closures and speed limits of zones, places and lanes,
//! and alarms.
//!
//! A held robot stands still and keeps its role. A robot in maintenance finishes its role. Neither gets
//! another role. No robot enters a closed zone, place or lane, or exceeds a speed limit. An alarm holds all robots,
//! except that they may drive to its assembly places, and closes the zones, places and lanes of its plan. The
//! coordinator sends the orders to the robots, and proposes the end of an order whose time has passed, since a ledger
//! has no clock.

use super::alarm::{Alarm, AlarmChange, alarm_size_problem};
use super::apply::Ledger;
use super::closure::{CLOSURES_BYTES_MAX, Closure, ClosureChange};
use super::command::CommandOutcome;
use super::command_error::CommandError;
use super::history::HISTORY_SINCE;
use super::map_part::MapPart;
use super::order_book::{ORDER_REQUESTS_MAX, Orders};
use super::robot_order::{ORDERS_BYTES_MAX, OrderRequest, RobotOrders};
use super::speed_limit::{SPEED_LIMITS_BYTES_MAX, SpeedLimit, SpeedLimitChange};
use crate::codec;
use crate::ids::{RequestId, RobotId};
use crate::lease::Epoch;
use serde::Serialize;
use std::collections::BTreeSet;

impl Ledger {
    /// Returns the robots with orders, and their orders.
    pub fn robot_orders(&self) -> impl Iterator<Item = (&RobotId, &RobotOrders)> {
        self.order_book().orders.robots.iter()
    }

    /// Returns the orders of a robot, if it has any.
    pub fn orders_of(&self, robot: &RobotId) -> Option<&RobotOrders> {
        self.order_book().orders.robots.get(robot)
    }

    /// Checks whether a robot is held, by a person or by an alarm.
    pub fn is_held(&self, robot: &RobotId) -> bool {
        self.has_alarm() || self.orders_of(robot).is_some_and(|orders| orders.hold.is_some())
    }

    /// Checks whether a robot gets no role because of an order or an alarm.
    pub fn is_under_orders(&self, robot: &RobotId) -> bool {
        self.check_takes_roles(robot).is_err()
    }

    /// Returns the position of the latest change of any order, or of [`held_items`](Self::held_items); the default if
    /// there was none.
    pub fn orders_changed(&self) -> Epoch {
        self.order_book().changed
    }

    /// Returns the closed zones, places and lanes, in this order and in that of their names.
    pub fn closures(&self) -> impl Iterator<Item = Closure> {
        let closures = self.order_book().orders.closures.iter();
        closures.map(|(part, order)| Closure { part: part.clone(), order: order.clone() })
    }

    /// Returns the speed limits, in the order of zones, places and lanes, and in that of their names.
    pub fn speed_limits(&self) -> impl Iterator<Item = SpeedLimit> {
        let limits = self.order_book().orders.speed_limits.iter();
        limits.map(|(part, (speed, order))| SpeedLimit { part: part.clone(), speed_mps: *speed, order: order.clone() })
    }

    /// Returns the alarms in force, in the order of their names.
    pub fn alarms(&self) -> impl Iterator<Item = &Alarm> {
        self.order_book().orders.alarms.values()
    }

    /// Checks whether an alarm is in force.
    pub fn has_alarm(&self) -> bool {
        !self.order_book().orders.alarms.is_empty()
    }

    /// Checks whether the time of an order has passed.
    pub fn has_order_to_expire(&self, now_ms: u64) -> bool {
        self.order_book().orders.has_expired(now_ms)
    }

    /// Changes the orders of robots, of all or of none.
    pub(super) fn order_robots(
        &mut self,
        robots: &BTreeSet<RobotId>,
        order: &OrderRequest,
        at: Epoch,
    ) -> Result<CommandOutcome, CommandError> {
        self.change_orders(order.request.as_ref(), at, |orders| {
            for robot in robots {
                orders.robots.entry(robot.clone()).or_default().change(order);
            }
            orders.robots.retain(|_, orders| !orders.is_empty());
        })
    }

    /// Closes or opens zones, places and lanes, all or none.
    pub(super) fn change_closures(
        &mut self,
        parts: &BTreeSet<MapPart>,
        order: &OrderRequest<ClosureChange>,
        at: Epoch,
    ) -> Result<CommandOutcome, CommandError> {
        self.change_orders(order.request.as_ref(), at, |orders| {
            orders.closures.retain(|closed, _| !parts.iter().any(|part| part.is_same(closed)));
            if let Some(closure) = order.closure() {
                orders.closures.extend(parts.iter().map(|part| (part.clone(), closure.clone())));
            }
        })
    }

    /// Sets or clears speed limits, all or none.
    pub(super) fn change_speed_limits(
        &mut self,
        parts: &BTreeSet<MapPart>,
        order: &OrderRequest<SpeedLimitChange>,
        at: Epoch,
    ) -> Result<CommandOutcome, CommandError> {
        self.change_orders(order.request.as_ref(), at, |orders| {
            orders.speed_limits.retain(|limited, _| !parts.iter().any(|part| part.is_same(limited)));
            if let Some(limit) = order.speed_limit() {
                orders.speed_limits.extend(parts.iter().map(|part| (part.clone(), limit.clone())));
            }
        })
    }

    /// Raises or clears alarms.
    pub(super) fn change_alarms(
        &mut self,
        order: &OrderRequest<AlarmChange>,
        at: Epoch,
    ) -> Result<CommandOutcome, CommandError> {
        self.change_orders(order.request.as_ref(), at, |orders| order.change_alarms(&mut orders.alarms))
    }

    /// Checks whether a request with this id is remembered: a copy of it changes nothing.
    pub fn remembers_order(&self, request: &RequestId) -> bool {
        self.order_book().requests.contains(request)
    }

    /// Executes a request of a person, and remembers its id. A copy of a remembered request changes nothing.
    pub(super) fn execute_once(
        &mut self,
        request: Option<&RequestId>,
        execute: impl FnOnce(&mut Ledger) -> Result<CommandOutcome, CommandError>,
    ) -> Result<CommandOutcome, CommandError> {
        if !self.keeps_history() {
            return Err(CommandError::NoOrdersYet { since: HISTORY_SINCE });
        }
        if request.is_some_and(|request| self.remembers_order(request)) {
            return Ok(CommandOutcome::Done);
        }
        let outcome = execute(self)?;
        let requests = &mut self.order_book_mut().requests;
        requests.extend(request.cloned());
        while requests.len() > ORDER_REQUESTS_MAX {
            requests.pop_front();
        }
        Ok(outcome)
    }

    /// Changes the orders on a request.
    fn change_orders(
        &mut self,
        request: Option<&RequestId>,
        at: Epoch,
        change: impl FnOnce(&mut Orders),
    ) -> Result<CommandOutcome, CommandError> {
        self.execute_once(request, |ledger| {
            let mut changed = ledger.order_book().orders.clone();
            change(&mut changed);
            if size(changed.robots.iter()) > ORDERS_BYTES_MAX {
                return Err(CommandError::OrdersFull);
            }
            if size(changed.closures.iter()) > CLOSURES_BYTES_MAX {
                return Err(CommandError::ClosuresFull);
            }
            if size(changed.speed_limits.iter()) > SPEED_LIMITS_BYTES_MAX {
                return Err(CommandError::SpeedLimitsFull);
            }
            if let Some(problem) = alarm_size_problem(changed.alarms.values().map(|alarm| &alarm.plan)) {
                return Err(CommandError::AlarmsFull { problem });
            }
            ledger.set_orders(changed, at);
            Ok(CommandOutcome::Done)
        })
    }

    /// Ends the orders that have expired.
    pub(super) fn expire_orders(&mut self, now_ms: u64, at: Epoch) -> CommandOutcome {
        let mut changed = self.order_book().orders.clone();
        changed.expire(now_ms);
        self.set_orders(changed, at);
        CommandOutcome::Done
    }

    /// Ends the orders to robots that have left the fleet.
    pub(super) fn end_orders(&mut self, robots: &BTreeSet<RobotId>, at: Epoch) -> CommandOutcome {
        let mut changed = self.order_book().orders.clone();
        changed.robots.retain(|robot, _| !robots.contains(robot));
        self.set_orders(changed, at);
        CommandOutcome::Done
    }

    fn set_orders(&mut self, orders: Orders, at: Epoch) {
        let book = self.order_book_mut();
        if book.orders != orders {
            book.orders = orders;
            book.changed = at;
        }
    }

    /// Checks that no order and no alarm keeps a robot from getting a role.
    pub(super) fn check_takes_roles(&self, robot: &RobotId) -> Result<(), CommandError> {
        let ordered = self.orders_of(robot).and_then(RobotOrders::problem);
        match ordered.or_else(|| self.alarms().next().map(Alarm::text)) {
            None => Ok(()),
            Some(problem) => Err(CommandError::UnderOrders { robot: robot.clone(), problem }),
        }
    }
}

/// Returns the encoded size of orders in bytes.
fn size<'a, K: Serialize + 'a, V: Serialize + 'a>(orders: impl Iterator<Item = (&'a K, &'a V)>) -> usize {
    orders.map(|entry| codec::encoded_size(&entry)).sum()
}

#[cfg(test)]
mod tests;
