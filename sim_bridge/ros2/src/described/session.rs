//! The goals of a driver, as a state machine: it takes the messages of the node, the ends of goals and
//! the time, and returns effects.

use consort_driver::{DriverMessage, NodeMessage, ResultStatus};
use consort_protocol::ids::ActionName;
use consort_skills::actions::{GoalId, JsonObject};
use std::time::Duration;

/// An effect for the caller to perform, in the order given.
#[derive(Debug, Clone, PartialEq)]
pub enum Effect {
    /// Start a goal.
    Start {
        /// Id.
        id: GoalId,
        /// The action.
        action: ActionName,
        /// Its parameters.
        parameters: JsonObject,
        /// True if a previous process has started it.
        resumed: bool,
    },
    /// Stop the robot and end the goal.
    Cancel(GoalId),
    /// Send a message to the node.
    Send(DriverMessage),
    /// End the program.
    Stop,
}

/// How a goal ended.
#[derive(Debug, Clone, PartialEq)]
pub struct End {
    /// Status.
    pub status: ResultStatus,
    /// Reason of a failure.
    pub code: Option<String>,
    /// Cause of a failure, for people.
    pub message: Option<String>,
    /// Results.
    pub results: JsonObject,
}

impl End {
    /// The goal is completed.
    pub fn succeeded(results: JsonObject) -> End {
        End { status: ResultStatus::Succeeded, code: None, message: None, results }
    }

    /// The goal was canceled by request.
    pub fn canceled() -> End {
        End { status: ResultStatus::Canceled, code: None, message: None, results: JsonObject::new() }
    }

    /// The goal failed.
    pub fn aborted(code: &str, message: impl Into<String>) -> End {
        let (code, message) = (Some(code.to_owned()), Some(message.into()));
        End { status: ResultStatus::Aborted, code, message, results: JsonObject::new() }
    }
}

#[derive(Debug)]
struct ActiveGoal {
    id: GoalId,
    /// End of the permission.
    keep_until: Duration,
    canceling: bool,
}

/// See the [module](self).
#[derive(Debug, Default)]
pub struct GoalSession {
    active: Option<ActiveGoal>,
    last: Option<(GoalId, End)>,
}

impl GoalSession {
    /// Returns the goal in progress.
    pub fn active(&self) -> Option<GoalId> {
        self.active.as_ref().map(|active| active.id)
    }

    /// Checks whether there has been no goal.
    pub fn is_unused(&self) -> bool {
        self.active.is_none() && self.last.is_none()
    }

    /// Checks whether the goal with a number has ended, or a later one.
    pub fn has_ended(&self, number: u64) -> bool {
        self.last.as_ref().is_some_and(|(last, _)| last.0 >= number)
    }

    /// Returns the end of the permission of the goal in progress.
    pub fn deadline(&self) -> Option<Duration> {
        self.active.as_ref().filter(|active| !active.canceling).map(|active| active.keep_until)
    }

    /// Handles a message of the node.
    pub fn handle(&mut self, message: NodeMessage, now: Duration) -> Vec<Effect> {
        match message {
            NodeMessage::Start { .. } => vec![],
            NodeMessage::Goal { id, action, parameters, keep_for_ms, resumed, since: _ } => {
                if let Some((last, end)) = self.last.as_ref().filter(|(last, _)| *last == id) {
                    return vec![Effect::Send(result(*last, end.clone()))];
                }
                match &self.active {
                    Some(active) if active.id == id => vec![],
                    Some(_) => vec![Effect::Send(result(id, End::aborted("busy", "the previous goal has not ended")))],
                    None => {
                        let keep_until = now + Duration::from_millis(keep_for_ms);
                        if keep_for_ms == 0 {
                            self.last = Some((id, End::canceled()));
                            return vec![Effect::Send(result(id, End::canceled()))];
                        }
                        self.active = Some(ActiveGoal { id, keep_until, canceling: false });
                        vec![Effect::Start { id, action, parameters, resumed }]
                    }
                }
            }
            NodeMessage::Keep { id, keep_for_ms } => {
                if let Some(active) = self.active.as_mut().filter(|active| active.id == id) {
                    active.keep_until = now + Duration::from_millis(keep_for_ms);
                }
                self.tick(now)
            }
            NodeMessage::Cancel { id } => self.cancel(|active| active.id == id),
            NodeMessage::Heartbeat { sequence } => vec![Effect::Send(DriverMessage::Heartbeat { sequence })],
            NodeMessage::Shutdown {} => self.stop(),
        }
    }

    /// Handles the passage of time: cancels a goal whose permission has passed.
    pub fn tick(&mut self, now: Duration) -> Vec<Effect> {
        self.cancel(|active| active.keep_until <= now)
    }

    /// Stops the robot and ends the program.
    pub fn stop(&mut self) -> Vec<Effect> {
        let mut effects = self.cancel(|_| true);
        effects.push(Effect::Stop);
        effects
    }

    fn cancel(&mut self, applies: impl Fn(&ActiveGoal) -> bool) -> Vec<Effect> {
        match self.active.as_mut().filter(|active| !active.canceling && applies(active)) {
            Some(active) => {
                active.canceling = true;
                vec![Effect::Cancel(active.id)]
            }
            None => vec![],
        }
    }

    /// Handles the end of a goal at the robot.
    pub fn ended(&mut self, id: GoalId, end: End) -> Vec<Effect> {
        let Some(active) = self.active.take_if(|active| active.id == id) else { return vec![] };
        let end = match end.status {
            ResultStatus::Canceled if !active.canceling => {
                End::aborted("failed", "another client of ROS 2 has canceled the goal")
            }
            _ => end,
        };
        self.last = Some((id, end.clone()));
        vec![Effect::Send(result(id, end))]
    }
}

fn result(id: GoalId, end: End) -> DriverMessage {
    let End { status, code, message, results } = end;
    DriverMessage::Result { id, status, code, message, results }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn goal(id: u64, keep_for_ms: u64) -> NodeMessage {
        let action = "wait".parse().unwrap();
        NodeMessage::Goal {
            id: GoalId(id),
            action,
            parameters: JsonObject::new(),
            keep_for_ms,
            resumed: false,
            since: None,
        }
    }

    fn at(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn a_goal_starts_once_and_its_result_is_repeated() {
        let mut session = GoalSession::default();
        assert!(matches!(session.handle(goal(7, 900), at(0))[..], [Effect::Start { id: GoalId(7), .. }]));
        assert_eq!(session.handle(goal(7, 900), at(10)), []);
        let done = result(GoalId(7), End::succeeded(JsonObject::new()));
        assert_eq!(session.ended(GoalId(7), End::succeeded(JsonObject::new())), [Effect::Send(done.clone())]);
        assert_eq!(session.ended(GoalId(7), End::canceled()), []);
        assert_eq!(session.handle(goal(7, 900), at(20)), [Effect::Send(done)]);
    }

    #[test]
    fn a_goal_is_canceled_when_its_permission_passes() {
        let mut session = GoalSession::default();
        session.handle(goal(7, 900), at(0));
        session.handle(NodeMessage::Keep { id: GoalId(7), keep_for_ms: 900 }, at(500));
        assert_eq!((session.tick(at(1_399)), session.deadline()), (vec![], Some(at(1_400))));
        assert_eq!(session.tick(at(1_400)), [Effect::Cancel(GoalId(7))]);
        assert_eq!(session.tick(at(1_500)), [], "once");
        assert_eq!(session.ended(GoalId(7), End::canceled()), [Effect::Send(result(GoalId(7), End::canceled()))]);
        assert_eq!(session.handle(goal(8, 0), at(1_600)), [Effect::Send(result(GoalId(8), End::canceled()))]);
    }

    #[test]
    fn a_second_goal_is_refused_and_a_foreign_cancel_fails_the_goal() {
        let mut session = GoalSession::default();
        session.handle(goal(7, 900), at(0));
        let busy = End::aborted("busy", "the previous goal has not ended");
        assert_eq!(session.handle(goal(8, 900), at(1)), [Effect::Send(result(GoalId(8), busy))]);
        let cause = "another client of ROS 2 has canceled the goal";
        let failed = result(GoalId(7), End::aborted("failed", cause));
        assert_eq!(session.ended(GoalId(7), End::canceled()), [Effect::Send(failed)]);
    }

    #[test]
    fn the_end_of_the_program_cancels_the_goal() {
        let mut session = GoalSession::default();
        session.handle(goal(7, 900), at(0));
        assert_eq!(session.handle(NodeMessage::Shutdown {}, at(1)), [Effect::Cancel(GoalId(7)), Effect::Stop]);
    }
}
