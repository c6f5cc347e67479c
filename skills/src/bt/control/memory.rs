//! `Sequence` and `Fallback`: control nodes with memory, which tick their children in turn.

use crate::bt::node::{ChildNode, Node, halt_all};
use crate::bt::status::NodeStatus;
use crate::bt::tick::Tick;

/// Ticks children in order while they return `continue_on` or are skipped; any other final status
/// ends the node. The next tick continues with the running child; earlier children are not ticked
/// again. If every child is skipped, so is the node.
pub(crate) struct MemoryControl {
    continue_on: NodeStatus,
    children: Vec<ChildNode>,
    current: usize,
    skipped: usize,
    /// Returns `Running` after a child that completed within a tick, so that a parent can halt the
    /// node between its children.
    asynchronous: bool,
    /// A failed or halted node continues with the same child.
    keeps_position: bool,
}

impl MemoryControl {
    /// Succeeds when all children succeed, and fails with the first failure.
    pub(crate) fn sequence(children: Vec<ChildNode>) -> MemoryControl {
        MemoryControl::new(NodeStatus::Success, children)
    }

    /// Succeeds with the first success, and fails when all children fail.
    pub(crate) fn fallback(children: Vec<ChildNode>) -> MemoryControl {
        MemoryControl::new(NodeStatus::Failure, children)
    }

    fn new(continue_on: NodeStatus, children: Vec<ChildNode>) -> MemoryControl {
        MemoryControl { continue_on, children, current: 0, skipped: 0, asynchronous: false, keeps_position: false }
    }

    /// `AsyncSequence` and `AsyncFallback`.
    pub(crate) fn asynchronous(self) -> MemoryControl {
        MemoryControl { asynchronous: true, ..self }
    }

    /// `SequenceWithMemory`: after a failure or a halt, children that succeeded are not ticked
    /// again.
    pub(crate) fn with_memory(self) -> MemoryControl {
        MemoryControl { keeps_position: true, ..self }
    }

    fn restart(&mut self) {
        (self.current, self.skipped) = (0, 0);
    }
}

impl Node for MemoryControl {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        while let Some(child) = self.children.get_mut(self.current) {
            let was_running = child.is_running();
            let status = child.tick(tick);
            match status {
                NodeStatus::Running => return NodeStatus::Running,
                NodeStatus::Skipped => self.skipped += 1,
                _ if status == self.continue_on => {}
                _ => {
                    if !self.keeps_position {
                        self.restart();
                    }
                    return status;
                }
            }
            self.current += 1;
            let yields = self.asynchronous && !was_running && status != NodeStatus::Skipped;
            if yields && self.current < self.children.len() {
                return NodeStatus::Running;
            }
        }
        let all_skipped = self.skipped == self.children.len();
        self.restart();
        if all_skipped { NodeStatus::Skipped } else { self.continue_on }
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        halt_all(&mut self.children, tick);
        if !self.keeps_position {
            self.restart();
        }
    }
}
