//! `Sequence` and `Fallback`: children one after the other, remembering where they are.

use crate::bt::node::{Node, Slot, halt_all};
use crate::bt::status::Status;
use crate::bt::tick::Tick;

/// Ticks children in order while they answer `go_on`; any other final answer ends it. A child that is running is
/// where the next tick goes on; children before it are not asked again.
pub(crate) struct Ordered {
    go_on: Status,
    children: Vec<Slot>,
    current: usize,
}

impl Ordered {
    /// Succeeds when all children do, and fails with the first that fails.
    pub(crate) fn sequence(children: Vec<Slot>) -> Ordered {
        Ordered { go_on: Status::Success, children, current: 0 }
    }

    /// Succeeds with the first child that does, and fails when all fail.
    pub(crate) fn fallback(children: Vec<Slot>) -> Ordered {
        Ordered { go_on: Status::Failure, children, current: 0 }
    }
}

impl Node for Ordered {
    fn tick(&mut self, tick: &mut Tick<'_>) -> Status {
        while let Some(child) = self.children.get_mut(self.current) {
            match child.tick(tick) {
                Status::Running => return Status::Running,
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
