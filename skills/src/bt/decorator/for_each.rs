//! The decorator that executes its child for each element of a list.

use crate::bt::node::{ChildNode, Node};
use crate::bt::ports::{PortError, Ports};
use crate::bt::status::NodeStatus;
use crate::bt::tick::{Cause, Tick};
use crate::bt::value::Value;
use std::collections::VecDeque;

/// `LoopString`: executes the child once for each element of the list in `queue`, with the element
/// in `value`. Fails when the child fails; a skipped child is followed by the next element. Returns
/// `if_empty` for an empty list. It is named as in
/// BehaviorTree.CPP, so that editors accept it, but takes elements of any type. Unlike in
/// BehaviorTree.CPP, the list is read once at the start and is not modified.
pub(crate) struct ForEach {
    child: ChildNode,
    ports: Ports,
    remaining: Option<VecDeque<Value>>,
}

impl ForEach {
    pub(crate) fn new(ports: Ports, child: ChildNode) -> ForEach {
        ForEach { child, ports, remaining: None }
    }

    /// Writes the next element to the blackboard; `None` after the last.
    fn next(&mut self, tick: &mut Tick<'_>) -> Result<Option<()>, PortError> {
        let Some(value) = self.remaining.as_mut().and_then(VecDeque::pop_front) else { return Ok(None) };
        self.ports.write(tick.blackboard, "value", value).map(Some)
    }

    fn begin(&mut self, tick: &Tick<'_>) -> Result<Option<NodeStatus>, PortError> {
        let queue: Vec<Value> = self.ports.read(tick.blackboard, "queue")?;
        if queue.is_empty() {
            let result: String = self.ports.read(tick.blackboard, "if_empty")?;
            return Ok(Some(match result.as_str() {
                "SUCCESS" => NodeStatus::Success,
                "SKIPPED" => NodeStatus::Skipped,
                _ => NodeStatus::Failure,
            }));
        }
        self.remaining = Some(queue.into());
        Ok(None)
    }

    fn step(&mut self, tick: &mut Tick<'_>) -> Result<NodeStatus, PortError> {
        if self.remaining.is_none()
            && let Some(result) = self.begin(tick)?
        {
            return Ok(result);
        }
        loop {
            if !self.child.is_running() {
                if !tick.take_iteration() {
                    return Ok(NodeStatus::Running);
                }
                if self.next(tick)?.is_none() {
                    return Ok(NodeStatus::Success);
                }
            }
            match self.child.tick(tick) {
                NodeStatus::Success | NodeStatus::Skipped => {}
                status => return Ok(status),
            }
        }
    }
}

impl Node for ForEach {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        let status = self.step(tick).unwrap_or_else(|error| {
            tick.set_cause("LoopString", Cause::from(error));
            NodeStatus::Failure
        });
        if status != NodeStatus::Running {
            self.remaining = None;
        }
        status
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.child.halt(tick);
        self.remaining = None;
    }
}
