//! Status of a node after a tick.

/// Status that a tick returns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NodeStatus {
    /// Not complete: tick again.
    Running,
    /// Complete, with success.
    Success,
    /// Complete, without success.
    Failure,
    /// Not executed, because a precondition excludes it now. The parent continues as if the node
    /// were absent.
    Skipped,
}

impl NodeStatus {
    /// Checks whether the node was executed to its end: it succeeded or failed.
    pub(crate) fn is_completed(self) -> bool {
        matches!(self, NodeStatus::Success | NodeStatus::Failure)
    }
}
