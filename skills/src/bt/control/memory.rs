//! `Sequence` and `Fallback`: control nodes with memory, which tick their children in turn.

use crate::bt::node::{ChildNode, Node, halt_all};
use crate::bt::status::NodeStatus;
use crate::bt::tick::Tick;

/// Ticks children in order while they return `continue_on`; any other final status ends the node.
/// The next tick continues with the running child; earlier children are not ticked again.
pub(crate) struct MemoryControl {
    continue_on: NodeStatus,
    children: Vec<ChildNode>,
    current: usize,
}

impl MemoryControl {
    /// Succeeds when all children succeed, and fails with the first failure.
    pub(crate) fn sequence(children: Vec<ChildNode>) -> MemoryControl {
        MemoryControl { continue_on: NodeStatus::Success, children, current: 0 }
    }

    /// Succeeds with the first success, and fails when all children fail.
    pub(crate) fn fallback(children: Vec<ChildNode>) -> MemoryControl {
        MemoryControl { continue_on: NodeStatus::Failure, children, current: 0 }
    }
}

impl Node for MemoryControl {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        while let Some(child) = self.children.get_mut(self.current) {
            match child.tick(tick) {
                NodeStatus::Running => return NodeStatus::Running,
                status if status == self.continue_on => self.current += 1,
                status => {
                    self.current = 0;
                    return status;
                }
            }
        }
        self.current = 0;
        self.continue_on
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        halt_all(&mut self.children, tick);
        self.current = 0;
    }
}
