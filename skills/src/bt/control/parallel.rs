//! `Parallel`: ticks all children until enough of them have ended.

use crate::bt::node::{ChildNode, Node, halt_all};
use crate::bt::ports::{PortError, Ports};
use crate::bt::status::NodeStatus;
use crate::bt::tick::{Cause, Tick};

/// Ticks every child that has not ended. Succeeds once `success_count` children succeeded. Fails
/// once `failure_count` children failed, or so many that `success_count` cannot be reached. A
/// negative count is relative to the number of children: -1 means all of them. Children that are
/// still running at the end are halted.
pub(crate) struct Parallel {
    ports: Ports,
    children: Vec<ChildNode>,
    ended: Vec<Option<NodeStatus>>,
}

impl Parallel {
    pub(crate) fn new(ports: Ports, children: Vec<ChildNode>) -> Parallel {
        let ended = vec![None; children.len()];
        Parallel { ports, children, ended }
    }

    fn count(&self, tick: &Tick<'_>, port: &str) -> Result<usize, PortError> {
        let count: i64 = self.ports.read(tick.blackboard, port)?;
        let all = self.children.len() as i64;
        Ok(if count < 0 { (all + count + 1).max(0) } else { count } as usize)
    }

    fn end(&mut self, tick: &mut Tick<'_>, status: NodeStatus) -> NodeStatus {
        self.halt(tick);
        status
    }
}

impl Node for Parallel {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        let counts = self.count(tick, "success_count").and_then(|m| Ok((m, self.count(tick, "failure_count")?)));
        let (successes, failures) = match counts {
            Ok(counts) => counts,
            Err(error) => {
                tick.set_cause("Parallel", Cause::from(error));
                return self.end(tick, NodeStatus::Failure);
            }
        };
        for index in 0..self.children.len() {
            if self.ended[index].is_none() {
                let status = self.children[index].tick(tick);
                self.ended[index] = status.is_final().then_some(status);
            }
            let ended = |wanted| self.ended.iter().filter(|status| **status == Some(wanted)).count();
            let failed = ended(NodeStatus::Failure);
            if ended(NodeStatus::Success) >= successes {
                return self.end(tick, NodeStatus::Success);
            }
            if self.children.len() - failed < successes || (failed > 0 && failed >= failures) {
                return self.end(tick, NodeStatus::Failure);
            }
        }
        NodeStatus::Running
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        halt_all(&mut self.children, tick);
        self.ended.fill(None);
    }
}
