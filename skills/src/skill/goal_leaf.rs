//! The leaf that sends a goal, tracks it, and cancels it on halt.

use crate::actions::{Goal, GoalId, GoalResult, GoalStatus};
use crate::bt::{
    Cause, Leaf, LeafContext, NodeKind, NodeManifest, NodeStatus, PortSpec, PortType, Registry, RegistryError, Value,
};
use consort_protocol::scalar::Scalar;
use std::sync::Arc;

type MakeGoal = dyn Fn(&mut LeafContext<'_, '_>) -> Result<Goal, Cause> + Send + Sync;

/// Sends a goal made from its ports; runs until the goal ends. A goal that must not be repeated,
/// and which an earlier attempt at the task has completed, counts as completed. Before sending, the
/// leaf waits until the robot has ended all goals that the same tree canceled, since a busy robot
/// rejects a second goal.
pub struct GoalLeaf {
    make: Arc<MakeGoal>,
    /// Output ports for the values of the result, with their types.
    results: Arc<[(String, PortType)]>,
    goal: Option<GoalId>,
}

impl GoalLeaf {
    /// Registers an action; `make` creates its goal when it starts.
    ///
    /// # Errors
    /// [`RegistryError`] if the name is in use.
    pub fn register<C>(
        registry: &mut Registry<C>,
        id: &str,
        ports: impl IntoIterator<Item = PortSpec>,
        make: impl Fn(&C, &mut LeafContext<'_, '_>) -> Result<Goal, Cause> + Send + Sync + Clone + 'static,
    ) -> Result<(), RegistryError>
    where
        C: Clone + Send + Sync + 'static,
    {
        registry.register(NodeManifest::new(id, NodeKind::Action, ports), move |context: &C| {
            let (make, context) = (make.clone(), context.clone());
            Box::new(GoalLeaf::new(move |leaf| make(&context, leaf)))
        })
    }

    /// Creates a leaf as a part of another leaf.
    pub(crate) fn new(
        make: impl Fn(&mut LeafContext<'_, '_>) -> Result<Goal, Cause> + Send + Sync + 'static,
    ) -> GoalLeaf {
        GoalLeaf { make: Arc::new(make), results: Arc::new([]), goal: None }
    }

    /// Lets the leaf write the results of its goal to the output ports of their names.
    pub(crate) fn with_results(self, results: Arc<[(String, PortType)]>) -> GoalLeaf {
        GoalLeaf { results, ..self }
    }

    fn begin(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        if !context.cancels_complete() {
            return Ok(NodeStatus::Running);
        }
        let goal = (self.make)(context)?;
        if !goal.repeatable
            && let Some(result) = context.actions().take_completed(&goal)
        {
            return self.complete(&result, context);
        }
        let id = context.actions().send_goal(goal);
        self.goal = Some(id);
        match context.actions().status(id) {
            None => Ok(NodeStatus::Running),
            Some(status) => self.follow(status, context),
        }
    }

    fn follow(&mut self, status: GoalStatus, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        if status.is_final() {
            self.goal = None;
        }
        match status {
            GoalStatus::Sent | GoalStatus::Executing(_) => Ok(NodeStatus::Running),
            GoalStatus::Succeeded(result) => self.complete(&result, context),
            GoalStatus::Canceled => Err(Cause::new("it was canceled from outside")),
            GoalStatus::Aborted(error) => Err(Cause::from(error)),
        }
    }

    /// Writes the values of the result to their ports.
    fn complete(&self, result: &GoalResult, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        for (name, port_type) in &*self.results {
            let problem = |problem: String| Cause::new(format!("the result `{name}` {problem}"));
            let value = result.0.get(name).ok_or_else(|| problem("is missing".to_owned()))?;
            let value = Scalar::from_json(value)
                .ok_or_else(|| problem(format!("is {value}; allowed is a boolean, a number or a text")))?;
            let value =
                Value::from(value).convert(*port_type).map_err(|error| problem(format!("is wrong: {error}")))?;
            context.write(name, value)?;
        }
        Ok(NodeStatus::Success)
    }
}

impl Leaf for GoalLeaf {
    fn tick(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        let Some(goal) = self.goal else { return self.begin(context) };
        match context.actions().status(goal) {
            Some(status) => self.follow(status, context),
            None => {
                self.goal = None;
                Err(Cause::new(format!("the robot no longer reports goal {}", goal.0)))
            }
        }
    }

    fn halt(&mut self, context: &mut LeafContext<'_, '_>) {
        if let Some(goal) = self.goal.take() {
            context.cancel(goal);
        }
    }
}
