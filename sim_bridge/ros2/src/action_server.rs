//! One `NavigateToPose` action server: three services and two topics on the ROS 2 graph around [`Goals`], which decide.
//!
//! hiroz has action servers, too. Theirs answers a successful cancel with "rejected" or, with a handler, hears no wish to cancel
//! while a result is awaited, which a client of ROS 2 does from the first moment; and a query without attachment ends it. So
//! only its services and topics are used.

use crate::goals::{Ending, Goals, Status, Uuid};
use crate::mapping;
use crate::messages::{Goal, NavigateToPose, Outcome, Progress, Time};
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

/// How long a result can be asked for: the default of `rcl_action`.
const RESULTS_KEPT: Duration = Duration::from_secs(10);

/// What a client wants.
#[derive(Debug, Clone, PartialEq)]
pub enum Wish {
    /// A goal was accepted: it is to be pursued.
    Pursue(Uuid, Goal),
    /// A goal is to be ended early. Asked again for as long as clients ask.
    Cancel(Uuid),
}

/// What becomes of goals, as whoever pursues them says.
#[derive(Debug, Clone, PartialEq)]
pub enum Word {
    /// How a goal goes.
    Progress(Uuid, Progress),
    /// How it has ended. The first end counts.
    Ended(Uuid, Ending, Outcome),
}

/// An action server on the ROS 2 graph; it leaves the graph when this is dropped.
#[derive(Debug)]
pub struct ActionServer {
    words: UnboundedSender<Word>,
    wishes: UnboundedReceiver<Wish>,
    _tasks: JoinSet<()>,
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
    goals: Goals<Outcome>,
    feedback: ZPub<Feedback, <Feedback as ZMessage>::Serdes>,
    status: ZPub<StatusMessage, <StatusMessage as ZMessage>::Serdes>,
    /// Who asked for results that are not there yet.
    awaiting: BTreeMap<Uuid, Vec<ServiceReply<ResultService<NavigateToPose>>>>,
    wishes: UnboundedSender<Wish>,
    since: Instant,
}

impl ActionServer {
    /// Offers the action under a fully qualified name, as `/ada/navigate_to_pose`.
    ///
    /// # Errors
    /// [`RosError`] if the name is none, or the session is closed.
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

        let (wish, wishes) = unbounded_channel();
        let (words, word) = unbounded_channel();
        let (requests, request) = unbounded_channel();
        let mut tasks = JoinSet::new();
        tasks.spawn(hear(goal, requests.clone(), Request::Goal));
        tasks.spawn(hear(cancel, requests.clone(), Request::Cancel));
        tasks.spawn(hear(result, requests, Request::Result));
        let goals = Goals::new(RESULTS_KEPT);
        let state = State { goals, feedback, status, awaiting: BTreeMap::new(), wishes: wish, since: Instant::now() };
        tasks.spawn(state.run(request, word));
        info!(action = name, "offered");
        Ok(ActionServer { words, wishes, _tasks: tasks })
    }

    /// The next wish of a client.
    pub async fn wish(&mut self) -> Option<Wish> {
        self.wishes.recv().await
    }

    /// Says what becomes of a goal.
    pub fn say(&self, word: Word) {
        // Without its task the server is being dropped: nobody is there to be told.
        let _ = self.words.send(word);
    }
}

/// Hands on requests as they come; what cannot be read is dropped, and its client told nothing, as ROS 2 has it.
async fn hear<S: ZService>(
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
            Err(problem) => warn!(?server, %problem, "a request that cannot be read"),
        }
    }
}

impl State {
    async fn run(mut self, mut requests: UnboundedReceiver<Request>, mut words: UnboundedReceiver<Word>) {
        let mut beat = tokio::time::interval(Duration::from_secs(1));
        beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                Some(request) = requests.recv() => match request {
                    Request::Goal(request) => self.accept(request).await,
                    Request::Cancel(request) => self.cancel(request).await,
                    Request::Result(request) => self.result(request).await,
                },
                word = words.recv() => match word {
                    Some(Word::Progress(goal, progress)) => self.tell(goal, progress).await,
                    Some(Word::Ended(goal, how, outcome)) => self.end(goal, how, outcome).await,
                    None => return,
                },
                _ = beat.tick() => {
                    if self.goals.forget(self.since.elapsed()) {
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
            debug!(%problem, "an answer to a goal was not sent");
        }
        if accepted {
            self.publish_status().await;
            let _ = self.wishes.send(Wish::Pursue(goal, message.goal));
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
            debug!(%problem, "an answer to a wish to cancel was not sent");
        }
        if !stopping.is_empty() {
            self.publish_status().await;
        }
        for (goal, _) in stopping {
            let _ = self.wishes.send(Wish::Cancel(goal));
        }
    }

    async fn result(&mut self, request: ResultRequest) {
        let (message, reply) = request.into_parts();
        let goal = *message.goal_id.as_bytes();
        match self.goals.result(goal) {
            Some((status, outcome)) => answer(reply, status, outcome).await,
            None => self.awaiting.entry(goal).or_default().push(reply),
        }
    }

    async fn tell(&self, goal: Uuid, progress: Progress) {
        if !self.goals.is_under_way(goal) {
            return;
        }
        let message = FeedbackMessage { goal_id: GoalId::from_bytes(goal), feedback: progress };
        if let Err(problem) = self.feedback.async_publish(&message).await {
            warn!(%problem, "feedback was not published");
        }
    }

    async fn end(&mut self, goal: Uuid, how: Ending, outcome: Outcome) {
        if !self.goals.end(goal, how, outcome, self.since.elapsed()) {
            return;
        }
        self.publish_status().await;
        let Some((status, outcome)) = self.goals.result(goal) else { return };
        for reply in self.awaiting.remove(&goal).unwrap_or_default() {
            answer(reply, status, outcome.clone()).await;
        }
    }

    async fn publish_status(&self) {
        let info =
            |(goal, accepted, status)| GoalStatusInfo { goal_info: goal_info(goal, accepted), status: wire(status) };
        let message = StatusMessage { status_list: self.goals.statuses().map(info).collect() };
        if let Err(problem) = self.status.async_publish(&message).await {
            warn!(%problem, "the status of goals was not published");
        }
    }
}

async fn answer(reply: ServiceReply<ResultService<NavigateToPose>>, status: Status, result: Outcome) {
    // Whoever asked may be gone, or have asked again.
    if let Err(problem) = reply.reply(&GetResultResponse { status: status as i8, result }).await {
        debug!(%problem, "a result was not sent");
    }
}

fn goal_info(goal: Uuid, accepted: Time) -> GoalInfo {
    let stamp = hiroz::action::Time { sec: accepted.sec, nanosec: accepted.nanosec };
    GoalInfo { goal_id: GoalId::from_bytes(goal), stamp }
}

fn wire(status: Status) -> GoalStatus {
    match status {
        Status::Unknown => GoalStatus::Unknown,
        Status::Executing => GoalStatus::Executing,
        Status::Canceling => GoalStatus::Canceling,
        Status::Succeeded => GoalStatus::Succeeded,
        Status::Canceled => GoalStatus::Canceled,
        Status::Aborted => GoalStatus::Aborted,
    }
}
