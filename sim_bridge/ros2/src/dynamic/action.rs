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

/// Time limit of a request for a result. It is repeated.
const RESULT_TIMEOUT: Duration = Duration::from_secs(3600);

/// Time for which a server may be absent from the graph until its goal is lost.
const SERVER_LOST_AFTER: Duration = Duration::from_secs(3);

/// Interval at which a failed request for a result is repeated.
const RETRY_INTERVAL: Duration = Duration::from_millis(200);

/// Returns the id of a robot's goal: eight bytes of the robot, then the number.
pub fn goal_uuid(robot: &str, goal: u64) -> GoalUuid {
    let mut id = [0; 16];
    id[..8].copy_from_slice(&robot_part(robot));
    id[8..].copy_from_slice(&goal.to_be_bytes());
    id
}

/// Checks whether a goal belongs to the robot.
pub fn is_of_robot(id: &[u8], robot: &str) -> bool {
    id.len() == 16 && id[..8] == robot_part(robot)
}

fn robot_part(robot: &str) -> [u8; 8] {
    let mut part = [0; 8];
    part.copy_from_slice(&Sha256::digest(format!("consort/{robot}"))[..8]);
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

/// Returns the goals of a robot that are in progress, from a message with the states of goals.
pub fn goals_in_progress(statuses: &Value, robot: &str) -> Vec<GoalUuid> {
    let statuses = statuses["status_list"].as_array().into_iter().flatten();
    // Accepted, executing, canceling.
    let in_progress = statuses.filter(|goal| (1..=3).contains(&goal["status"].as_i64().unwrap_or_default()));
    let ids = in_progress.filter_map(|goal| {
        let bytes = goal["goal_info"]["goal_id"]["uuid"].as_array()?;
        let bytes: Vec<u8> = bytes.iter().filter_map(|byte| u8::try_from(byte.as_u64()?).ok()).collect();
        GoalUuid::try_from(bytes).ok()
    });
    ids.filter(|id| is_of_robot(id, robot)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_goals_of_a_robot_are_told_from_those_of_others() {
        let id = goal_uuid("ada", 7);
        assert_eq!(&id[8..], &[0, 0, 0, 0, 0, 0, 0, 7]);
        assert!(is_of_robot(&id, "ada") && !is_of_robot(&id, "bob") && !is_of_robot(&[0; 16], "ada"));
        let goal = |id: GoalUuid, status: i8| json!({"goal_info": {"goal_id": {"uuid": id}}, "status": status});
        let list = [goal(id, 2), goal(goal_uuid("ada", 6), 4), goal(goal_uuid("bob", 1), 2), goal([0; 16], 2)];
        assert_eq!(goals_in_progress(&json!({"status_list": list}), "ada"), [id]);
    }
}
