//! The interface of nodes in a running tree, and the wrapper in which a parent stores a child.

use super::conditions::Conditions;
use super::status::NodeStatus;
use super::tick::Tick;
use std::sync::Arc;

/// A node of a running tree. It starts from the beginning at the first tick after it completed or
/// was halted.
pub(crate) trait Node: Send {
    /// Continues the execution and returns its status.
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus;

    /// Stops the execution, children included. Called only while the node is running.
    fn halt(&mut self, tick: &mut Tick<'_>);
}

/// A child node with its pre- and postconditions. It records whether the child is running, so that
/// an idle child is never halted.
pub(crate) struct ChildNode {
    node: Box<dyn Node>,
    conditions: Option<Arc<Conditions>>,
    running: bool,
}

impl ChildNode {
    pub(crate) fn new(node: Box<dyn Node>, conditions: Option<Arc<Conditions>>) -> ChildNode {
        ChildNode { node, conditions, running: false }
    }

    /// Ticks the node, unless a precondition decides its status. In an aborted tree no node is
    /// ticked, and a running node remains running until it is halted.
    pub(crate) fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        if tick.is_aborted() {
            return NodeStatus::Failure;
        }
        let status = match &self.conditions {
            None => self.node.tick(tick),
            Some(conditions) => {
                let status = match conditions.before(tick, self.running) {
                    None => self.node.tick(tick),
                    Some(status) => {
                        if self.running {
                            self.node.halt(tick);
                            conditions.halted(tick);
                        }
                        status
                    }
                };
                conditions.after(tick, status)
            }
        };
        self.running = status == NodeStatus::Running;
        status
    }

    pub(crate) fn halt(&mut self, tick: &mut Tick<'_>) {
        if std::mem::take(&mut self.running) {
            self.node.halt(tick);
            if let Some(conditions) = &self.conditions {
                conditions.halted(tick);
            }
        }
    }

    pub(crate) fn is_running(&self) -> bool {
        self.running
    }
}

/// Halts every running child, first to last.
pub(crate) fn halt_all(children: &mut [ChildNode], tick: &mut Tick<'_>) {
    for child in children {
        child.halt(tick);
    }
}
