//! Decorators: one child, and a change to what it answers or how often it is asked.

use super::node::{ChildNode, Node};
use super::ports::{PortError, Ports};
use super::status::NodeStatus;
use super::tick::{Cause, Tick};
use super::value::Value;
use consort_protocol::units::{Seconds, WorldTime};
use std::collections::VecDeque;

/// `Inverter`, `ForceSuccess`, `ForceFailure`: the child's final answer, mapped.
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

/// `RetryUntilSuccessful` and `Repeat`: the child again and again while it answers `again`, up to a number of times of
/// which -1 is without end. All turns may fall into one tick; one without end takes one turn a tick.
pub(crate) struct LoopNode {
    child: ChildNode,
    ports: Ports,
    count: &'static str,
    again: NodeStatus,
    turns: i64,
}

impl LoopNode {
    /// Until the child succeeds; fails when `num_attempts` have failed.
    pub(crate) fn retry(ports: Ports, child: ChildNode) -> LoopNode {
        LoopNode { child, ports, count: "num_attempts", again: NodeStatus::Failure, turns: 0 }
    }

    /// Succeeds when the child did `num_cycles` times; fails when it fails.
    pub(crate) fn repeat(ports: Ports, child: ChildNode) -> LoopNode {
        LoopNode { child, ports, count: "num_cycles", again: NodeStatus::Success, turns: 0 }
    }

    fn end(&mut self, status: NodeStatus) -> NodeStatus {
        self.turns = 0;
        status
    }
}

impl Node for LoopNode {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        let limit: i64 = match self.ports.read(tick.blackboard, self.count) {
            Ok(limit) => limit,
            Err(error) => return self.refuse(tick, error),
        };
        while limit < 0 || self.turns < limit {
            if !self.child.is_running() && !tick.take_iteration() {
                return NodeStatus::Running;
            }
            match self.child.tick(tick) {
                NodeStatus::Running => return NodeStatus::Running,
                status if status == self.again => self.turns = self.turns.saturating_add(1),
                status => return self.end(status),
            }
            if limit < 0 {
                tick.wake_at(tick.now);
                return NodeStatus::Running;
            }
        }
        self.end(self.again)
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.child.halt(tick);
        self.turns = 0;
    }
}

impl LoopNode {
    fn refuse(&mut self, tick: &mut Tick<'_>, error: PortError) -> NodeStatus {
        self.child.halt(tick);
        tick.set_cause(
            if self.again == NodeStatus::Failure { "RetryUntilSuccessful" } else { "Repeat" },
            Cause::from(error),
        );
        self.end(NodeStatus::Failure)
    }
}

/// `Timeout`: fails, and halts its child, when the child is still running `msec` milliseconds of world time after it
/// began; 0 is no limit.
pub(crate) struct Timeout {
    child: ChildNode,
    ports: Ports,
    deadline: Option<WorldTime>,
    began: bool,
}

impl Timeout {
    pub(crate) fn new(ports: Ports, child: ChildNode) -> Timeout {
        Timeout { child, ports, deadline: None, began: false }
    }

    fn begin(&mut self, tick: &Tick<'_>) -> Result<(), PortError> {
        let msec: i64 = self.ports.read(tick.blackboard, "msec")?;
        let time = Seconds::new(msec as f64 / 1000.0).unwrap_or(Seconds::ZERO);
        self.deadline = (msec > 0).then(|| tick.now + time);
        self.began = true;
        Ok(())
    }
}

impl Node for Timeout {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        if !self.began
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
            tick.set_cause("Timeout", Cause::new(format!("not done by {at} s of world time, when its limit ended")));
            return NodeStatus::Failure;
        }
        let status = self.child.tick(tick);
        match (status, self.deadline) {
            (NodeStatus::Running, Some(deadline)) => tick.wake_at(deadline),
            (NodeStatus::Running, None) => {}
            _ => self.began = false,
        }
        status
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.child.halt(tick);
        self.began = false;
    }
}

/// `LoopString`: the child once for each element of the list in `queue`, which it finds in `value`. Fails when the
/// child fails; answers `if_empty` when there is nothing in the list. Named as in BehaviorTree.CPP so that editors know
/// it, it takes elements of any type. Unlike there, the list is read once, at the start, and is left as it is.
pub(crate) struct ForEach {
    child: ChildNode,
    ports: Ports,
    left: Option<VecDeque<Value>>,
}

impl ForEach {
    pub(crate) fn new(ports: Ports, child: ChildNode) -> ForEach {
        ForEach { child, ports, left: None }
    }

    /// Takes the next element onto the blackboard; `None` after the last.
    fn next(&mut self, tick: &mut Tick<'_>) -> Result<Option<()>, PortError> {
        let Some(value) = self.left.as_mut().and_then(VecDeque::pop_front) else { return Ok(None) };
        self.ports.write(tick.blackboard, "value", value).map(Some)
    }

    fn begin(&mut self, tick: &Tick<'_>) -> Result<Option<NodeStatus>, PortError> {
        let queue: Vec<Value> = self.ports.read(tick.blackboard, "queue")?;
        if queue.is_empty() {
            let answer: String = self.ports.read(tick.blackboard, "if_empty")?;
            return Ok(Some(if answer == "SUCCESS" { NodeStatus::Success } else { NodeStatus::Failure }));
        }
        self.left = Some(queue.into());
        Ok(None)
    }

    fn step(&mut self, tick: &mut Tick<'_>) -> Result<NodeStatus, PortError> {
        if self.left.is_none()
            && let Some(answer) = self.begin(tick)?
        {
            return Ok(answer);
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
            self.left = None;
        }
        status
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.child.halt(tick);
        self.left = None;
    }
}
