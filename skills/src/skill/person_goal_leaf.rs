//! A leaf for goals that require a person to be present. It waits for an absent person.

use super::context::TaskContext;
use super::goal_leaf::GoalLeaf;
use crate::actions::{ActionError, ErrorCode, Goal, PERSON_TIMEOUT_S};
use crate::bt::{
    Cause, Leaf, LeafContext, NodeKind, NodeManifest, NodeStatus, PortSpec, PortType, Registry, RegistryError,
};
use consort_protocol::cause::CauseClass;
use consort_protocol::ids::RoleId;
use consort_protocol::units::Seconds;

/// Pause between attempts, in seconds. A larger value sends fewer goals, and notices a returning
/// person later.
const PAUSE_S: f64 = 1.0;

/// Sends a goal about the person in port `role`. While the person is out of reach, the leaf waits
/// and tries again, for at most the time in port `timeout_s`, or else [`PERSON_TIMEOUT_S`].
/// Then it fails with the goal's error. It fails at once on any other error.
pub(super) struct PersonGoalLeaf {
    goal: GoalLeaf,
    pause: Option<GoalLeaf>,
    waited_s: f64,
}

impl PersonGoalLeaf {
    /// Registers an action.
    pub(super) fn register(
        registry: &mut Registry<TaskContext>,
        id: &str,
        make: fn(RoleId) -> Goal,
    ) -> Result<(), RegistryError> {
        let ports =
            [PortSpec::input("role", PortType::Role), PortSpec::input("timeout_s", PortType::Seconds).optional()];
        registry.register(NodeManifest::new(id, NodeKind::Action, ports), move |_: &TaskContext| {
            Box::new(PersonGoalLeaf { goal: person_goal(make), pause: None, waited_s: 0.0 })
        })
    }

    fn wait_or_fail(&mut self, context: &mut LeafContext<'_, '_>, cause: Cause) -> Result<NodeStatus, Cause> {
        let timeout_s = context.read_optional::<Seconds>("timeout_s")?.map_or(PERSON_TIMEOUT_S, Seconds::get);
        if self.waited_s + PAUSE_S <= timeout_s {
            self.waited_s += PAUSE_S;
            let time = Seconds::new(PAUSE_S).expect("a duration");
            let mut pause = GoalLeaf::new(move |_| Ok(Goal::Wait { time }));
            // If the pause has already ended, the next tick tries again.
            if pause.tick(context)? == NodeStatus::Running {
                self.pause = Some(pause);
            }
            return Ok(NodeStatus::Running);
        }
        let waited_s = self.waited_s;
        let waited = if waited_s > 0.0 { format!("; waited for {waited_s} s") } else { String::new() };
        // Every other robot would wait as long.
        let error = cause.error.map(|error| ActionError { class: CauseClass::Task, ..error });
        Err(Cause { text: format!("{}{waited}", cause.text), error })
    }

    fn advance(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
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
            result => result,
        }
    }
}

fn person_goal(make: fn(RoleId) -> Goal) -> GoalLeaf {
    GoalLeaf::new(move |leaf| Ok(make(leaf.read("role")?)))
}

impl Leaf for PersonGoalLeaf {
    fn tick(&mut self, context: &mut LeafContext<'_, '_>) -> Result<NodeStatus, Cause> {
        let result = self.advance(context);
        if !matches!(result, Ok(NodeStatus::Running)) {
            (self.pause, self.waited_s) = (None, 0.0);
        }
        result
    }

    fn halt(&mut self, context: &mut LeafContext<'_, '_>) {
        self.goal.halt(context);
        if let Some(mut pause) = self.pause.take() {
            pause.halt(context);
        }
        self.waited_s = 0.0;
    }
}
