//! `Parallel` and `ParallelAll`: tick all children, and count their results.

use crate::bt::node::{ChildNode, Node, halt_all};
use crate::bt::ports::{PortError, Ports};
use crate::bt::status::NodeStatus;
use crate::bt::tick::{Cause, Tick};

/// Children with the results of those that completed. A skipped child is ticked again.
struct Results {
    ports: Ports,
    children: Vec<ChildNode>,
    completed: Vec<Option<NodeStatus>>,
    /// Children skipped in this tick.
    skipped: usize,
}

impl Results {
    fn new(ports: Ports, children: Vec<ChildNode>) -> Results {
        let completed = vec![None; children.len()];
        Results { ports, children, completed, skipped: 0 }
    }

    /// Reads a number of children, and whether it is negative. A negative number is relative to the
    /// number of children: -1 is all of them.
    fn number(&self, tick: &Tick<'_>, port: &str) -> Result<(usize, bool), PortError> {
        let number: i64 = self.ports.read(tick.blackboard, port)?;
        let all = self.children.len() as i64;
        let absolute = if number < 0 { (all + number + 1).max(0) } else { number };
        Ok((absolute as usize, number < 0))
    }

    fn tick(&mut self, tick: &mut Tick<'_>, index: usize) {
        if self.completed[index].is_none() {
            let status = self.children[index].tick(tick);
            self.completed[index] = status.is_completed().then_some(status);
            self.skipped += usize::from(status == NodeStatus::Skipped);
        }
    }

    fn count(&self, wanted: NodeStatus) -> usize {
        self.completed.iter().filter(|status| **status == Some(wanted)).count()
    }

    fn all_skipped(&self) -> bool {
        self.skipped == self.children.len()
    }

    fn end(&mut self, tick: &mut Tick<'_>, status: NodeStatus) -> NodeStatus {
        halt_all(&mut self.children, tick);
        self.completed.fill(None);
        status
    }

    fn reject(&mut self, tick: &mut Tick<'_>, node: &str, error: PortError) -> NodeStatus {
        tick.set_cause(node, Cause::from(error));
        self.end(tick, NodeStatus::Failure)
    }
}

/// Ticks every child that has not completed. Succeeds once `success_count` children succeeded.
/// Fails once `failure_count` children failed, or so many that `success_count` cannot be reached. A
/// negative count is relative to the number of children: -1 means all of them. With a negative
/// `success_count`, skipped children count as successes. Children that are still running at the end
/// are halted.
pub(crate) struct Parallel(Results);

impl Parallel {
    pub(crate) fn new(ports: Ports, children: Vec<ChildNode>) -> Parallel {
        Parallel(Results::new(ports, children))
    }
}

impl Node for Parallel {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        let counts = self.0.number(tick, "success_count").and_then(|m| Ok((m, self.0.number(tick, "failure_count")?)));
        let ((successes, is_relative), (failures, _)) = match counts {
            Ok(counts) => counts,
            Err(error) => return self.0.reject(tick, "Parallel", error),
        };
        let results = &mut self.0;
        results.skipped = 0;
        for index in 0..results.children.len() {
            results.tick(tick, index);
            let (succeeded, failed) = (results.count(NodeStatus::Success), results.count(NodeStatus::Failure));
            // A node that skips all children is skipped.
            let skipped = if is_relative && !results.all_skipped() { results.skipped } else { 0 };
            if succeeded + skipped >= successes {
                return results.end(tick, NodeStatus::Success);
            }
            if results.children.len() - failed < successes || failed >= failures {
                return results.end(tick, NodeStatus::Failure);
            }
        }
        if results.all_skipped() { NodeStatus::Skipped } else { NodeStatus::Running }
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.0.end(tick, NodeStatus::Failure);
    }
}

/// Ticks every child that has not completed, until all have completed or are skipped. Then it fails
/// if at least `max_failures` children failed, and succeeds otherwise. A negative number is
/// relative to the number of children.
pub(crate) struct ParallelAll(Results);

impl ParallelAll {
    pub(crate) fn new(ports: Ports, children: Vec<ChildNode>) -> ParallelAll {
        ParallelAll(Results::new(ports, children))
    }
}

impl Node for ParallelAll {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        let max_failures = match self.0.number(tick, "max_failures") {
            Ok((number, _)) => number,
            Err(error) => return self.0.reject(tick, "ParallelAll", error),
        };
        let results = &mut self.0;
        results.skipped = 0;
        for index in 0..results.children.len() {
            results.tick(tick, index);
        }
        if results.all_skipped() {
            return NodeStatus::Skipped;
        }
        let failed = results.count(NodeStatus::Failure);
        if failed + results.count(NodeStatus::Success) + results.skipped < results.children.len() {
            return NodeStatus::Running;
        }
        let status = if failed >= max_failures { NodeStatus::Failure } else { NodeStatus::Success };
        results.end(tick, status)
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.0.end(tick, NodeStatus::Failure);
    }
}
