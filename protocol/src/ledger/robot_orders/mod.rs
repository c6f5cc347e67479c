//! Orders of people to robots in the ledger: hold and maintenance.
//!
//! A held robot stands still and keeps its role. A robot in maintenance finishes its role. Neither gets
//! another role. The coordinator sends the orders to the robots, and proposes the end of an order whose time
//! has passed, since a ledger has no clock.

use super::apply::Ledger;
use super::command::{CommandError, CommandOutcome};
use super::history::HISTORY_SINCE;
use super::robot_order::{ORDER_REQUESTS_MAX, ORDERS_BYTES_MAX, OrderRequest, RobotOrders};
use crate::codec;
use crate::ids::RobotId;
use crate::lease::Epoch;
use std::collections::{BTreeMap, BTreeSet};

impl Ledger {
    /// Returns the robots with orders, and their orders.
    pub fn robot_orders(&self) -> impl Iterator<Item = (&RobotId, &RobotOrders)> {
        self.order_book().robots.iter()
    }

    /// Returns the orders of a robot, if it has any.
    pub fn orders_of(&self, robot: &RobotId) -> Option<&RobotOrders> {
        self.order_book().robots.get(robot)
    }

    /// Checks whether a robot is held.
    pub fn is_held(&self, robot: &RobotId) -> bool {
        self.orders_of(robot).is_some_and(|orders| orders.hold.is_some())
    }

    /// Returns the position of the latest change of the orders to any robot; the default if there was none.
    pub fn orders_changed(&self) -> Epoch {
        self.order_book().changed
    }

    /// Checks whether the time of an order has passed.
    pub fn has_order_to_expire(&self, now_ms: u64) -> bool {
        let mut orders = self.robot_orders().flat_map(|(_, orders)| orders.hold.iter().chain(&orders.maintenance));
        orders.any(|order| order.is_over(now_ms))
    }

    /// Changes the orders of robots, of all or of none.
    pub(super) fn order_robots(
        &mut self,
        robots: &BTreeSet<RobotId>,
        order: &OrderRequest,
        at: Epoch,
    ) -> Result<CommandOutcome, CommandError> {
        if !self.keeps_history() {
            return Err(CommandError::NoOrdersYet { since: HISTORY_SINCE });
        }
        if order.request.as_ref().is_some_and(|request| self.order_book().requests.contains(request)) {
            return Ok(CommandOutcome::Done);
        }
        let mut changed = self.order_book().robots.clone();
        for robot in robots {
            changed.entry(robot.clone()).or_default().change(order);
        }
        changed.retain(|_, orders| !orders.is_empty());
        if size(&changed) > ORDERS_BYTES_MAX {
            return Err(CommandError::OrdersFull);
        }
        self.set_orders(changed, at);
        let requests = &mut self.order_book_mut().requests;
        requests.extend(order.request.clone());
        while requests.len() > ORDER_REQUESTS_MAX {
            requests.pop_front();
        }
        Ok(CommandOutcome::Done)
    }

    /// Ends the orders that have expired.
    pub(super) fn expire_orders(&mut self, now_ms: u64, at: Epoch) -> CommandOutcome {
        let mut changed = self.order_book().robots.clone();
        changed.values_mut().for_each(|orders| orders.expire(now_ms));
        changed.retain(|_, orders| !orders.is_empty());
        self.set_orders(changed, at);
        CommandOutcome::Done
    }

    fn set_orders(&mut self, robots: BTreeMap<RobotId, RobotOrders>, at: Epoch) {
        let book = self.order_book_mut();
        if book.robots != robots {
            book.robots = robots;
            book.changed = at;
        }
    }

    /// Checks that no order keeps a robot from getting a role.
    pub(super) fn check_takes_roles(&self, robot: &RobotId) -> Result<(), CommandError> {
        match self.orders_of(robot).and_then(RobotOrders::problem) {
            None => Ok(()),
            Some(problem) => Err(CommandError::UnderOrders { robot: robot.clone(), problem }),
        }
    }
}

/// Returns the encoded size of orders in bytes.
fn size(robots: &BTreeMap<RobotId, RobotOrders>) -> usize {
    robots.iter().map(|entry| codec::encoded_size(&entry)).sum()
}

#[cfg(test)]
mod tests;
