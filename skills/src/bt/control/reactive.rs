//! `ReactiveSequence` and `ReactiveFallback`: every tick starts again with the first child.

use crate::bt::node::{ChildNode, Node, halt_all};
use crate::bt::status::NodeStatus;
use crate::bt::tick::Tick;

/// Like its counterpart, but without memory. While a child is running, all others are halted: an
/// earlier child interrupts, by a change of status, a later child.
pub(crate) struct ReactiveControl {
    continue_on: NodeStatus,
    children: Vec<ChildNode>,
}

impl ReactiveControl {
    /// Succeeds when all children succeed in the same tick.
    pub(crate) fn sequence(children: Vec<ChildNode>) -> ReactiveControl {
        ReactiveControl { continue_on: NodeStatus::Success, children }
    }

    /// Fails when all children fail in the same tick.
    pub(crate) fn fallback(children: Vec<ChildNode>) -> ReactiveControl {
        ReactiveControl { continue_on: NodeStatus::Failure, children }
    }
}

impl Node for ReactiveControl {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        let mut all_skipped = true;
        for index in 0..self.children.len() {
            let status = self.children[index].tick(tick);
            if status == NodeStatus::Skipped {
                continue;
            }
            all_skipped = false;
            if status == self.continue_on {
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
        if all_skipped { NodeStatus::Skipped } else { self.continue_on }
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        halt_all(&mut self.children, tick);
    }
}
