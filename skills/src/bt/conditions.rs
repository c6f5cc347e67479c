//! Pre- and postconditions of a running node.

use super::bound_script::BoundScript;
use super::script_attribute::ScriptAttribute;
use super::status::NodeStatus;
use super::tick::Tick;

/// The script attributes of a node, in the order of evaluation.
#[derive(Debug)]
pub(crate) struct Conditions {
    pub(crate) scripts: Vec<(ScriptAttribute, BoundScript)>,
}

impl Conditions {
    /// Evaluates the preconditions. `Some` is the status of the node, which is then not ticked, and
    /// halted if it is running.
    pub(crate) fn before(&self, tick: &mut Tick<'_>, is_running: bool) -> Option<NodeStatus> {
        for (attribute, script) in self.scripts.iter().take_while(|(attribute, _)| attribute.is_condition()) {
            if is_running && *attribute != ScriptAttribute::While {
                continue;
            }
            let Some(holds) = script.holds(tick) else { return Some(NodeStatus::Failure) };
            match attribute {
                ScriptAttribute::FailureIf if holds => return Some(NodeStatus::Failure),
                ScriptAttribute::SuccessIf if holds => return Some(NodeStatus::Success),
                ScriptAttribute::SkipIf if holds => return Some(NodeStatus::Skipped),
                ScriptAttribute::While if !holds => return Some(NodeStatus::Skipped),
                _ => {}
            }
        }
        None
    }

    /// Executes the postconditions of a node that returned `status`, and returns the status of the
    /// node.
    pub(crate) fn after(&self, tick: &mut Tick<'_>, status: NodeStatus) -> NodeStatus {
        let only = match status {
            NodeStatus::Success => ScriptAttribute::OnSuccess,
            NodeStatus::Failure => ScriptAttribute::OnFailure,
            NodeStatus::Running | NodeStatus::Skipped => return status,
        };
        if tick.is_aborted() || (self.run(tick, only) && self.run(tick, ScriptAttribute::Post)) {
            status
        } else {
            NodeStatus::Failure
        }
    }

    /// Executes the script of a halted node.
    pub(crate) fn halted(&self, tick: &mut Tick<'_>) {
        self.run(tick, ScriptAttribute::OnHalted);
    }

    /// Executes a script, if the node has it. `false` means that its error aborted the tree.
    fn run(&self, tick: &mut Tick<'_>, wanted: ScriptAttribute) -> bool {
        self.scripts.iter().filter(|(attribute, _)| *attribute == wanted).all(|(_, script)| script.run(tick))
    }
}
