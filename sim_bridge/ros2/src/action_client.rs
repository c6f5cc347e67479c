//! One `NavigateToPose` action client: goals are sent one after the other, and how they go is told as it comes.

use crate::goals::{Status, Uuid};
use crate::messages::{Goal, NavigateToPose, Outcome, Progress};
use crate::ros::{self, RosError};
use hiroz::Builder;
use hiroz::action::messages::{
    CancelGoalServiceRequest, CancelService, FeedbackMessage, GetResultRequest, GoalService, ResultService,
    SendGoalRequest,
};
use hiroz::action::{GoalId, GoalInfo, Time, ZAction};
use hiroz::entity::EndpointKind;
use hiroz::graph::Graph;
use hiroz::msg::ZMessage;
use hiroz::node::ZNode;
use hiroz::pubsub::ZSub;
use hiroz::service::ZClient;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};
use tokio::time::{Instant, sleep};
use tracing::debug;

/// How long a server may take to accept or reject a goal, or to answer a wish to cancel.
const ANSWER: Duration = Duration::from_secs(5);

/// How long a server may be absent from the graph, or know nothing of a result, until its goal counts as lost: longer than a
/// router takes to start anew.
const ABSENCE: Duration = Duration::from_secs(3);

/// How soon a result is asked for again whose query has come to nothing.
const ASK_AGAIN: Duration = Duration::from_millis(200);

/// What came of asking for something to be done.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Answer {
    /// It was accepted.
    Accepted,
    /// The server will not.
    Rejected,
    /// Nobody has answered.
    Nobody,
}

/// How a goal ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum End {
    /// As asked.
    Succeeded,
    /// Stopped because somebody asked for that.
    Canceled,
    /// Otherwise, and what the server says of it.
    Aborted(Outcome),
    /// The server is gone, or no longer knows of it.
    Lost(String),
}

type Feedback = FeedbackMessage<NavigateToPose>;

/// An action client on the ROS 2 graph; it leaves the graph when this is dropped.
pub struct ActionClient {
    name: String,
    graph: Arc<Graph>,
    goal: ZClient<GoalService<NavigateToPose>>,
    cancel: ZClient<CancelService<NavigateToPose>>,
    result: ZClient<ResultService<NavigateToPose>>,
    _feedback: ZSub<Feedback, (), <Feedback as ZMessage>::Serdes>,
}

impl std::fmt::Debug for ActionClient {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ActionClient").field("name", &self.name).finish_non_exhaustive()
    }
}

impl ActionClient {
    /// A client of the action with a fully qualified name, as `/navigate_to_pose`, and what servers say of goals, whosever they
    /// are.
    ///
    /// # Errors
    /// [`RosError`] if the name is none, or the session is closed.
    pub fn of(node: &ZNode, name: &str) -> Result<(ActionClient, UnboundedReceiver<(Uuid, Progress)>), RosError> {
        let part = |part: &str| format!("{name}/_action/{part}");
        let failed = |problem| RosError::of(format!("be a client of {name}"), problem);
        let goal = node
            .create_client::<GoalService<NavigateToPose>>(&part("send_goal"))
            .with_qos(ros::services())
            .build()
            .map_err(failed)?;
        let cancel = node
            .create_client::<CancelService<NavigateToPose>>(&part("cancel_goal"))
            .with_qos(ros::services())
            .build()
            .map_err(failed)?;
        let result = node
            .create_client::<ResultService<NavigateToPose>>(&part("get_result"))
            .with_qos(ros::services())
            .build()
            .map_err(failed)?;
        let (told, heard) = unbounded_channel();
        let feedback = node
            .create_sub_impl::<Feedback>(&part("feedback"), Some(NavigateToPose::feedback_type_info()))
            .with_qos(ros::feedback())
            .build_with_callback(move |message: Feedback| {
                // Nobody listens any more: the subscription is about to end.
                let _ = told.send((*message.goal_id.as_bytes(), message.feedback));
            })
            .map_err(failed)?;
        let graph = Arc::clone(node.graph());
        Ok((ActionClient { name: name.to_owned(), graph, goal, cancel, result, _feedback: feedback }, heard))
    }

    /// Whether a server of the action is on the graph.
    pub fn is_served(&self) -> bool {
        self.graph.count_by_service(EndpointKind::Service, format!("{}/_action/send_goal", self.name)) > 0
    }

    /// Sends a goal under a name that was never used.
    pub async fn send(&self, id: Uuid, goal: Goal) -> Answer {
        let request = SendGoalRequest { goal_id: GoalId::from_bytes(id), goal };
        match self.goal.call_with_timeout(&request, ANSWER).await {
            Ok(response) if response.accepted => Answer::Accepted,
            Ok(_) => Answer::Rejected,
            Err(problem) => {
                debug!(action = self.name, %problem, "a goal was not answered");
                Answer::Nobody
            }
        }
    }

    /// Wishes a goal ended. That it has ended is another matter: see [`result`](Self::result).
    pub async fn cancel(&self, id: Uuid) -> Answer {
        let goal_info = GoalInfo { goal_id: GoalId::from_bytes(id), stamp: Time::zero() };
        match self.cancel.call_with_timeout(&CancelGoalServiceRequest { goal_info }, ANSWER).await {
            Ok(response) if response.return_code == 0 => Answer::Accepted,
            Ok(_) => Answer::Rejected,
            Err(problem) => {
                debug!(action = self.name, %problem, "a wish to cancel was not answered");
                Answer::Nobody
            }
        }
    }

    /// Waits until a goal that was accepted has ended, for as long as its server is on the graph.
    pub async fn result(&self, id: Uuid) -> End {
        let request = GetResultRequest { goal_id: GoalId::from_bytes(id) };
        let mut absent: Option<Instant> = None;
        loop {
            // A query comes to nothing when its time is up, and at once when its server is gone.
            match self.result.call(&request).await {
                Ok(response) => return end(response.status, response.result),
                Err(problem) => debug!(action = self.name, %problem, "a result was not answered"),
            }
            if self.is_served() {
                absent = None;
            } else if absent.get_or_insert_with(Instant::now).elapsed() >= ABSENCE {
                return End::Lost(format!("there is no server of {} any more", self.name));
            }
            sleep(ASK_AGAIN).await;
        }
    }
}

fn end(status: i8, outcome: Outcome) -> End {
    match status {
        status if status == Status::Succeeded as i8 => End::Succeeded,
        status if status == Status::Canceled as i8 => End::Canceled,
        status if status == Status::Aborted as i8 => End::Aborted(outcome),
        other => End::Lost(format!("the server knows nothing of the goal: its status is {other}")),
    }
}
