//! The leaf that sends a goal, watches it, and cancels it when it is halted.

use crate::actions::{Goal, GoalId, GoalStatus};
use crate::bt::{Cause, Leaf, LeafContext, NodeKind, NodeManifest, NodeStatus, PortSpec, Registry, RegistryError};
use std::sync::Arc;

type MakeGoal = dyn Fn(&mut LeafContext<'_, '_>) -> Result<Goal, Cause> + Send + Sync;

/// Sends a goal made from its ports; runs until the goal ends. One that must not be done twice, and which an earlier attempt
/// at the task has done, counts as done. Before it sends, it waits until the body has let go of whatever the same tree
/// canceled before, since a body at work refuses a second goal as busy.
pub struct GoalLeaf {
    make: Arc<MakeGoal>,
    goal: Option<GoalId>,
}

impl GoalLeaf {
    /// Adds a kind of action whose goal is made by `make` when it begins.
    ///
    /// # Errors
    /// [`RegistryError`] where the name is taken.
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

    /// One whose goal is made like this, as a part of another leaf.
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
                Err(Cause::new(format!("the body no longer knows of goal {}", goal.0)))
            }
        }
    }

    fn halt(&mut self, context: &mut LeafContext<'_, '_>) {
        if let Some(goal) = self.goal.take() {
            context.cancel(goal);
        }
    }
}
