//! Status of an active coordinator, for the views of its node.

use consort_protocol::view::AutopilotView;

/// Status of an active coordinator.
#[derive(Debug, Clone)]
pub(crate) struct CoordinatorStatus {
    /// Its term.
    pub term: u64,
    /// Duration of its session in milliseconds.
    pub since_ms: u64,
    /// Status of its autopilot.
    pub autopilot: AutopilotView,
}
