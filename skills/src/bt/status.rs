//! What a tick of a node comes to.

/// The answer of a ticked node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NodeStatus {
    /// Not done yet: tick again.
    Running,
    /// Done, as intended.
    Success,
    /// Done, without success.
    Failure,
}

impl NodeStatus {
    /// Whether the node has ended and will start afresh at its next tick.
    pub fn is_final(self) -> bool {
        self != NodeStatus::Running
    }
}
