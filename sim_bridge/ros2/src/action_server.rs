//! A `NavigateToPose` action server: three services and two topics on the ROS 2 graph, controlled
//! by [`GoalTable`].
//!
//! hiroz has action servers as well. They reply "rejected" to a successful cancel request or, with
//! a handler, process no cancel request while a result is awaited, which a ROS 2 client does from
//! the start; and a query without attachment stops them. So only its services and topics are used.

use crate::goals::{EndState, GoalTable, GoalUuid, Status};
use crate::mapping;
use crate::messages::{Goal, NavigateResult, NavigateToPose, Progress, Time};
use crate::ros::{self, RosError};
use hiroz::Builder;
use hiroz::action::messages::{
    CancelGoalServiceResponse, CancelService, FeedbackMessage, GetResultResponse, GoalService, GoalStatusInfo,
    ResultService, SendGoalResponse, StatusMessage,
};
use hiroz::action::{GoalId, GoalInfo, GoalStatus, ZAction};
use hiroz::msg::{ZDeserializer, ZMessage, ZService};
use hiroz::node::ZNode;
use hiroz::pubsub::ZPub;
use hiroz::service::{ServiceReply, ServiceRequest, ZServer};
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior};
use tracing::{debug, info, warn};

/// Time for which a result remains available: the default of `rcl_action`.
const RESULTS_KEPT: Duration = Duration::from_secs(10);

/// Request of a client.
#[derive(Debug, Clone, PartialEq)]
pub enum ClientRequest {
    /// A goal was accepted and must be executed.
    Execute(GoalUuid, Goal),
    /// A goal must be canceled. Repeated as often as clients request it.
    Cancel(GoalUuid),
}

/// Update of a goal by its executor.
#[derive(Debug, Clone, PartialEq)]
pub enum GoalUpdate {
    /// Feedback of a goal.
    Progress(GoalUuid, Progress),
    /// The goal has ended. Only the first end counts.
    Ended(GoalUuid, EndState, NavigateResult),
}

/// An action server on the ROS 2 graph. Dropping it removes it from the graph.
#[derive(Debug)]
pub struct ActionServer {
    updates: UnboundedSender<GoalUpdate>,
    requests_to_executor: UnboundedReceiver<ClientRequest>,
    _forwarders: JoinSet<()>,
    /// Answers the requests, until there are no more updates.
    state: JoinSet<()>,
}

type Feedback = FeedbackMessage<NavigateToPose>;
type GoalRequest = ServiceRequest<GoalService<NavigateToPose>>;
type CancelRequest = ServiceRequest<CancelService<NavigateToPose>>;
type ResultRequest = ServiceRequest<ResultService<NavigateToPose>>;

enum Request {
    Goal(GoalRequest),
    Cancel(CancelRequest),
    Result(ResultRequest),
}

struct State {
    goals: GoalTable<NavigateResult>,
    feedback: ZPub<Feedback, <Feedback as ZMessage>::Serdes>,
    status: ZPub<StatusMessage, <StatusMessage as ZMessage>::Serdes>,
    /// Pending requests for results.
    awaiting: BTreeMap<GoalUuid, Vec<ServiceReply<ResultService<NavigateToPose>>>>,
    requests_to_executor: UnboundedSender<ClientRequest>,
    since: Instant,
}

impl ActionServer {
    /// Offers the action under a fully qualified name, for example `/ada/navigate_to_pose`.
    ///
    /// # Errors
    /// [`RosError`] if the name is invalid, or the session is closed.
    pub fn offer(node: &ZNode, name: &str) -> Result<ActionServer, RosError> {
        let part = |part: &str| format!("{name}/_action/{part}");
        let failed = |problem| RosError::of(format!("offer {name}"), problem);
        let goal = node
            .create_service_impl::<GoalService<NavigateToPose>>(
                &part("send_goal"),
                Some(NavigateToPose::send_goal_type_info()),
            )
            .with_qos(ros::services())
            .build()
            .map_err(failed)?;
        let cancel = node
            .create_service_impl::<CancelService<NavigateToPose>>(
                &part("cancel_goal"),
                Some(NavigateToPose::cancel_goal_type_info()),
            )
            .with_qos(ros::services())
            .build()
            .map_err(failed)?;
        let result = node
            .create_service_impl::<ResultService<NavigateToPose>>(
                &part("get_result"),
                Some(NavigateToPose::get_result_type_info()),
            )
            .with_qos(ros::services())
            .build()
            .map_err(failed)?;
        let feedback = node
            .create_pub_impl::<Feedback>(&part("feedback"), Some(NavigateToPose::feedback_type_info()))
            .with_qos(ros::feedback())
            .build()
            .map_err(failed)?;
        let status = node
            .create_pub_impl::<StatusMessage>(&part("status"), Some(NavigateToPose::status_type_info()))
            .with_qos(ros::status())
            .build()
            .map_err(failed)?;

        let (next_request, requests_to_executor) = unbounded_channel();
        let (updates, update) = unbounded_channel();
        let (requests, request) = unbounded_channel();
        let mut forwarders = JoinSet::new();
        forwarders.spawn(forward_requests(goal, requests.clone(), Request::Goal));
        forwarders.spawn(forward_requests(cancel, requests.clone(), Request::Cancel));
        forwarders.spawn(forward_requests(result, requests, Request::Result));
        let goals = GoalTable::new(RESULTS_KEPT);
        let state = State {
            goals,
            feedback,
            status,
            awaiting: BTreeMap::new(),
            requests_to_executor: next_request,
            since: Instant::now(),
        };
        let mut state_task = JoinSet::new();
        state_task.spawn(state.run(request, update));
        info!(action = name, "action offered");
        Ok(ActionServer { updates, requests_to_executor, _forwarders: forwarders, state: state_task })
    }

    /// Returns the next request of a client.
    pub async fn next_request(&mut self) -> Option<ClientRequest> {
        self.requests_to_executor.recv().await
    }

    /// Applies all updates, aborts the goals that are still in progress, sends the results, and removes
    /// the action from the graph.
    pub async fn close(mut self) {
        drop(self.updates);
        self.state.join_next().await;
    }

    /// Applies an update of a goal.
    pub fn apply(&self, update: GoalUpdate) {
        // Without its task the server is being dropped, and the update is not needed.
        let _ = self.updates.send(update);
    }
}

/// Forwards requests. Unreadable requests are dropped without a reply, as ROS 2 does.
async fn forward_requests<S: ZService>(
    mut server: ZServer<S>,
    requests: UnboundedSender<Request>,
    wrap: fn(ServiceRequest<S>) -> Request,
) where
    S::Request: ZMessage + Send + Sync + 'static,
    for<'a> <S::Request as ZMessage>::Serdes: ZDeserializer<Output = S::Request, Input<'a> = &'a [u8]>,
{
    loop {
        match server.async_take_request().await {
            Ok(request) => {
                if requests.send(wrap(request)).is_err() {
                    return;
                }
            }
            Err(problem) => warn!(?server, %problem, "unreadable request"),
        }
    }
}

impl State {
    async fn run(mut self, mut requests: UnboundedReceiver<Request>, mut updates: UnboundedReceiver<GoalUpdate>) {
        let mut tick = tokio::time::interval(Duration::from_secs(1));
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                Some(request) = requests.recv() => match request {
                    Request::Goal(request) => self.accept(request).await,
                    Request::Cancel(request) => self.cancel(request).await,
                    Request::Result(request) => self.result(request).await,
                },
                update = updates.recv() => match update {
                    Some(GoalUpdate::Progress(goal, progress)) => self.publish_feedback(goal, progress).await,
                    Some(GoalUpdate::Ended(goal, status_of_end, outcome)) => self.end(goal, status_of_end, outcome).await,
                    None => return self.abort_all().await,
                },
                _ = tick.tick() => {
                    if self.goals.remove_expired(self.since.elapsed()) {
                        self.publish_status().await;
                    }
                }
            }
        }
    }

    async fn accept(&mut self, request: GoalRequest) {
        let (message, reply) = request.into_parts();
        let (goal, stamp) = (*message.goal_id.as_bytes(), mapping::now());
        let accepted = self.goals.accept(goal, stamp);
        let response = SendGoalResponse { accepted, stamp_sec: stamp.sec, stamp_nanosec: stamp.nanosec };
        if let Err(problem) = reply.reply(&response).await {
            debug!(%problem, "the reply to a goal was not sent");
        }
        if accepted {
            self.publish_status().await;
            let _ = self.requests_to_executor.send(ClientRequest::Execute(goal, message.goal));
        }
    }

    async fn cancel(&mut self, request: CancelRequest) {
        let (message, reply) = request.into_parts();
        let info = message.goal_info;
        let up_to = Time { sec: info.stamp.sec, nanosec: info.stamp.nanosec };
        let (code, stopping) = self.goals.cancel(*info.goal_id.as_bytes(), up_to);
        let goals_canceling = stopping.iter().map(|(goal, accepted)| goal_info(*goal, *accepted)).collect();
        let response = CancelGoalServiceResponse { return_code: code as i8, goals_canceling };
        if let Err(problem) = reply.reply(&response).await {
            debug!(%problem, "the reply to a cancel request was not sent");
        }
        if !stopping.is_empty() {
            self.publish_status().await;
        }
        for (goal, _) in stopping {
            let _ = self.requests_to_executor.send(ClientRequest::Cancel(goal));
        }
    }

    async fn result(&mut self, request: ResultRequest) {
        let (message, reply) = request.into_parts();
        let goal = *message.goal_id.as_bytes();
        match self.goals.result(goal) {
            Some((status, outcome)) => send_result(reply, status, outcome).await,
            None => self.awaiting.entry(goal).or_default().push(reply),
        }
    }

    async fn publish_feedback(&self, goal: GoalUuid, progress: Progress) {
        if !self.goals.is_in_progress(goal) {
            return;
        }
        let message = FeedbackMessage { goal_id: GoalId::from_bytes(goal), feedback: progress };
        if let Err(problem) = self.feedback.async_publish(&message).await {
            warn!(%problem, "feedback was not published");
        }
    }

    async fn end(&mut self, goal: GoalUuid, status_of_end: EndState, outcome: NavigateResult) {
        if !self.goals.end(goal, status_of_end, outcome, self.since.elapsed()) {
            return;
        }
        self.publish_status().await;
        let Some((status, outcome)) = self.goals.result(goal) else { return };
        for reply in self.awaiting.remove(&goal).unwrap_or_default() {
            send_result(reply, status, outcome.clone()).await;
        }
    }

    /// Aborts the goals in progress: their clients wait for a result.
    async fn abort_all(&mut self) {
        let goals: Vec<GoalUuid> = self.goals.statuses().map(|(goal, ..)| goal).collect();
        for goal in goals {
            let outcome = NavigateResult {
                error_code: mapping::UNKNOWN_ERROR,
                error_msg: "the action server is stopping".to_owned(),
            };
            self.end(goal, EndState::Aborted, outcome).await;
        }
    }

    async fn publish_status(&self) {
        let info = |(goal, accepted, status)| GoalStatusInfo {
            goal_info: goal_info(goal, accepted),
            status: to_ros_status(status),
        };
        let message = StatusMessage { status_list: self.goals.statuses().map(info).collect() };
        if let Err(problem) = self.status.async_publish(&message).await {
            warn!(%problem, "the status of goals was not published");
        }
    }
}

async fn send_result(reply: ServiceReply<ResultService<NavigateToPose>>, status: Status, result: NavigateResult) {
    // The client may be gone, or may have repeated its request.
    if let Err(problem) = reply.reply(&GetResultResponse { status: status as i8, result }).await {
        debug!(%problem, "a result was not sent");
    }
}

fn goal_info(goal: GoalUuid, accepted: Time) -> GoalInfo {
    let stamp = hiroz::action::Time { sec: accepted.sec, nanosec: accepted.nanosec };
    GoalInfo { goal_id: GoalId::from_bytes(goal), stamp }
}

fn to_ros_status(status: Status) -> GoalStatus {
    match status {
        Status::Unknown => GoalStatus::Unknown,
        Status::Executing => GoalStatus::Executing,
        Status::Canceling => GoalStatus::Canceling,
        Status::Succeeded => GoalStatus::Succeeded,
        Status::Canceled => GoalStatus::Canceled,
        Status::Aborted => GoalStatus::Aborted,
    }
}
