//! `Sequence` and `Fallback`: children one after the other, remembering where they are.

use crate::bt::node::{ChildNode, Node, halt_all};
use crate::bt::status::NodeStatus;
use crate::bt::tick::Tick;

/// Ticks children in order while they answer `go_on`; any other final answer ends it. A child that is running is
/// where the next tick goes on; children before it are not asked again.
pub(crate) struct MemoryControl {
    go_on: NodeStatus,
    children: Vec<ChildNode>,
    current: usize,
}

impl MemoryControl {
    /// Succeeds when all children do, and fails with the first that fails.
    pub(crate) fn sequence(children: Vec<ChildNode>) -> MemoryControl {
        MemoryControl { go_on: NodeStatus::Success, children, current: 0 }
    }

    /// Succeeds with the first child that does, and fails when all fail.
    pub(crate) fn fallback(children: Vec<ChildNode>) -> MemoryControl {
        MemoryControl { go_on: NodeStatus::Failure, children, current: 0 }
    }
}

impl Node for MemoryControl {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        while let Some(child) = self.children.get_mut(self.current) {
            match child.tick(tick) {
                NodeStatus::Running => return NodeStatus::Running,
                status if status == self.go_on => self.current += 1,
                status => {
                    self.current = 0;
                    return status;
                }
            }
        }
        self.current = 0;
        self.go_on
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        halt_all(&mut self.children, tick);
        self.current = 0;
    }
}
