//! The interface of nodes in a running tree, and the wrapper in which a parent stores a child.

use super::status::NodeStatus;
use super::tick::Tick;

/// A node of a running tree. It starts from the beginning at the first tick after it ended or was
/// halted.
pub(crate) trait Node: Send {
    /// Continues the execution and returns its status.
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus;

    /// Stops the execution, children included. Called only while the node is running.
    fn halt(&mut self, tick: &mut Tick<'_>);
}

/// A child node. It records whether the child is running, so that an idle child is never halted.
pub(crate) struct ChildNode {
    node: Box<dyn Node>,
    running: bool,
}

impl ChildNode {
    pub(crate) fn new(node: Box<dyn Node>) -> ChildNode {
        ChildNode { node, running: false }
    }

    pub(crate) fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        let status = self.node.tick(tick);
        self.running = status == NodeStatus::Running;
        status
    }

    pub(crate) fn halt(&mut self, tick: &mut Tick<'_>) {
        if std::mem::take(&mut self.running) {
            self.node.halt(tick);
        }
    }

    pub(crate) fn is_running(&self) -> bool {
        self.running
    }
}

/// Halts every running child, first to last.
pub(crate) fn halt_all(children: &mut [ChildNode], tick: &mut Tick<'_>) {
    for child in children {
        child.halt(tick);
    }
}
