//! Decorators that execute their child several times.

use crate::bt::node::{ChildNode, Node};
use crate::bt::ports::{PortError, Ports};
use crate::bt::status::NodeStatus;
use crate::bt::tick::{Cause, Tick};

/// `RetryUntilSuccessful` and `Repeat`: execute the child again while it returns `repeat_on`, up to
/// a number of times; -1 means without limit. A limited loop may run all iterations in a single
/// tick. An unlimited loop runs an iteration per tick. If the child is skipped, so is the node, and
/// its count remains.
pub(crate) struct LoopNode {
    child: ChildNode,
    ports: Ports,
    count: &'static str,
    repeat_on: NodeStatus,
    iterations: i64,
}

impl LoopNode {
    /// Retries until the child succeeds; fails after `num_attempts` failures.
    pub(crate) fn retry(ports: Ports, child: ChildNode) -> LoopNode {
        LoopNode { child, ports, count: "num_attempts", repeat_on: NodeStatus::Failure, iterations: 0 }
    }

    /// Succeeds after `num_cycles` successes of the child; fails when the child fails.
    pub(crate) fn repeat(ports: Ports, child: ChildNode) -> LoopNode {
        LoopNode { child, ports, count: "num_cycles", repeat_on: NodeStatus::Success, iterations: 0 }
    }

    fn end(&mut self, status: NodeStatus) -> NodeStatus {
        self.iterations = 0;
        status
    }
}

impl Node for LoopNode {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        let limit: i64 = match self.ports.read(tick.blackboard, self.count) {
            Ok(limit) => limit,
            Err(error) => return self.reject(tick, error),
        };
        while limit < 0 || self.iterations < limit {
            if !self.child.is_running() && !tick.take_iteration() {
                return NodeStatus::Running;
            }
            match self.child.tick(tick) {
                status @ (NodeStatus::Running | NodeStatus::Skipped) => return status,
                status if status == self.repeat_on => self.iterations = self.iterations.saturating_add(1),
                status => return self.end(status),
            }
            if limit < 0 {
                return NodeStatus::Running;
            }
        }
        self.end(self.repeat_on)
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.child.halt(tick);
        self.iterations = 0;
    }
}

impl LoopNode {
    fn reject(&mut self, tick: &mut Tick<'_>, error: PortError) -> NodeStatus {
        self.child.halt(tick);
        tick.set_cause(
            if self.repeat_on == NodeStatus::Failure { "RetryUntilSuccessful" } else { "Repeat" },
            Cause::from(error),
        );
        self.end(NodeStatus::Failure)
    }
}

/// `KeepRunningUntilFailure`: executes the child once per tick, and runs until the child fails.
pub(crate) struct KeepRunning {
    child: ChildNode,
}

impl KeepRunning {
    pub(crate) fn new(child: ChildNode) -> KeepRunning {
        KeepRunning { child }
    }
}

impl Node for KeepRunning {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        match self.child.tick(tick) {
            NodeStatus::Failure => NodeStatus::Failure,
            NodeStatus::Success | NodeStatus::Running | NodeStatus::Skipped => NodeStatus::Running,
        }
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.child.halt(tick);
    }
}
