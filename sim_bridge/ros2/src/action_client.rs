//! A `NavigateToPose` action client: goals are sent one after another, and feedback is forwarded as
//! it arrives.

use crate::goals::{GoalUuid, Status};
use crate::messages::{Goal, NavigateResult, NavigateToPose, Progress};
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

/// Time limit for a server to accept or reject a goal, or to reply to a cancel request.
const REPLY_TIMEOUT: Duration = Duration::from_secs(5);

/// Time for which a server may be absent from the graph, or without the result, until its goal is
/// lost: longer than the restart of a router.
const SERVER_LOST_AFTER: Duration = Duration::from_secs(3);

/// Interval at which a failed result query is repeated.
const RESULT_RETRY_INTERVAL: Duration = Duration::from_millis(200);

/// Reply to a goal or a cancel request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RequestResult {
    /// The request was accepted.
    Accepted,
    /// The server rejected the request.
    Rejected,
    /// No server replied.
    NoReply,
}

/// Result of a drive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DriveResult {
    /// The goal was reached.
    Succeeded,
    /// The goal was canceled by request.
    Canceled,
    /// The goal ended otherwise, with the result of the server.
    Aborted(NavigateResult),
    /// The server is gone, or the goal is unknown to it.
    Lost(String),
}

type Feedback = FeedbackMessage<NavigateToPose>;

/// An action client on the ROS 2 graph. Dropping it removes it from the graph.
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
    /// Creates a client of the action with a fully qualified name, for example `/navigate_to_pose`.
    /// The receiver returns the feedback for all goals, including those of other clients.
    ///
    /// # Errors
    /// [`RosError`] if the name is invalid, or the session is closed.
    pub fn of(node: &ZNode, name: &str) -> Result<(ActionClient, UnboundedReceiver<(GoalUuid, Progress)>), RosError> {
        let part = |part: &str| format!("{name}/_action/{part}");
        let failed = |problem| RosError::of(format!("create a client of {name}"), problem);
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
        let (feedback_sender, feedback_receiver) = unbounded_channel();
        let feedback = node
            .create_sub_impl::<Feedback>(&part("feedback"), Some(NavigateToPose::feedback_type_info()))
            .with_qos(ros::feedback())
            .build_with_callback(move |message: Feedback| {
                // Without a receiver the subscription is about to end.
                let _ = feedback_sender.send((*message.goal_id.as_bytes(), message.feedback));
            })
            .map_err(failed)?;
        let graph = Arc::clone(node.graph());
        Ok((
            ActionClient { name: name.to_owned(), graph, goal, cancel, result, _feedback: feedback },
            feedback_receiver,
        ))
    }

    /// Checks whether a server of the action is on the graph.
    pub fn is_served(&self) -> bool {
        self.graph.count_by_service(EndpointKind::Service, format!("{}/_action/send_goal", self.name)) > 0
    }

    /// Sends a goal with a new id.
    pub async fn send(&self, id: GoalUuid, goal: Goal) -> RequestResult {
        let request = SendGoalRequest { goal_id: GoalId::from_bytes(id), goal };
        match self.goal.call_with_timeout(&request, REPLY_TIMEOUT).await {
            Ok(response) if response.accepted => RequestResult::Accepted,
            Ok(_) => RequestResult::Rejected,
            Err(problem) => {
                debug!(action = self.name, %problem, "no reply to a goal");
                RequestResult::NoReply
            }
        }
    }

    /// Requests the cancellation of a goal. [`result`](Self::result) returns when it has ended.
    pub async fn cancel(&self, id: GoalUuid) -> RequestResult {
        let goal_info = GoalInfo { goal_id: GoalId::from_bytes(id), stamp: Time::zero() };
        match self.cancel.call_with_timeout(&CancelGoalServiceRequest { goal_info }, REPLY_TIMEOUT).await {
            Ok(response) if response.return_code == 0 => RequestResult::Accepted,
            Ok(_) => RequestResult::Rejected,
            Err(problem) => {
                debug!(action = self.name, %problem, "no reply to a cancel request");
                RequestResult::NoReply
            }
        }
    }

    /// Requests the cancellation of all goals at the server, including those of other clients.
    pub async fn cancel_all(&self) -> RequestResult {
        self.cancel(GoalUuid::default()).await
    }

    /// Waits until an accepted goal has ended, for as long as its server is on the graph.
    pub async fn result(&self, id: GoalUuid) -> DriveResult {
        let request = GetResultRequest { goal_id: GoalId::from_bytes(id) };
        let mut absent: Option<Instant> = None;
        loop {
            // A query fails when its time limit passes, and at once when its server is gone.
            match self.result.call(&request).await {
                Ok(response) => return drive_result(response.status, response.result),
                Err(problem) => debug!(action = self.name, %problem, "no reply to a result query"),
            }
            if self.is_served() {
                absent = None;
            } else if absent.get_or_insert_with(Instant::now).elapsed() >= SERVER_LOST_AFTER {
                return DriveResult::Lost(format!("the server of {} is gone", self.name));
            }
            sleep(RESULT_RETRY_INTERVAL).await;
        }
    }
}

fn drive_result(status: i8, outcome: NavigateResult) -> DriveResult {
    match status {
        status if status == Status::Succeeded as i8 => DriveResult::Succeeded,
        status if status == Status::Canceled as i8 => DriveResult::Canceled,
        status if status == Status::Aborted as i8 => DriveResult::Aborted(outcome),
        other => DriveResult::Lost(format!("the server does not have the goal: its status is {other}")),
    }
}
