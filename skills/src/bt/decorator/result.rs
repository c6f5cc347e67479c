//! Decorators that change or remember the status of their child.

use crate::bt::node::{ChildNode, Node};
use crate::bt::ports::Ports;
use crate::bt::status::NodeStatus;
use crate::bt::tick::{Cause, Tick};

/// `Inverter`, `ForceSuccess`, `ForceFailure`: map the status of a child that completed. A child
/// that is running or skipped passes its status on.
pub(crate) struct MapResult {
    child: ChildNode,
    map: fn(NodeStatus) -> NodeStatus,
}

impl MapResult {
    pub(crate) fn inverter(child: ChildNode) -> MapResult {
        let map = |status| match status {
            NodeStatus::Success => NodeStatus::Failure,
            NodeStatus::Failure => NodeStatus::Success,
            NodeStatus::Running | NodeStatus::Skipped => status,
        };
        MapResult { child, map }
    }

    /// A node with the status of its child: a sub-tree that has conditions.
    pub(crate) fn unchanged(child: ChildNode) -> MapResult {
        MapResult { child, map: |status| status }
    }

    pub(crate) fn force(child: ChildNode, to: NodeStatus) -> MapResult {
        let map = match to {
            NodeStatus::Success => {
                |status: NodeStatus| if status.is_completed() { NodeStatus::Success } else { status }
            }
            _ => |status: NodeStatus| if status.is_completed() { NodeStatus::Failure } else { status },
        };
        MapResult { child, map }
    }
}

impl Node for MapResult {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        (self.map)(self.child.tick(tick))
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.child.halt(tick);
    }
}

/// `RunOnce`: executes the child until it completes once in the life of the tree. Afterwards the
/// node is skipped, or with `then_skip="false"` returns the status of the child again. A halt does
/// not count as completion.
pub(crate) struct RunOnce {
    child: ChildNode,
    ports: Ports,
    result: Option<NodeStatus>,
}

impl RunOnce {
    pub(crate) fn new(ports: Ports, child: ChildNode) -> RunOnce {
        RunOnce { child, ports, result: None }
    }
}

impl Node for RunOnce {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        if let Some(result) = self.result {
            return match self.ports.read::<bool>(tick.blackboard, "then_skip") {
                Ok(true) => NodeStatus::Skipped,
                Ok(false) => result,
                Err(error) => {
                    tick.set_cause("RunOnce", Cause::from(error));
                    NodeStatus::Failure
                }
            };
        }
        let status = self.child.tick(tick);
        self.result = status.is_completed().then_some(status);
        status
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.child.halt(tick);
    }
}
