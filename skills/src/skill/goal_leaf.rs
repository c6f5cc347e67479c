//! The leaf that sends a goal, tracks it, and cancels it on halt.

use crate::actions::{Goal, GoalId, GoalStatus};
use crate::bt::{Cause, Leaf, LeafContext, NodeKind, NodeManifest, NodeStatus, PortSpec, Registry, RegistryError};
use std::sync::Arc;

type MakeGoal = dyn Fn(&mut LeafContext<'_, '_>) -> Result<Goal, Cause> + Send + Sync;

/// Sends a goal made from its ports; runs until the goal ends. A goal that must not be repeated,
/// and which an earlier attempt at the task has completed, counts as completed. Before sending, the
/// leaf waits until the robot has ended all goals that the same tree canceled, since a busy robot
/// rejects a second goal.
pub struct GoalLeaf {
    make: Arc<MakeGoal>,
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
    pub(super) fn new(
        make: impl Fn(&mut LeafContext<'_, '_>) -> Result<Goal, Cause> + Send + Sync + 'static,
    ) -> GoalLeaf {
        GoalLeaf { make: Arc::new(make), goal: None }
    }

    fn begin(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        if !context.cancels_complete() {
            return Ok(NodeStatus::Running);
        }
        let goal = (self.make)(context)?;
        if !goal.is_repeatable() && context.actions().take_completed(&goal) {
            return Ok(NodeStatus::Success);
        }
        let id = context.actions().send_goal(goal);
        self.goal = Some(id);
        match context.actions().status(id) {
            None => Ok(NodeStatus::Running),
            Some(status) => self.follow(status),
        }
    }

    fn follow(&mut self, status: GoalStatus) -> Result<NodeStatus, Cause> {
        if status.is_final() {
            self.goal = None;
        }
        match status {
            GoalStatus::Sent | GoalStatus::Executing(_) => Ok(NodeStatus::Running),
            GoalStatus::Succeeded => Ok(NodeStatus::Success),
            GoalStatus::Canceled => Err(Cause::new("it was canceled from outside")),
            GoalStatus::Aborted(error) => Err(Cause::from(error)),
        }
    }
}

impl Leaf for GoalLeaf {
    fn tick(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        let Some(goal) = self.goal else { return self.begin(context) };
        match context.actions().status(goal) {
            Some(status) => self.follow(status),
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
