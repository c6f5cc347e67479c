//! Decorators: nodes with a single child that change its status or the number of its executions.

use super::node::{ChildNode, Node};
use super::ports::{PortError, Ports};
use super::status::NodeStatus;
use super::tick::{Cause, Tick};
use super::value::Value;
use consort_protocol::units::{Seconds, WorldTime};
use std::collections::VecDeque;

/// `Inverter`, `ForceSuccess`, `ForceFailure`: map the child's final status.
pub(crate) struct MapResult {
    child: ChildNode,
    map: fn(NodeStatus) -> NodeStatus,
}

impl MapResult {
    pub(crate) fn inverter(child: ChildNode) -> MapResult {
        let map = |status| match status {
            NodeStatus::Success => NodeStatus::Failure,
            NodeStatus::Failure => NodeStatus::Success,
            NodeStatus::Running => NodeStatus::Running,
        };
        MapResult { child, map }
    }

    pub(crate) fn force(child: ChildNode, to: NodeStatus) -> MapResult {
        let map = match to {
            NodeStatus::Success => |status: NodeStatus| if status.is_final() { NodeStatus::Success } else { status },
            _ => |status: NodeStatus| if status.is_final() { NodeStatus::Failure } else { status },
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

/// `RetryUntilSuccessful` and `Repeat`: execute the child again while it returns `repeat_on`, up to
/// a number of times; -1 means without limit. A limited loop may run all iterations in a single
/// tick. An unlimited loop runs an iteration per tick.
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
                NodeStatus::Running => return NodeStatus::Running,
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

/// `Timeout`: halts the child and fails if the child is still running `msec` milliseconds of world
/// time after its start; 0 means no limit.
pub(crate) struct Timeout {
    child: ChildNode,
    ports: Ports,
    deadline: Option<WorldTime>,
    is_started: bool,
}

impl Timeout {
    pub(crate) fn new(ports: Ports, child: ChildNode) -> Timeout {
        Timeout { child, ports, deadline: None, is_started: false }
    }

    fn begin(&mut self, tick: &Tick<'_>) -> Result<(), PortError> {
        let msec: i64 = self.ports.read(tick.blackboard, "msec")?;
        let time = Seconds::new(msec as f64 / 1000.0).unwrap_or(Seconds::ZERO);
        self.deadline = (msec > 0).then(|| tick.now + time);
        self.is_started = true;
        Ok(())
    }
}

impl Node for Timeout {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        if !self.is_started
            && let Err(error) = self.begin(tick)
        {
            tick.set_cause("Timeout", Cause::from(error));
            return NodeStatus::Failure;
        }
        if let Some(deadline) = self.deadline
            && tick.now >= deadline
        {
            self.halt(tick);
            let at = deadline.as_secs();
            tick.set_cause("Timeout", Cause::new(format!("not complete at {at} s of world time, its time limit")));
            return NodeStatus::Failure;
        }
        let status = self.child.tick(tick);
        if status != NodeStatus::Running {
            self.is_started = false;
        }
        status
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.child.halt(tick);
        self.is_started = false;
    }
}

/// `LoopString`: executes the child once for each element of the list in `queue`, with the element
/// in `value`. Fails when the child fails. Returns `if_empty` for an empty list. It is named as in
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
            return Ok(Some(if result == "SUCCESS" { NodeStatus::Success } else { NodeStatus::Failure }));
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
                NodeStatus::Success => {}
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
        if status.is_final() {
            self.remaining = None;
        }
        status
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.child.halt(tick);
        self.remaining = None;
    }
}
