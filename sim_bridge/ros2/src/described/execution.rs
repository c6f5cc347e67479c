//! Executes a goal at the robot: by an action, a service or a topic.

use super::description::{ActionMapping, RobotDescription, Until, Via};
use super::path::FieldPath;
use super::reports::to_pose;
use super::session::End;
use super::template::{self, Scope, fill};
use crate::dynamic::action::{ActionEnd, RosAction, goal_uuid};
use crate::dynamic::graph::{CallError, EndpointKind, Graph};
use crate::dynamic::types::TypeRegistry;
use crate::goals::{GoalUuid, Status};
use crate::mapping::seconds_now;
use consort_driver::{DriverMessage, ResultStatus};
use consort_protocol::pose::Pose;
use consort_protocol::scalar::Scalar;
use consort_protocol::units::{Metres, Seconds};
use consort_skills::actions::{GoalId, JsonObject};
use serde_json::{Value, json};
use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedSender, unbounded_channel};
use tokio::sync::watch;
use tokio::time::{sleep, timeout};
use tracing::warn;

/// Time for which a goal waits for the server of its action.
const SERVER_TIMEOUT: Duration = Duration::from_secs(5);

/// Interval at which a cancel request is repeated until the goal ends.
const CANCEL_INTERVAL: Duration = Duration::from_secs(1);

/// Time limit of a service and of `until` without a value.
const WITHIN: Duration = Duration::from_secs(10);

/// Time limit of a change of a lifecycle node.
const LIFECYCLE_TIMEOUT: Duration = Duration::from_secs(10);

/// A goal for the robot.
#[derive(Debug, Clone)]
pub struct RobotGoal {
    /// Id.
    pub id: GoalId,
    /// Mapping of its action.
    pub mapping: ActionMapping,
    /// Its parameters.
    pub parameters: JsonObject,
    /// True if a previous process has started it.
    pub resumed: bool,
    /// Attempt in the id of the goal that it resumes.
    pub attempt: u8,
    /// The time of `/clock`, as seconds and nanoseconds.
    pub clock: watch::Receiver<Option<(i64, u32)>>,
    /// Goals of previous processes that must end before it starts.
    pub leftovers: Vec<(RosAction, GoalUuid)>,
    /// Receives the feedback of a goal that lasts until its cancel.
    pub feedback: UnboundedSender<(GoalId, DriverMessage)>,
}

/// Executes goals of a robot.
#[derive(Debug)]
pub struct Execution {
    /// The graph.
    pub graph: Arc<Graph>,
    /// The description.
    pub description: RobotDescription,
    /// The robot.
    pub robot: String,
    /// Known definitions.
    pub types: TypeRegistry,
}

impl Execution {
    /// Returns the client of the action of a mapping; `None` for a service or a topic.
    pub fn action(&self, mapping: &ActionMapping) -> Option<RosAction> {
        match mapping.via()? {
            Via::Action(name) => {
                Some(RosAction::new(Arc::clone(&self.graph), self.graph.resolve(name), mapping.type_name.clone()))
            }
            _ => None,
        }
    }

    /// Executes a goal until it ends, or until `stop` becomes true.
    pub async fn run(self: Arc<Self>, goal: RobotGoal, mut stop: watch::Receiver<bool>) -> End {
        for (action, id) in &goal.leftovers {
            cancel_and_wait(action, *id).await;
        }
        if let Err(problem) = self.activate().await {
            return End::aborted("failed", problem);
        }
        if !self.has_time(&goal).await {
            return End::aborted("failed", "use_sim_time: there is no time on /clock");
        }
        if *stop.borrow() {
            return End::canceled();
        }
        match (goal.mapping.via(), self.action(&goal.mapping), &goal.mapping.hold) {
            (_, Some(action), _) => self.by_action(&action, &goal, stop).await,
            (Some(Via::Topic(topic)), _, Some(hold)) => self.hold(hold, topic, &goal, stop).await,
            (Some(_), ..) if goal.resumed => {
                End::aborted("failed", "the previous process has ended, and the robot does not tell what it has done")
            }
            (Some(via), ..) => tokio::select! {
                end = self.by_message(via, &goal) => end,
                () = requested(&mut stop) => End::canceled(),
            },
            (None, ..) => End::aborted("unknown", "its description maps the action to nothing"),
        }
    }

    async fn by_action(&self, action: &RosAction, goal: &RobotGoal, stop: watch::Receiver<bool>) -> End {
        self.graph.wait_for(SERVER_TIMEOUT, |_| action.is_served()).await;
        let attempt = AtomicU8::new(goal.attempt);
        let id = || goal_uuid(&self.robot, goal.id.0, attempt.load(Ordering::Relaxed));
        let execute = async {
            if goal.resumed {
                return match action.result(id()).await {
                    ActionEnd::Unknown => {
                        End::aborted("failed", "the robot does not know the goal of the previous process")
                    }
                    end => self.end(&goal.mapping, end),
                };
            }
            let name = goal.mapping.sent_type();
            let types = self.types_of_action(action, goal).await;
            let message = match fill(&types, &name, &goal.mapping.send, &self.scope(goal)) {
                Ok(message) => message,
                Err(problem) => return End::aborted("unknown", problem.to_string()),
            };
            loop {
                let end = action.execute(id(), &message).await;
                // A server rejects the id of a goal that it knows: an earlier goal had the same number.
                let was_used = end == ActionEnd::Rejected && action.knows(id()).await;
                if !was_used || attempt.fetch_add(1, Ordering::Relaxed) == u8::MAX - 1 {
                    return self.end(&goal.mapping, end);
                }
            }
        };
        tokio::select! {
            end = execute => end,
            never = cancel_when_requested(action, id, stop) => match never {},
        }
    }

    /// Returns the definitions that the server of the action has, or the known ones.
    async fn types_of_action(&self, action: &RosAction, goal: &RobotGoal) -> TypeRegistry {
        let known = self.types.clone();
        let Some(Via::Action(name)) = goal.mapping.via() else { return known };
        let service = format!("{}/_action/send_goal", self.graph.resolve(name));
        let Some(server) = self.graph.find(EndpointKind::Server, &service).filter(|_| action.is_served()) else {
            return known;
        };
        match self.graph.types_of(&server.type_name, &server.hash).await {
            Ok(types) => (*types).clone(),
            Err(_) => known,
        }
    }

    pub(super) fn scope<'a>(&'a self, goal: &'a RobotGoal) -> Scope<'a> {
        Scope {
            parameters: &goal.parameters,
            tables: &self.description.tables,
            robot: &self.robot,
            frame: self.description.frame(),
            now: match self.description.use_sim_time {
                true => goal.clock.borrow().unwrap_or_default(),
                false => seconds_now(),
            },
        }
    }

    /// Waits for the time of stamps. Returns false if it is unknown.
    async fn has_time(&self, goal: &RobotGoal) -> bool {
        let mut clock = goal.clock.clone();
        !self.description.use_sim_time
            || timeout(SERVER_TIMEOUT, clock.wait_for(Option::is_some)).await.is_ok_and(|time| time.is_ok())
    }

    fn end(&self, mapping: &ActionMapping, end: ActionEnd) -> End {
        match end {
            ActionEnd::Ended(Status::Canceled, _) => End::canceled(),
            ActionEnd::Ended(status, result) => end_of(mapping, &result, status == Status::Succeeded),
            ActionEnd::Unknown => End::aborted("failed", "the robot no longer knows the goal"),
            ActionEnd::Rejected => End::aborted("failed", "the robot has rejected the goal"),
            ActionEnd::Lost(problem) => End::aborted("failed", problem),
            ActionEnd::Invalid(problem) => End::aborted("unknown", problem),
        }
    }

    /// Calls a service or publishes a message, and waits for the value of `until`.
    async fn by_message(&self, via: Via<'_>, goal: &RobotGoal) -> End {
        let mapping = &goal.mapping;
        let limit = within(mapping);
        let message = match fill(&self.types, &mapping.sent_type(), &mapping.send, &self.scope(goal)) {
            Ok(message) => message,
            Err(problem) => return End::aborted("unknown", problem.to_string()),
        };
        // The subscription exists before the message can have an effect.
        let reached = async {
            match timeout(limit, self.until(mapping.until.as_ref(), goal)).await {
                Ok(reached) => reached.map_err(|problem| End::aborted("failed", problem)),
                Err(_) => Err(End::aborted("timed_out", "the value of `until` was not reached in time")),
            }
        };
        let sent = async {
            let end = self.send(via, mapping, &message, limit).await.unwrap_or_else(|problem| end_of_call(&problem));
            if end.status == ResultStatus::Succeeded { Ok(end) } else { Err(end) }
        };
        match tokio::try_join!(reached, sent) {
            Ok(((), end)) | Err(end) => end,
        }
    }

    async fn send(
        &self,
        via: Via<'_>,
        mapping: &ActionMapping,
        message: &Value,
        limit: Duration,
    ) -> Result<End, CallError> {
        match via {
            Via::Service(name) => {
                let name = self.graph.resolve(name);
                let reply = call_when_served(&self.graph, &name, &mapping.type_name, message, limit).await?;
                Ok(end_of(mapping, &reply, true))
            }
            Via::Topic(name) | Via::Action(name) => {
                let name = self.graph.resolve(name);
                let is_heard = |graph: &Graph| graph.find(EndpointKind::Subscription, &name).is_some();
                if !self.graph.wait_for(SERVER_TIMEOUT, is_heard).await {
                    return Ok(End::aborted("failed", format!("no node subscribes to {name}")));
                }
                self.graph.publish(&name, &mapping.type_name, message).await?;
                Ok(End::succeeded(JsonObject::new()))
            }
        }
    }

    /// Waits until a topic has a value.
    async fn until(&self, until: Option<&Until>, goal: &RobotGoal) -> Result<(), String> {
        let Some(until) = until else { return Ok(()) };
        let path = FieldPath::parse(&until.field).map_err(|problem| problem.to_string())?;
        let expected = template::value(&until.equals, &self.scope(goal)).map_err(|problem| problem.to_string())?;
        let expected = expected.unwrap_or_default();
        let (sender, mut messages) = unbounded_channel();
        let topic = self.graph.resolve(&until.topic);
        let subscribed = self.graph.subscribe(&topic, &until.type_name, 0, sender).await;
        let _subscription = subscribed.map_err(|problem| problem.to_string())?;
        while let Some(received) = messages.recv().await {
            let message = received.message?;
            if path.get(&message).is_some_and(|value| is_same(value, &expected)) {
                return Ok(());
            }
        }
        Err(format!("the subscription of {topic} has ended"))
    }

    /// Checks that the lifecycle nodes are active, and activates them if the description says so.
    async fn activate(&self) -> Result<(), String> {
        let Some(lifecycle) = &self.description.lifecycle else { return Ok(()) };
        for node in &lifecycle.nodes {
            let node = self.graph.resolve(node);
            // It is configured, and then activated.
            for attempt in 0..3 {
                let state = lifecycle_state(&self.graph, &node).await?;
                let transition = match state.as_str() {
                    "active" => break,
                    "unconfigured" if lifecycle.activate && attempt < 2 => 1,
                    "inactive" if lifecycle.activate && attempt < 2 => 3,
                    _ => return Err(format!("the lifecycle node {node} is {state}")),
                };
                let request = json!({"transition": {"id": transition}});
                let changed = self
                    .graph
                    .call(
                        &format!("{node}/change_state"),
                        "lifecycle_msgs/srv/ChangeState",
                        &request,
                        LIFECYCLE_TIMEOUT,
                    )
                    .await
                    .map_err(|problem| problem.to_string())?;
                if changed["success"] != true {
                    return Err(format!("the lifecycle node {node} is {state}, and refuses to be activated"));
                }
            }
        }
        Ok(())
    }
}

/// Checks whether two values are the same; numbers are compared as numbers.
pub(super) fn is_same(value: &Value, expected: &Value) -> bool {
    value == expected || value.as_f64().is_some_and(|number| expected.as_f64() == Some(number))
}

/// Returns the time limit of a service, of `until` and of `release`.
pub(super) fn within(mapping: &ActionMapping) -> Duration {
    mapping.within_s.map_or(WITHIN, Duration::from_secs_f64)
}

/// Returns the end of a goal whose message could not be sent.
pub(super) fn end_of_call(problem: &CallError) -> End {
    let code = if matches!(problem, CallError::Message(_)) { "unknown" } else { "failed" };
    End::aborted(code, problem.to_string())
}

/// Calls a service, whose server may join the graph a moment later.
async fn call_when_served(
    graph: &Graph,
    name: &str,
    type_name: &str,
    request: &Value,
    limit: Duration,
) -> Result<Value, CallError> {
    graph.wait_for(SERVER_TIMEOUT, |graph| graph.find(EndpointKind::Server, name).is_some()).await;
    graph.call(name, type_name, request, limit).await
}

/// Returns the state of a lifecycle node: `active`, `inactive`, `unconfigured`.
///
/// # Errors
/// The cause, if the node does not reply.
pub async fn lifecycle_state(graph: &Graph, node: &str) -> Result<String, String> {
    let (service, type_name) = (format!("{node}/get_state"), "lifecycle_msgs/srv/GetState");
    let state = call_when_served(graph, &service, type_name, &Value::Null, LIFECYCLE_TIMEOUT).await;
    let state = state.map_err(|problem| format!("the state of the lifecycle node {node} is unknown: {problem}"))?;
    Ok(state["current_state"]["label"].as_str().unwrap_or_default().to_owned())
}

/// Waits until the end of a goal is requested, or its driver is gone.
pub(super) async fn requested(stop: &mut watch::Receiver<bool>) {
    let _ = stop.wait_for(|stop| *stop).await;
}

/// Sends cancel requests, repeatedly, once requested.
async fn cancel_when_requested(
    action: &RosAction,
    id: impl Fn() -> GoalUuid,
    mut stop: watch::Receiver<bool>,
) -> Infallible {
    requested(&mut stop).await;
    loop {
        if !action.cancel(id()).await {
            warn!("no reply to a cancel request; it is repeated");
        }
        sleep(CANCEL_INTERVAL).await;
    }
}

/// Cancels a goal of a previous process, and waits until it has ended.
pub async fn cancel_and_wait(action: &RosAction, id: GoalUuid) {
    action.cancel(id).await;
    if timeout(SERVER_TIMEOUT, action.result(id)).await.is_err() {
        warn!("a goal of a previous process has not ended after its cancel");
    }
}

/// Returns the end of a goal from its result.
fn end_of(mapping: &ActionMapping, result: &Value, succeeded: bool) -> End {
    let get = |path: &str| FieldPath::parse(path).ok()?.get(result).cloned();
    let succeeded = succeeded
        && mapping.succeeded.as_deref().is_none_or(|path| get(path).is_some_and(|value| value == Value::Bool(true)));
    if succeeded {
        let results = mapping.results.iter().filter_map(|(name, path)| Some((name.clone(), get(path)?)));
        return End::succeeded(results.collect());
    }
    let error = get(mapping.error_code.as_deref().unwrap_or("error_code"));
    let error = error.map(|error| error.as_str().map_or_else(|| error.to_string(), str::to_owned));
    let text = mapping.error_message.as_deref().map_or_else(|| get("error_msg").or_else(|| get("message")), get);
    let text = text.as_ref().and_then(Value::as_str).unwrap_or_default().trim().to_owned();
    let code = error.as_ref().and_then(|error| mapping.failures.get(error)).map_or("failed", String::as_str);
    let message = match (error.filter(|error| error != "0"), text.is_empty()) {
        (Some(error), true) => format!("error {error} of the robot"),
        (Some(error), false) => format!("{text} (error {error})"),
        (None, true) => "the robot has failed without a cause".to_owned(),
        (None, false) => text,
    };
    End::aborted(code, message)
}

/// Returns the feedback of a goal, and the pose in it.
pub fn feedback(mapping: &ActionMapping, id: GoalId, message: &Value) -> (DriverMessage, Option<Pose>) {
    let get = |path: &str| FieldPath::parse(path).ok()?.get(message).cloned();
    let number = |value: &Value| match value {
        Value::Object(duration) => Some(duration.get("sec")?.as_f64()? + duration.get("nanosec")?.as_f64()? * 1e-9),
        value => value.as_f64(),
    };
    let standard = |name: &str| mapping.feedback.get(name).and_then(|path| get(path));
    let declared =
        mapping.feedback.iter().filter(|(name, _)| !super::check::STANDARD_FEEDBACK.contains(&name.as_str()));
    let values = declared.filter_map(|(name, path)| {
        let value = get(path)?;
        // A duration is a number of seconds.
        let value = Scalar::from_json(&value).or_else(|| number(&value).map(Scalar::Number))?;
        Some((name.clone(), value))
    });
    let feedback = DriverMessage::Feedback {
        id,
        distance_remaining_m: standard("distance_remaining_m")
            .and_then(|value| Metres::new(number(&value)?.max(0.0)).ok()),
        time_remaining_s: standard("time_remaining_s").and_then(|value| Seconds::new(number(&value)?.max(0.0)).ok()),
        values: values.collect(),
    };
    (feedback, standard("pose").as_ref().and_then(to_pose))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::described::description::load;

    #[test]
    fn results_become_ends_with_their_code_and_cause() {
        let nav2 = load("nav2").unwrap();
        let drive = &nav2.actions["navigate_to_pose"];
        let blocked = end_of(drive, &json!({"error_code": 105, "error_msg": "no progress"}), false);
        assert_eq!(blocked, End::aborted("blocked", "no progress (error 105)"));
        let other = end_of(drive, &json!({"error_code": 9000}), false);
        assert_eq!(other, End::aborted("failed", "error 9000 of the robot"));
        let dock = &nav2.actions["dock"];
        let failed = end_of(dock, &json!({"success": false, "error_code": 906, "error_msg": ""}), true);
        assert_eq!(failed, End::aborted("charger", "error 906 of the robot"));
        assert_eq!(end_of(dock, &json!({"success": true}), true), End::succeeded(JsonObject::new()));
        let trigger = ActionMapping { succeeded: Some("success".to_owned()), ..ActionMapping::default() };
        let refused = end_of(&trigger, &json!({"success": false, "message": "locked"}), true);
        assert_eq!(refused, End::aborted("failed", "locked"));
    }

    #[test]
    fn feedback_has_distances_times_and_the_pose() {
        let nav2 = load("nav2").unwrap();
        let message = json!({"distance_remaining": 2.5, "estimated_time_remaining": {"sec": 1, "nanosec": 500_000_000},
            "current_pose": {"pose": {"position": {"x": 1.0, "y": 2.0, "z": 0.0},
                "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}}});
        let (sent, pose) = feedback(&nav2.actions["navigate_to_pose"], GoalId(7), &message);
        let DriverMessage::Feedback { distance_remaining_m, time_remaining_s, .. } = sent else { panic!("feedback") };
        assert_eq!(distance_remaining_m.unwrap().get(), 2.5);
        assert_eq!((time_remaining_s.unwrap().get(), pose), (1.5, Some(Pose::new(1.0, 2.0, 0.0))));
    }
}
