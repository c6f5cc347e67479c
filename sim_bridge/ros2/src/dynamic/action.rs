//! Goals of ROS 2 actions with any type.
//!
//! The id of a goal contains the robot and the number of the goal in the fleet, so that the next
//! process finds the goals of a previous one.

use super::cdr::CdrError;
use super::graph::{CallError, EndpointKind, Graph, Received, Subscription};
use crate::goals::{GoalUuid, Status};
use crate::ros::RosError;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::UnboundedSender;
use tokio::time::{Instant, sleep};
use tracing::debug;

/// Time limit for a server to accept or reject a goal, or to reply to a cancel request.
const REPLY_TIMEOUT: Duration = Duration::from_secs(5);

/// Time without a result after which a goal counts as in progress.
const KNOWN_TIMEOUT: Duration = Duration::from_secs(1);

/// Time limit of a request for a result. It is repeated.
const RESULT_TIMEOUT: Duration = Duration::from_secs(3600);

/// Time for which a server may be absent from the graph until its goal is lost.
const SERVER_LOST_AFTER: Duration = Duration::from_secs(3);

/// Interval at which a failed request for a result is repeated.
const RETRY_INTERVAL: Duration = Duration::from_millis(200);

/// Returns the id of a robot's goal: seven bytes of the robot, the attempt, then the number. The attempt is
/// not 0 if the server knows the goal of the attempt before.
pub fn goal_uuid(robot: &str, goal: u64, attempt: u8) -> GoalUuid {
    let mut id = [0; 16];
    id[..7].copy_from_slice(&robot_part(robot));
    id[7] = attempt;
    id[8..].copy_from_slice(&goal.to_be_bytes());
    id
}

/// Returns the number and the attempt of a goal of the robot; `None` for a goal of another client.
pub fn goal_of_uuid(id: &[u8], robot: &str) -> Option<(u64, u8)> {
    let (own, number) = id.split_at_checked(8)?;
    let number = u64::from_be_bytes(number.try_into().ok()?);
    (own[..7] == robot_part(robot)).then_some((number, own[7]))
}

fn robot_part(robot: &str) -> [u8; 7] {
    let mut part = [0; 7];
    part.copy_from_slice(&Sha256::digest(format!("consort/{robot}"))[..7]);
    part
}

/// How a goal of an action ended.
#[derive(Debug, Clone, PartialEq)]
pub enum ActionEnd {
    /// With this status and result.
    Ended(Status, Value),
    /// The server does not know the goal.
    Unknown,
    /// The server rejected the goal.
    Rejected,
    /// No server offers the action, or it is gone.
    Lost(String),
    /// The goal does not fit the type of the action.
    Invalid(String),
}

/// An action on the graph.
#[derive(Debug, Clone)]
pub struct RosAction {
    graph: Arc<Graph>,
    name: String,
    type_name: String,
}

impl RosAction {
    /// Creates a client of the action with a fully qualified name.
    pub fn new(graph: Arc<Graph>, name: String, type_name: String) -> RosAction {
        RosAction { graph, name, type_name }
    }

    /// Checks whether the other is a client of the same action.
    pub fn is_same(&self, other: &RosAction) -> bool {
        self.name == other.name
    }

    fn part(&self, part: &str) -> String {
        format!("{}/_action/{part}", self.name)
    }

    /// Checks whether a server of the action is on the graph.
    pub fn is_served(&self) -> bool {
        self.graph.find(EndpointKind::Server, &self.part("send_goal")).is_some()
    }

    /// Subscribes to the feedback of all goals.
    ///
    /// # Errors
    /// [`RosError`] if the session is closed.
    pub async fn feedback(&self, number: usize, to: UnboundedSender<Received>) -> Result<Subscription, RosError> {
        let type_name = format!("{}_FeedbackMessage", self.type_name);
        self.graph.subscribe(&self.part("feedback"), &type_name, number, to).await
    }

    /// Subscribes to the states of all goals.
    ///
    /// # Errors
    /// [`RosError`] if the session is closed.
    pub async fn status(&self, number: usize, to: UnboundedSender<Received>) -> Result<Subscription, RosError> {
        self.graph.subscribe(&self.part("status"), "action_msgs/msg/GoalStatusArray", number, to).await
    }

    /// Sends a goal and waits for its end.
    pub async fn execute(&self, id: GoalUuid, goal: &Value) -> ActionEnd {
        let request = json!({"goal_id": {"uuid": id}, "goal": goal});
        let type_name = format!("{}_SendGoal", self.type_name);
        match self.graph.call(&self.part("send_goal"), &type_name, &request, REPLY_TIMEOUT).await {
            Ok(reply) if reply["accepted"] == true => self.result(id).await,
            Ok(_) => ActionEnd::Rejected,
            Err(CallError::Message(CdrError::Bytes(problem))) => ActionEnd::Lost(problem),
            Err(CallError::Message(problem)) => ActionEnd::Invalid(problem.to_string()),
            Err(problem) => ActionEnd::Lost(problem.to_string()),
        }
    }

    /// Checks whether the server knows a goal, in progress or ended.
    pub async fn knows(&self, id: GoalUuid) -> bool {
        let request = json!({"goal_id": {"uuid": id}});
        let type_name = format!("{}_GetResult", self.type_name);
        match self.graph.call(&self.part("get_result"), &type_name, &request, KNOWN_TIMEOUT).await {
            Ok(reply) => reply["status"].as_i64() != Some(i64::from(Status::Unknown as i8)),
            // The reply arrives at the end of the goal.
            Err(CallError::NoReply(_)) => true,
            Err(_) => false,
        }
    }

    /// Waits for the end of an accepted goal, for as long as its server is on the graph.
    pub async fn result(&self, id: GoalUuid) -> ActionEnd {
        let request = json!({"goal_id": {"uuid": id}});
        let type_name = format!("{}_GetResult", self.type_name);
        let mut absent: Option<Instant> = None;
        loop {
            match self.graph.call(&self.part("get_result"), &type_name, &request, RESULT_TIMEOUT).await {
                Ok(mut reply) => return ended(reply["status"].as_i64(), reply["result"].take()),
                Err(problem) => debug!(action = self.name, %problem, "no reply to a request for a result"),
            }
            if self.is_served() {
                absent = None;
            } else if absent.get_or_insert_with(Instant::now).elapsed() >= SERVER_LOST_AFTER {
                return ActionEnd::Lost(format!("the server of {} is gone", self.name));
            }
            sleep(RETRY_INTERVAL).await;
        }
    }

    /// Requests the cancellation of a goal. Returns false without a reply.
    pub async fn cancel(&self, id: GoalUuid) -> bool {
        let request = json!({"goal_info": {"goal_id": {"uuid": id}}});
        let service = self.part("cancel_goal");
        match self.graph.call(&service, "action_msgs/srv/CancelGoal", &request, REPLY_TIMEOUT).await {
            Ok(_) => true,
            Err(problem) => {
                debug!(action = self.name, %problem, "no reply to a cancel request");
                false
            }
        }
    }
}

fn ended(status: Option<i64>, result: Value) -> ActionEnd {
    let is = |state: Status| status == Some(i64::from(state as i8));
    match [Status::Succeeded, Status::Canceled, Status::Aborted].into_iter().find(|state| is(*state)) {
        Some(state) => ActionEnd::Ended(state, result),
        None => ActionEnd::Unknown,
    }
}

/// Returns the id in a `unique_identifier_msgs/msg/UUID`.
pub fn uuid_of(message: &Value) -> Option<GoalUuid> {
    let bytes = message["uuid"].as_array()?;
    let bytes: Vec<u8> = bytes.iter().filter_map(|byte| u8::try_from(byte.as_u64()?).ok()).collect();
    GoalUuid::try_from(bytes).ok()
}

/// Returns the goals of a robot that are in progress, from a message with the states of goals.
pub fn goals_in_progress(statuses: &Value, robot: &str) -> Vec<GoalUuid> {
    let statuses = statuses["status_list"].as_array().into_iter().flatten();
    // Accepted, executing, canceling.
    let in_progress = statuses.filter(|goal| (1..=3).contains(&goal["status"].as_i64().unwrap_or_default()));
    let ids = in_progress.filter_map(|goal| uuid_of(&goal["goal_info"]["goal_id"]));
    ids.filter(|id| goal_of_uuid(id, robot).is_some()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_goals_of_a_robot_are_told_from_those_of_others() {
        let id = goal_uuid("ada", 7, 2);
        assert_eq!(&id[7..], &[2, 0, 0, 0, 0, 0, 0, 0, 7]);
        assert_eq!(goal_of_uuid(&id, "ada"), Some((7, 2)));
        let others = [goal_of_uuid(&id, "bob"), goal_of_uuid(&[0; 16], "ada"), goal_of_uuid(&id[..9], "ada")];
        assert_eq!(others, [None; 3]);
        let goal = |id: GoalUuid, status: i8| json!({"goal_info": {"goal_id": {"uuid": id}}, "status": status});
        let list = [goal(id, 2), goal(goal_uuid("ada", 6, 0), 4), goal(goal_uuid("bob", 1, 0), 2), goal([0; 16], 2)];
        assert_eq!(goals_in_progress(&json!({"status_list": list}), "ada"), [id]);
    }
}
