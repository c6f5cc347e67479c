//! `ReactiveSequence` and `ReactiveFallback`: children are asked anew from the first at every tick.

use crate::bt::node::{ChildNode, Node, halt_all};
use crate::bt::status::NodeStatus;
use crate::bt::tick::Tick;

/// Like its namesake without memory. While one child is running, all others are halted: an earlier child that changes
/// its answer interrupts a later one.
pub(crate) struct ReactiveControl {
    go_on: NodeStatus,
    children: Vec<ChildNode>,
}

impl ReactiveControl {
    /// Succeeds when all children do in one tick.
    pub(crate) fn sequence(children: Vec<ChildNode>) -> ReactiveControl {
        ReactiveControl { go_on: NodeStatus::Success, children }
    }

    /// Fails when all children do in one tick.
    pub(crate) fn fallback(children: Vec<ChildNode>) -> ReactiveControl {
        ReactiveControl { go_on: NodeStatus::Failure, children }
    }
}

impl Node for ReactiveControl {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        for index in 0..self.children.len() {
            let status = self.children[index].tick(tick);
            if status == self.go_on {
                continue;
            }
            for (other, child) in self.children.iter_mut().enumerate() {
                if other != index {
                    child.halt(tick);
                }
            }
            return status;
        }
        halt_all(&mut self.children, tick);
        self.go_on
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        halt_all(&mut self.children, tick);
    }
}
