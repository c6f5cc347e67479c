//! Speed limits: orders of people that robots drive slower in a zone, at a place or on a lane.

use super::map_part::MapPart;
use super::robot_order::{OrderRequest, RobotOrder};
use crate::units::MetresPerSecond;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Maximum encoded size of all speed limits in bytes: a notice to a robot contains them all. Raised: a notice may be
/// too large for a message.
pub(super) const SPEED_LIMITS_BYTES_MAX: usize = 4 * 1024;

/// Change of the speed limits.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum SpeedLimitChange {
    /// Set them. The latest limit of a part counts.
    Set {
        /// The highest allowed speed.
        speed: MetresPerSecond,
        /// End of the limit, in milliseconds since 1970; `None` for no end.
        until_ms: Option<u64>,
        /// Reason, for people; may be empty.
        reason: String,
    },
    /// Clear them.
    Clear,
}

/// A speed limit.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SpeedLimit {
    /// Where it holds: `{"zone": {"name": …, "places": […]}}`, `{"place": …}` or `{"lane": […, …]}`.
    pub part: MapPart,
    /// The highest allowed speed in metres per second.
    pub speed_mps: MetresPerSecond,
    /// Person, reason and end of the limit.
    pub order: RobotOrder,
}

impl SpeedLimit {
    /// Formats it, as `IC Room 6 is limited to 0.3 m/s by Nia: wet floor`.
    pub fn text(&self) -> String {
        let SpeedLimit { part, speed_mps, order } = self;
        format!("{part} is limited to {} m/s by {}{}", speed_mps.get(), order.by, order.reason_text())
    }
}

impl OrderRequest<SpeedLimitChange> {
    /// Returns the speed limit and its order; `None` if the request clears it.
    pub(super) fn speed_limit(&self) -> Option<(MetresPerSecond, RobotOrder)> {
        match &self.change {
            SpeedLimitChange::Set { speed, until_ms, reason } => Some((*speed, self.order(*until_ms, reason))),
            SpeedLimitChange::Clear => None,
        }
    }
}
