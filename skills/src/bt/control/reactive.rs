//! `ReactiveSequence` and `ReactiveFallback`: children are asked anew from the first at every tick.

use crate::bt::node::{Node, Slot, halt_all};
use crate::bt::status::Status;
use crate::bt::tick::Tick;

/// Like its namesake without memory. While one child is running, all others are halted: an earlier child that changes
/// its answer interrupts a later one.
pub(crate) struct Reactive {
    go_on: Status,
    children: Vec<Slot>,
}

impl Reactive {
    /// Succeeds when all children do in one tick.
    pub(crate) fn sequence(children: Vec<Slot>) -> Reactive {
        Reactive { go_on: Status::Success, children }
    }

    /// Fails when all children do in one tick.
    pub(crate) fn fallback(children: Vec<Slot>) -> Reactive {
        Reactive { go_on: Status::Failure, children }
    }
}

impl Node for Reactive {
    fn tick(&mut self, tick: &mut Tick<'_>) -> Status {
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
