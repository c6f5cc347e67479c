//! The orders of people in force, as the ledger stores them.

use super::alarm::Alarm;
use super::map_part::MapPart;
use super::robot_order::{RobotOrder, RobotOrders};
use crate::ids::{AlarmId, RequestId, RobotId};
use crate::lease::Epoch;
use crate::units::MetresPerSecond;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};

/// Maximum number of remembered requests. Raised: more requests that follow each other within minutes are
/// recognised when they are repeated.
pub(super) const ORDER_REQUESTS_MAX: usize = 256;

/// Maximum encoded size of the remembered requests in bytes.
pub(super) const ORDER_REQUESTS_BYTES_MAX: usize = ORDER_REQUESTS_MAX * 80;

/// The orders in the ledger.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct OrderBook {
    /// Position in the log of the latest change, also of the items for which robots must stay at their places.
    pub(super) changed: Epoch,
    /// The orders in force.
    pub(super) orders: Orders,
    /// The latest requests with an id.
    pub(super) requests: VecDeque<RequestId>,
}

/// Orders in force.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Orders {
    /// Orders of each robot that has any.
    pub(super) robots: BTreeMap<RobotId, RobotOrders>,
    /// Closed zones, places and lanes. No zone is contained twice.
    pub(super) closures: BTreeMap<MapPart, RobotOrder>,
    /// Speed limits in zones, at places and on lanes. No zone is contained twice.
    pub(super) speed_limits: BTreeMap<MapPart, (MetresPerSecond, RobotOrder)>,
    /// Alarms in force. They have no end.
    pub(super) alarms: BTreeMap<AlarmId, Alarm>,
}

impl Orders {
    /// Checks whether the time of an order has passed.
    pub(super) fn has_expired(&self, now_ms: u64) -> bool {
        let of_map = self.closures.values().chain(self.speed_limits.values().map(|(_, order)| order));
        self.robots.values().flat_map(RobotOrders::iter).chain(of_map).any(|order| order.is_over(now_ms))
    }

    /// Removes expired orders.
    pub(super) fn expire(&mut self, now_ms: u64) {
        self.robots.values_mut().for_each(|orders| orders.expire(now_ms));
        self.robots.retain(|_, orders| !orders.is_empty());
        self.closures.retain(|_, order| !order.is_over(now_ms));
        self.speed_limits.retain(|_, (_, order)| !order.is_over(now_ms));
    }
}
