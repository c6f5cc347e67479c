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
}

impl NodeStatus {
    /// Checks whether the node has ended and will start from the beginning at its next tick.
    pub(crate) fn is_final(self) -> bool {
        self != NodeStatus::Running
    }
}
