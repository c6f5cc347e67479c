//! Closures: orders of people that no robot enters a place or a zone, or drives a lane.

use super::map_part::MapPart;
use super::robot_order::{OrderRequest, RobotOrder};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Maximum encoded size of all closures in bytes: a notice to a robot contains them all. Raised: a notice may be
/// too large for a message.
pub(super) const CLOSURES_BYTES_MAX: usize = 16 * 1024;

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

/// A closed zone, place or lane.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Closure {
    /// What is closed: `{"zone": {"name": …, "places": […]}}`, `{"place": …}` or `{"lane": […, …]}`.
    pub part: MapPart,
    /// Order that closed it: the person, the reason, and the times of its start and of its end.
    pub order: RobotOrder,
}

impl MapPart {
    /// Formats its state, as `IC Room 6 is closed by Nia: a spill`, or `IC Room 6 is open`.
    pub fn state_text(&self, closure: Option<&RobotOrder>) -> String {
        format!("{self} is {}", closure.map_or_else(|| "open".to_owned(), RobotOrder::closure_text))
    }
}

impl OrderRequest<ClosureChange> {
    /// Returns the order of what is closed; `None` if the request opens it.
    pub(super) fn closure(&self) -> Option<RobotOrder> {
        match &self.change {
            ClosureChange::Close { until_ms, reason } => Some(self.order(*until_ms, reason)),
            ClosureChange::Open => None,
        }
    }
}
