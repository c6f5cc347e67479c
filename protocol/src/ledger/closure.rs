//! Closures: orders of people that no robot enters a place, or drives a lane.

use super::robot_order::{OrderRequest, RobotOrder};
use crate::ids::PlaceId;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Maximum encoded size of all closures in bytes: a notice to a robot contains them all. Raised: a notice may be
/// too large for a message.
pub(super) const CLOSURES_BYTES_MAX: usize = 16 * 1024;

/// A place of the map, or the lane between two of them.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
pub struct ClosedPart {
    /// The place, or the end of the lane whose name comes first.
    pub place: PlaceId,
    /// The other end of the lane; null for a place.
    pub to: Option<PlaceId>,
}

/// Change of the closures.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum ClosureChange {
    /// Close them. The latest closure of a part counts.
    Close {
        /// End of the closure, in milliseconds since 1970; `None` for no end.
        until_ms: Option<u64>,
        /// Reason, for people; may be empty.
        reason: String,
    },
    /// Open them.
    Open,
}

/// A closed place or lane.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Closure {
    /// The place or lane.
    pub part: ClosedPart,
    /// Order that closed it: the person, the reason, and the times of its start and of its end.
    pub order: RobotOrder,
}

impl ClosedPart {
    /// Returns a place.
    pub fn of_place(place: PlaceId) -> ClosedPart {
        ClosedPart { place, to: None }
    }

    /// Returns the lane between two places, in both directions.
    pub fn of_lane(a: PlaceId, b: PlaceId) -> ClosedPart {
        let (place, to) = if a <= b { (a, b) } else { (b, a) };
        ClosedPart { place, to: Some(to) }
    }

    /// Returns the two ends of a lane, or a place twice.
    pub fn ends(&self) -> (PlaceId, PlaceId) {
        (self.place.clone(), self.to.clone().unwrap_or_else(|| self.place.clone()))
    }
}

impl fmt::Display for ClosedPart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.to {
            None => write!(f, "{}", self.place),
            Some(to) => write!(f, "{} – {to}", self.place),
        }
    }
}

impl OrderRequest<ClosureChange> {
    /// Returns the order of a closed part; `None` if the request opens it.
    pub(super) fn closure(&self) -> Option<RobotOrder> {
        match &self.change {
            ClosureChange::Close { until_ms, reason } => Some(self.order(*until_ms, reason)),
            ClosureChange::Open => None,
        }
    }
}
