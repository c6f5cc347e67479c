//! Orders of people to a robot: hold and maintenance.

use crate::ids::RequestId;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Maximum encoded size of all orders to robots in bytes. Raised: a snapshot may be too large for every replica.
pub(super) const ORDERS_BYTES_MAX: usize = 160 * 1024;

/// Request of a person that changes orders: those to robots, closures, speed limits, or alarms.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OrderRequest<Change = OrderChange> {
    /// The change.
    pub change: Change,
    /// Person that requests it.
    pub by: String,
    /// Time of the request in milliseconds since 1970.
    pub at_ms: u64,
    /// Id of the request, if it has one: a copy of it changes nothing, even if other orders followed. In a closed fleet a
    /// request without an id has that of its signature.
    pub request: Option<RequestId>,
}

/// Change of the orders to robots.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum OrderChange {
    /// Hold them. The latest hold of a robot counts.
    Hold {
        /// End of the hold, in milliseconds since 1970.
        until_ms: u64,
        /// Reason, for people; may be empty.
        reason: String,
    },
    /// End their holds.
    Release,
    /// Take them out of service once their roles have ended. The latest order counts.
    Maintain {
        /// End of the maintenance, in milliseconds since 1970; `None` for no end.
        until_ms: Option<u64>,
        /// Reason, for people.
        reason: String,
    },
    /// End their maintenance.
    EndMaintenance,
}

/// Orders of people to a robot.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RobotOrders {
    /// The robot stands still, and keeps its role.
    #[serde(default)]
    pub hold: Option<RobotOrder>,
    /// The robot finishes its role, and gets no other.
    #[serde(default)]
    pub maintenance: Option<RobotOrder>,
}

/// Order of a person.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RobotOrder {
    /// Person that gave the order; in a closed fleet the signer.
    pub by: String,
    /// Reason, for people; may be empty.
    pub reason: String,
    /// Time of the order, in milliseconds since 1970.
    pub since_ms: u64,
    /// Time at which it ends by itself, in milliseconds since 1970; null for no end.
    pub until_ms: Option<u64>,
}

impl<Change> OrderRequest<Change> {
    /// Returns an order of this request.
    pub(super) fn order(&self, until_ms: Option<u64>, reason: &str) -> RobotOrder {
        RobotOrder { by: self.by.clone(), reason: reason.to_owned(), since_ms: self.at_ms, until_ms }
    }
}

impl RobotOrder {
    /// Checks whether its time has passed.
    pub(super) fn is_over(&self, now_ms: u64) -> bool {
        self.until_ms.is_some_and(|until_ms| until_ms <= now_ms)
    }

    /// Returns the reason after a colon; empty without a reason.
    pub(super) fn reason_text(&self) -> String {
        if self.reason.is_empty() { String::new() } else { format!(": {}", self.reason) }
    }

    /// Formats a hold, as `held by Nia: a spill`.
    pub fn hold_text(&self) -> String {
        format!("held by {}{}", self.by, self.reason_text())
    }

    /// Formats a closure, as `closed by Nia: a spill`.
    pub fn closure_text(&self) -> String {
        format!("closed by {}{}", self.by, self.reason_text())
    }

    /// Formats a maintenance, as `in maintenance by Nia: new tyres`.
    pub fn maintenance_text(&self) -> String {
        format!("in maintenance by {}{}", self.by, self.reason_text())
    }
}

impl RobotOrders {
    /// Checks whether there are none.
    pub fn is_empty(&self) -> bool {
        self.hold.is_none() && self.maintenance.is_none()
    }

    /// Returns the reason for which the robot gets no role, as text; `None` if there are no orders.
    pub fn problem(&self) -> Option<String> {
        (!self.is_empty()).then(|| self.state_text())
    }

    /// Formats the orders in force, as `held by Nia: a spill; in maintenance by Nia: new tyres`.
    pub fn state_text(&self) -> String {
        let hold = self.hold.as_ref().map(RobotOrder::hold_text);
        let maintenance = self.maintenance.as_ref().map(RobotOrder::maintenance_text);
        let orders: Vec<String> = hold.into_iter().chain(maintenance).collect();
        if orders.is_empty() { "under no orders".to_owned() } else { orders.join("; ") }
    }

    /// Returns the orders in force.
    pub(super) fn iter(&self) -> impl Iterator<Item = &RobotOrder> {
        self.hold.iter().chain(&self.maintenance)
    }

    /// Removes the orders that have expired.
    pub(super) fn expire(&mut self, now_ms: u64) {
        self.hold.take_if(|order| order.is_over(now_ms));
        self.maintenance.take_if(|order| order.is_over(now_ms));
    }

    pub(super) fn change(&mut self, request: &OrderRequest) {
        let order = |until_ms, reason: &str| Some(request.order(until_ms, reason));
        match &request.change {
            OrderChange::Hold { until_ms, reason } => self.hold = order(Some(*until_ms), reason),
            OrderChange::Release => self.hold = None,
            OrderChange::Maintain { until_ms, reason } => self.maintenance = order(*until_ms, reason),
            OrderChange::EndMaintenance => self.maintenance = None,
        }
    }
}
