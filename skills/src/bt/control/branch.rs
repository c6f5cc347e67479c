//! The control nodes `IfThenElse`, `WhileDoElse` and `Switch`, which execute one of their children.

use crate::bt::node::{ChildNode, Node, halt_all};
use crate::bt::ports::{PortError, Ports};
use crate::bt::status::NodeStatus;
use crate::bt::tick::{Cause, Tick};
use crate::bt::value::{PortType, Value};

/// Chooses the second child if the first succeeds, and the third if it fails; without a third child
/// the node fails. The choice remains until the chosen child completes. A skipped condition skips
/// the node.
pub(crate) struct IfThenElse {
    children: Vec<ChildNode>,
    chosen: Option<usize>,
}

impl IfThenElse {
    /// Creates the node with 2 or 3 children.
    pub(crate) fn new(children: Vec<ChildNode>) -> IfThenElse {
        IfThenElse { children, chosen: None }
    }
}

impl Node for IfThenElse {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        let index = match self.chosen {
            Some(index) => index,
            None => match self.children[0].tick(tick) {
                NodeStatus::Success => 1,
                NodeStatus::Failure if self.children.len() == 3 => 2,
                status => return status,
            },
        };
        let status = self.children[index].tick(tick);
        self.chosen = (status == NodeStatus::Running).then_some(index);
        status
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        halt_all(&mut self.children, tick);
        self.chosen = None;
    }
}

/// Like [`IfThenElse`], but ticks the first child at every tick. A change of its status halts the
/// child that is running.
pub(crate) struct WhileDoElse {
    children: Vec<ChildNode>,
}

impl WhileDoElse {
    /// Creates the node with 2 or 3 children.
    pub(crate) fn new(children: Vec<ChildNode>) -> WhileDoElse {
        WhileDoElse { children }
    }
}

impl Node for WhileDoElse {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        let (chosen, other) = match self.children[0].tick(tick) {
            NodeStatus::Running => return NodeStatus::Running,
            NodeStatus::Success => (1, 2),
            NodeStatus::Failure if self.children.len() == 3 => (2, 1),
            status => {
                halt_all(&mut self.children, tick);
                return status;
            }
        };
        if let Some(other) = self.children.get_mut(other) {
            other.halt(tick);
        }
        self.children[chosen].tick(tick)
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        halt_all(&mut self.children, tick);
    }
}

/// `Switch2` to `Switch6`: chooses the child of the first port `case_N` that equals the port
/// `variable`, and otherwise the last child, also while `variable` is empty. Values are equal if
/// their texts or their numbers are equal. A change of the variable halts the child that is
/// running.
pub(crate) struct Switch {
    cases: u8,
    ports: Ports,
    children: Vec<ChildNode>,
}

impl Switch {
    /// Creates the node with a child for each case, and the default.
    pub(crate) fn new(cases: u8, ports: Ports, children: Vec<ChildNode>) -> Switch {
        Switch { cases, ports, children }
    }

    fn choose(&self, tick: &Tick<'_>) -> Result<usize, PortError> {
        let read = |port: &str| self.ports.read_optional::<Value>(tick.blackboard, port);
        if let Some(variable) = read("variable")? {
            for case in 1..=self.cases {
                if read(&format!("case_{case}"))?.is_some_and(|value| are_equal(&variable, &value)) {
                    return Ok(usize::from(case) - 1);
                }
            }
        }
        Ok(usize::from(self.cases))
    }
}

fn are_equal(left: &Value, right: &Value) -> bool {
    let (left, right) = (left.to_string(), right.to_string());
    let number = |text: &str| PortType::Number.parse(text).ok();
    left == right || number(&left).is_some_and(|value| number(&right) == Some(value))
}

impl Node for Switch {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        let chosen = match self.choose(tick) {
            Ok(chosen) => chosen,
            Err(error) => {
                halt_all(&mut self.children, tick);
                tick.set_cause("Switch", Cause::from(error));
                return NodeStatus::Failure;
            }
        };
        for (index, child) in self.children.iter_mut().enumerate() {
            if index != chosen {
                child.halt(tick);
            }
        }
        self.children[chosen].tick(tick)
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        halt_all(&mut self.children, tick);
    }
}
