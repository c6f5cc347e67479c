//! A leaf for what takes somebody to be there: who is not is waited for.

use super::{GoalLeaf, TaskContext};
use crate::actions::{ErrorCode, Goal, PERSON_TIMEOUT_S};
use crate::bt::{
    Cause, Leaf, LeafContext, NodeKind, NodeManifest, NodeStatus, PortSpec, PortType, Registry, RegistryError,
};
use consort_protocol::ids::RoleId;
use consort_protocol::units::Seconds;

/// How long to stand and wait before it is tried again, in seconds. Raised: fewer goals, and who comes back is noticed later.
const PAUSE_S: f64 = 1.0;

/// Sends a goal about the person of port `role`. While she is out of reach it waits, at most for port `patience`, or else for
/// [`AWAY_S`], and tries again; then it fails as the goal did. Any other failure is one at once.
pub(super) struct PersonGoalLeaf {
    goal: GoalLeaf,
    pause: Option<GoalLeaf>,
    waited_s: f64,
}

impl PersonGoalLeaf {
    /// Adds a kind of action.
    pub(super) fn register(
        registry: &mut Registry<TaskContext>,
        id: &str,
        make: fn(RoleId) -> Goal,
    ) -> Result<(), RegistryError> {
        let ports =
            [PortSpec::input("role", PortType::Role), PortSpec::input("patience", PortType::Seconds).optional()];
        registry.register(NodeManifest::new(id, NodeKind::Action, ports), move |_: &TaskContext| {
            Box::new(PersonGoalLeaf { goal: asking(make), pause: None, waited_s: 0.0 })
        })
    }

    fn wait_or_fail(&mut self, context: &mut LeafContext<'_, '_>, cause: Cause) -> Result<NodeStatus, Cause> {
        let patience_s = context.read_optional::<Seconds>("patience")?.map_or(PERSON_TIMEOUT_S, Seconds::get);
        if self.waited_s + PAUSE_S <= patience_s {
            self.waited_s += PAUSE_S;
            let time = Seconds::new(PAUSE_S).expect("a duration");
            let mut pause = GoalLeaf::new(move |_| Ok(Goal::Wait { time }));
            if pause.tick(context)? == NodeStatus::Running {
                self.pause = Some(pause);
            } else {
                let now = context.now();
                context.wake_at(now); // the pause is over already: the next tick tries again
            }
            return Ok(NodeStatus::Running);
        }
        let waited_s = self.waited_s;
        let waited = if waited_s > 0.0 { format!("; waited for {waited_s} s") } else { String::new() };
        Err(Cause { text: format!("{}{waited}", cause.text), error: cause.error })
    }

    fn go_on(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        if let Some(pause) = &mut self.pause {
            if pause.tick(context)? == NodeStatus::Running {
                return Ok(NodeStatus::Running);
            }
            self.pause = None;
        }
        match self.goal.tick(context) {
            Err(cause) if cause.error.as_ref().is_some_and(|error| error.code == ErrorCode::OutOfReach) => {
                self.wait_or_fail(context, cause)
            }
            answer => answer,
        }
    }
}

fn asking(make: fn(RoleId) -> Goal) -> GoalLeaf {
    GoalLeaf::new(move |leaf| Ok(make(leaf.read("role")?)))
}

impl Leaf for PersonGoalLeaf {
    fn tick(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        let answer = self.go_on(context);
        if !matches!(answer, Ok(NodeStatus::Running)) {
            (self.pause, self.waited_s) = (None, 0.0);
        }
        answer
    }

    fn halt(&mut self, context: &mut LeafContext<'_, '_>) {
        self.goal.halt(context);
        if let Some(mut pause) = self.pause.take() {
            pause.halt(context);
        }
        self.waited_s = 0.0;
    }
}
