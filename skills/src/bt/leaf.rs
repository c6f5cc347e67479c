//! Leaves: the nodes that interact with the robot. Contains the trait for custom leaves, and the
//! built-in leaves.

use super::bound_script::BoundScript;
use super::node::Node;
use super::ports::Ports;
use super::status::NodeStatus;
use super::tick::{Cause, LeafContext, Tick};
use consort_protocol::units::{Seconds, WorldTime};
use std::sync::Arc;

/// A custom leaf. It starts from the beginning at the first tick after it ended or was halted.
pub trait Leaf: Send {
    /// Continues the execution and returns its status. Never blocks: a leaf that takes time returns
    /// [`NodeStatus::Running`].
    ///
    /// # Errors
    /// `Err` is a failure, too, with its cause.
    fn tick(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause>;

    /// Stops the execution. Called only while the leaf is running.
    fn halt(&mut self, context: &mut LeafContext<'_, '_>);
}

/// A leaf made of a function that completes at once, and so needs no halt (a synchronous action).
pub struct SyncLeaf<F>(pub F);

impl<F> Leaf for SyncLeaf<F>
where
    F: FnMut(&mut LeafContext<'_, '_>) -> Result<bool, Cause> + Send,
{
    fn tick(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        Ok(if (self.0)(context)? { NodeStatus::Success } else { NodeStatus::Failure })
    }

    fn halt(&mut self, _: &mut LeafContext<'_, '_>) {}
}

/// A leaf in its tree, with its bound ports.
pub(crate) struct LeafNode {
    pub(crate) name: String,
    pub(crate) leaf: Box<dyn Leaf>,
    pub(crate) ports: Ports,
}

impl Node for LeafNode {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        let result = self.leaf.tick(&mut LeafContext { tick, ports: &self.ports });
        match result {
            Ok(NodeStatus::Failure) => tick.set_cause(&self.name, Cause::new("it failed")),
            Ok(status) => return status,
            Err(cause) => tick.set_cause(&self.name, cause),
        }
        NodeStatus::Failure
    }

    fn halt(&mut self, tick: &mut Tick<'_>) {
        self.leaf.halt(&mut LeafContext { tick, ports: &self.ports });
    }
}

/// `Script` and `ScriptCondition`: execute their script, which takes no time.
pub(crate) struct ScriptNode {
    script: Arc<BoundScript>,
    /// Name of a condition; `None` for an action, which succeeds.
    condition: Option<String>,
}

impl ScriptNode {
    pub(crate) fn action(script: Arc<BoundScript>) -> ScriptNode {
        ScriptNode { script, condition: None }
    }

    pub(crate) fn condition(name: &str, script: Arc<BoundScript>) -> ScriptNode {
        ScriptNode { script, condition: Some(name.to_owned()) }
    }
}

impl Node for ScriptNode {
    fn tick(&mut self, tick: &mut Tick<'_>) -> NodeStatus {
        let holds = match &self.condition {
            None => self.script.run(tick),
            Some(_) => self.script.holds(tick).unwrap_or(false),
        };
        if holds {
            return NodeStatus::Success;
        }
        if let Some(name) = &self.condition {
            tick.set_cause(name, Cause::new("the condition is false"));
        }
        NodeStatus::Failure
    }

    fn halt(&mut self, _: &mut Tick<'_>) {}
}

/// `AlwaysSuccess` and `AlwaysFailure`. The latter sets no cause: the cause of an earlier failure
/// remains.
pub(crate) struct ConstantNode(pub(crate) NodeStatus);

impl Node for ConstantNode {
    fn tick(&mut self, _: &mut Tick<'_>) -> NodeStatus {
        self.0
    }

    fn halt(&mut self, _: &mut Tick<'_>) {}
}

/// `Sleep`: runs for `msec` milliseconds of world time.
#[derive(Default)]
pub(crate) struct SleepLeaf {
    until: Option<WorldTime>,
}

impl Leaf for SleepLeaf {
    fn tick(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        let until = match self.until {
            Some(until) => until,
            None => {
                let msec: i64 = context.read("msec")?;
                let time = Seconds::new(msec as f64 / 1000.0).map_err(|error| Cause::new(error.to_string()))?;
                *self.until.insert(context.now() + time)
            }
        };
        if context.now() >= until {
            self.until = None;
            return Ok(NodeStatus::Success);
        }
        Ok(NodeStatus::Running)
    }

    fn halt(&mut self, _: &mut LeafContext<'_, '_>) {
        self.until = None;
    }
}
