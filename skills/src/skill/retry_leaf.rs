//! A leaf that tries its goal again while it fails for a reason that may pass.

use super::goal_leaf::GoalLeaf;
use crate::actions::{ActionError, ErrorCode, Wait};
use crate::bt::{Cause, Leaf, LeafContext, NodeStatus, PortSpec, PortType};
use consort_protocol::cause::CauseClass;
use consort_protocol::units::Seconds;

/// Pause between attempts, in seconds. A larger value sends fewer goals, and notices later that the reason
/// has passed.
const PAUSE_S: f64 = 1.0;

/// Port for the time for which the goal is tried again.
const TIMEOUT: &str = "timeout_s";

/// Sends a goal. While it fails with `code`, the leaf waits and tries again, for at most the time in port
/// `timeout_s`, or else `timeout_s`. Then it fails with the goal's error. It fails at once on any other
/// error.
pub(crate) struct RetryLeaf {
    goal: GoalLeaf,
    code: ErrorCode,
    timeout_s: f64,
    pause: Option<GoalLeaf>,
    waited_s: f64,
}

impl RetryLeaf {
    /// Returns the port that the leaf has in addition to the ports of its goal.
    pub(crate) fn port() -> PortSpec {
        PortSpec::input(TIMEOUT, PortType::Seconds).optional()
    }

    pub(crate) fn new(goal: GoalLeaf, code: ErrorCode, timeout_s: f64) -> RetryLeaf {
        RetryLeaf { goal, code, timeout_s, pause: None, waited_s: 0.0 }
    }

    fn wait_or_fail(&mut self, context: &mut LeafContext<'_, '_>, cause: Cause) -> Result<NodeStatus, Cause> {
        let timeout_s = context.read_optional::<Seconds>(TIMEOUT)?.map_or(self.timeout_s, Seconds::get);
        if self.waited_s + PAUSE_S <= timeout_s {
            self.waited_s += PAUSE_S;
            let time = Seconds::new(PAUSE_S).expect("a duration");
            let mut pause = GoalLeaf::new(move |_| Ok(Wait { time }.into()));
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
            Err(cause) if cause.error.as_ref().is_some_and(|error| error.code == self.code) => {
                self.wait_or_fail(context, cause)
            }
            result => result,
        }
    }
}

impl Leaf for RetryLeaf {
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
