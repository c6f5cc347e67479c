//! What every node of a running tree is, and the slot in which its parent keeps it.

use super::status::NodeStatus;
use super::tick::Tick;

/// A node at work. It starts afresh at the first tick after it ended or was halted.
pub(crate) trait Node: Send {
    /// Goes on, and says how far it came.
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus;

    /// Stops what is under way, children included. Called only while the node is running.
    fn halt(&mut self, tick: &mut Tick<'_>);
}

/// A child in its parent: knows whether it is running, so that nothing idle is ever halted.
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

/// Halts every child that is running, first to last.
pub(crate) fn halt_all(children: &mut [ChildNode], tick: &mut Tick<'_>) {
    for child in children {
        child.halt(tick);
    }
}
