//! The program of a driver: messages of the node on the standard input, messages of the driver on the
//! standard output.

use super::description::{ActionMapping, RobotDescription};
use super::execution::{Execution, RobotGoal, cancel_and_wait, feedback};
use super::path::PathError;
use super::reports::Reports;
use super::session::{Effect, End, GoalSession};
use crate::dynamic::action::{RosAction, goal_of_uuid, goals_in_progress, uuid_of};
use crate::dynamic::graph::{Graph, Received, Subscription};
use crate::dynamic::types::TypeRegistry;
use crate::goals::GoalUuid;
use crate::ros::RosError;
use consort_driver::{DriverMessage, NodeMessage, OfferedAction, PROTOCOL_VERSION};
use consort_skills::actions::{GoalId, JsonObject};
use serde_json::Value;
use std::collections::BTreeMap;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt as _, AsyncWriteExt as _, BufReader};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::sync::watch;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep_until, timeout};
use tracing::{info, warn};

/// Interval of reports.
const REPORT_INTERVAL: Duration = Duration::from_millis(500);

/// Shortest interval of feedback.
const FEEDBACK_INTERVAL: Duration = Duration::from_millis(250);

/// Time limit of a canceled goal at the end of the program.
const STOP_TIMEOUT: Duration = Duration::from_millis(2500);

/// Time after the start at which goals of a previous process are canceled that the node has not
/// resumed.
const RESUME_WITHIN: Duration = Duration::from_secs(5);

/// The driver cannot run.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The graph failed.
    #[error(transparent)]
    Ros(#[from] RosError),
    /// A path of the description is invalid.
    #[error(transparent)]
    Path(#[from] PathError),
    /// The standard output was closed.
    #[error("the standard output was closed: {0}")]
    Output(#[from] std::io::Error),
    /// The node did not introduce itself.
    #[error("the standard input ended before the message `start`")]
    NoStart,
}

/// Purpose of a subscription, by its number.
#[derive(Debug, Clone, PartialEq)]
enum Purpose {
    Report(usize),
    Feedback(String),
    Status(String),
    Clock,
}

/// Runs the driver until its input ends, a shutdown is requested, or `stop` is ready.
///
/// # Errors
/// [`RunError`].
pub async fn run(
    graph: Graph,
    description: RobotDescription,
    types: TypeRegistry,
    name: &str,
    stop: impl Future<Output = ()>,
) -> Result<(), RunError> {
    tokio::pin!(stop);
    let mut lines = read_lines();
    // A driver introduces itself at once; the name of the robot arrives meanwhile.
    let mut driver = Driver::new(graph, description, types)?;
    driver.send(&hello(&driver.execution.description, name)).await?;
    let mut backlog = vec![];
    let robot = loop {
        tokio::select! {
            line = lines.recv() => match line.map(|line| parse(&line)) {
                None => return Ok(()),
                Some(Ok(Some(NodeMessage::Start { robot, pose, .. }))) => {
                    driver.reports.set_pose(pose);
                    break robot;
                }
                Some(Ok(Some(NodeMessage::Heartbeat { sequence }))) => {
                    driver.send(&DriverMessage::Heartbeat { sequence }).await?;
                }
                Some(Ok(Some(NodeMessage::Shutdown {}))) => return Ok(()),
                Some(Ok(message)) => backlog.extend(message),
                Some(Err(problem)) => driver.send(&DriverMessage::Error { message: problem }).await?,
            },
            () = &mut stop => return Ok(()),
        }
    };
    driver.set_robot(robot.as_str());
    driver.subscribe().await?;
    info!(%robot, "driving under ROS 2");
    driver.report().await?;
    for message in backlog {
        driver.handle(message).await?;
    }
    driver.serve(lines, stop).await
}

/// Returns the first message of the driver.
pub fn hello(description: &RobotDescription, name: &str) -> DriverMessage {
    let actions = description.actions.iter().filter_map(|(action, mapping)| {
        let offered = OfferedAction {
            description: mapping.description.clone(),
            example: mapping.example.clone(),
            ..OfferedAction::default()
        };
        Some((action.parse().ok()?, offered))
    });
    DriverMessage::Hello {
        protocol: PROTOCOL_VERSION,
        driver: name.to_owned(),
        actions: actions.collect(),
        resumes: true,
    }
}

/// Reads a line of the node; `None` for a message of a type that this program does not know.
fn parse(line: &str) -> Result<Option<NodeMessage>, String> {
    if line.trim().is_empty() {
        return Ok(None);
    }
    let value: Value = serde_json::from_str(line).map_err(|problem| problem.to_string())?;
    let known = ["start", "goal", "keep", "cancel", "heartbeat", "shutdown"];
    match value["type"].as_str() {
        Some(kind) if known.contains(&kind) => {
            serde_json::from_value(value).map(Some).map_err(|problem| problem.to_string())
        }
        Some(_) => Ok(None),
        None => Err("a message has a `type`".to_owned()),
    }
}

/// Reads the lines of the standard input.
fn read_lines() -> UnboundedReceiver<String> {
    let (sender, lines) = unbounded_channel();
    tokio::spawn(async move {
        let mut input = BufReader::new(tokio::io::stdin());
        let mut line = vec![];
        while input.read_until(b'\n', &mut line).await.is_ok_and(|count| count > 0) {
            if sender.send(String::from_utf8_lossy(&line).into_owned()).is_err() {
                return;
            }
            line.clear();
        }
    });
    lines
}

struct Active {
    id: GoalId,
    mapping: ActionMapping,
    action: String,
    stop: watch::Sender<bool>,
    last_feedback: Option<Instant>,
}

type Channel<T> = (UnboundedSender<T>, UnboundedReceiver<T>);

struct Driver {
    execution: Arc<Execution>,
    reports: Reports,
    session: GoalSession,
    since: Instant,
    active: Option<Active>,
    purposes: Vec<Purpose>,
    subscriptions: Vec<Subscription>,
    messages: Channel<Received>,
    ends: Channel<(GoalId, End)>,
    /// Feedback of goals that last until their cancel.
    feedback: Channel<(GoalId, DriverMessage)>,
    /// Goals of previous processes that are in progress.
    leftovers: BTreeMap<GoalUuid, RosAction>,
    /// Time until which the node may resume one of them; `None` once it has passed.
    resume_until: Option<Instant>,
    /// The time of `/clock`.
    clock: watch::Sender<Option<(i64, u32)>>,
    unreadable: Vec<usize>,
}

impl Driver {
    fn new(graph: Graph, description: RobotDescription, types: TypeRegistry) -> Result<Driver, PathError> {
        let reports = Reports::new(&description)?;
        let execution = Execution { graph: Arc::new(graph), description, robot: String::new(), types };
        Ok(Driver {
            execution: Arc::new(execution),
            reports,
            session: GoalSession::default(),
            since: Instant::now(),
            active: None,
            purposes: vec![],
            subscriptions: vec![],
            messages: unbounded_channel(),
            ends: unbounded_channel(),
            feedback: unbounded_channel(),
            leftovers: BTreeMap::new(),
            resume_until: Some(Instant::now() + RESUME_WITHIN),
            clock: watch::Sender::new(None),
            unreadable: vec![],
        })
    }

    fn set_robot(&mut self, robot: &str) {
        if let Some(execution) = Arc::get_mut(&mut self.execution) {
            robot.clone_into(&mut execution.robot);
        }
    }

    async fn subscribe(&mut self) -> Result<(), RosError> {
        let execution = Arc::clone(&self.execution);
        let graph = &execution.graph;
        for (number, topic) in self.reports.topics().enumerate() {
            let name = graph.resolve(&topic.name);
            let subscription =
                graph.subscribe(&name, &topic.type_name, self.purposes.len(), self.messages.0.clone()).await?;
            self.subscriptions.push(subscription);
            self.purposes.push(Purpose::Report(number));
        }
        for (name, mapping) in &execution.description.actions {
            let Some(action) = execution.action(mapping) else { continue };
            self.subscriptions.push(action.feedback(self.purposes.len(), self.messages.0.clone()).await?);
            self.purposes.push(Purpose::Feedback(name.clone()));
            self.subscriptions.push(action.status(self.purposes.len(), self.messages.0.clone()).await?);
            self.purposes.push(Purpose::Status(name.clone()));
        }
        if execution.description.use_sim_time {
            let sender = self.messages.0.clone();
            let clock = graph.subscribe("/clock", "rosgraph_msgs/msg/Clock", self.purposes.len(), sender).await?;
            self.subscriptions.push(clock);
            self.purposes.push(Purpose::Clock);
        }
        Ok(())
    }

    async fn send(&self, message: &DriverMessage) -> Result<(), std::io::Error> {
        let mut line = serde_json::to_string(message).map_err(std::io::Error::other)?;
        line.push('\n');
        let mut output = tokio::io::stdout();
        output.write_all(line.as_bytes()).await?;
        output.flush().await
    }

    async fn report(&mut self) -> Result<(), std::io::Error> {
        for message in self.reports.messages() {
            self.send(&message).await?;
        }
        Ok(())
    }

    async fn serve(
        mut self,
        mut lines: UnboundedReceiver<String>,
        stop: impl Future<Output = ()>,
    ) -> Result<(), RunError> {
        tokio::pin!(stop);
        let mut reports = interval(REPORT_INTERVAL);
        reports.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let deadline = self.session.deadline().map(|deadline| self.since + deadline);
            let ended = tokio::select! {
                biased;
                () = &mut stop => self.stop().await?,
                line = lines.recv() => match line.map(|line| parse(&line)) {
                    None => self.stop().await?,
                    Some(Ok(Some(message))) => self.handle(message).await?,
                    Some(Ok(None)) => false,
                    Some(Err(message)) => {
                        self.send(&DriverMessage::Error { message }).await?;
                        false
                    }
                },
                Some((id, end)) = self.ends.1.recv() => {
                    self.ended(id, end).await?;
                    false
                }
                Some((id, feedback)) = self.feedback.1.recv() => {
                    if self.session.active() == Some(id) {
                        self.send(&feedback).await?;
                    }
                    false
                }
                Some(received) = self.messages.1.recv() => {
                    self.receive(received).await?;
                    false
                }
                () = sleep_until(deadline.unwrap_or_else(Instant::now)), if deadline.is_some() => {
                    let effects = self.session.tick(self.since.elapsed());
                    self.perform(effects).await?
                }
                () = sleep_until(self.resume_until.unwrap_or_else(Instant::now)), if self.resume_until.is_some() => {
                    self.resume_until = None;
                    self.cancel_leftovers();
                    self.release_unused();
                    false
                }
                _ = reports.tick() => {
                    self.report().await?;
                    false
                }
            };
            if ended {
                self.execution.graph.leave().await;
                return Ok(());
            }
        }
    }

    /// Handles a message of the node. Returns true at the end of the program.
    async fn handle(&mut self, message: NodeMessage) -> Result<bool, std::io::Error> {
        let effects = self.session.handle(message, self.since.elapsed());
        self.perform(effects).await
    }

    async fn stop(&mut self) -> Result<bool, std::io::Error> {
        let effects = self.session.stop();
        self.perform(effects).await
    }

    async fn perform(&mut self, effects: Vec<Effect>) -> Result<bool, std::io::Error> {
        for effect in effects {
            match effect {
                Effect::Send(message) => self.send(&message).await?,
                Effect::Cancel(id) => {
                    if let Some(active) = self.active.as_ref().filter(|active| active.id == id) {
                        active.stop.send_replace(true);
                    }
                }
                Effect::Start { id, action, parameters, resumed } => {
                    self.start(id, action.as_str(), parameters, resumed);
                }
                Effect::Stop => {
                    self.wait_for_end().await?;
                    return Ok(true);
                }
            }
        }
        Ok(false)
    }

    fn start(&mut self, id: GoalId, action: &str, parameters: JsonObject, resumed: bool) {
        let Some(mapping) = self.execution.description.actions.get(action).cloned() else {
            let end = End::aborted("unknown", format!("the description of the robot has no action {action}"));
            // The receiver is part of this driver.
            let _ = self.ends.0.send((id, end));
            return;
        };
        let (stop, stopped) = watch::channel(false);
        let robot = &self.execution.robot;
        let resumable = self.leftovers.keys().filter_map(|uuid| goal_of_uuid(uuid, robot));
        let attempt = resumable.filter(|(number, _)| *number == id.0).map(|(_, attempt)| attempt).max().unwrap_or(0);
        self.leftovers.retain(|uuid, _| goal_of_uuid(uuid, robot).is_none_or(|(number, _)| number != id.0));
        let leftovers = std::mem::take(&mut self.leftovers).into_iter().map(|(id, action)| (action, id)).collect();
        let (feedback, clock) = (self.feedback.0.clone(), self.clock.subscribe());
        let goal = RobotGoal { id, mapping: mapping.clone(), parameters, resumed, attempt, clock, leftovers, feedback };
        let (ends, execution) = (self.ends.0.clone(), Arc::clone(&self.execution));
        tokio::spawn(async move {
            let end = execution.run(goal, stopped).await;
            let _ = ends.send((id, end));
        });
        self.active = Some(Active { id, mapping, action: action.to_owned(), stop, last_feedback: None });
    }

    async fn ended(&mut self, id: GoalId, end: End) -> Result<(), std::io::Error> {
        drop(self.active.take_if(|active| active.id == id));
        info!(goal = id.0, status = ?end.status, cause = end.message, "goal ended");
        // The pose at the end is known before the end.
        self.report().await?;
        let effects = self.session.ended(id, end);
        for effect in effects {
            if let Effect::Send(message) = effect {
                self.send(&message).await?;
            }
        }
        Ok(())
    }

    /// Waits until the canceled goal has ended.
    async fn wait_for_end(&mut self) -> Result<(), std::io::Error> {
        let limit = Instant::now() + STOP_TIMEOUT;
        while self.session.active().is_some() {
            let left = limit.saturating_duration_since(Instant::now());
            match timeout(left, self.ends.1.recv()).await {
                Ok(Some((id, end))) => {
                    self.ended(id, end).await?;
                }
                Ok(None) => return Ok(()),
                Err(_) => {
                    warn!("the robot has not ended its goal in {STOP_TIMEOUT:?} after the cancel");
                    return Ok(());
                }
            }
        }
        Ok(())
    }

    async fn receive(&mut self, received: Received) -> Result<(), std::io::Error> {
        let Some(purpose) = self.purposes.get(received.subscription).cloned() else { return Ok(()) };
        let message = match received.message {
            Ok(message) => message,
            Err(problem) => {
                if !self.unreadable.contains(&received.subscription) {
                    self.unreadable.push(received.subscription);
                    warn!(?purpose, problem, "unreadable messages are ignored");
                }
                return Ok(());
            }
        };
        match purpose {
            Purpose::Report(number) => self.reports.handle(number, &message),
            Purpose::Clock => {
                let clock = &message["clock"];
                let nanosec = clock["nanosec"].as_u64().and_then(|nanosec| u32::try_from(nanosec).ok());
                self.clock.send_replace(clock["sec"].as_i64().zip(nanosec));
            }
            Purpose::Status(action) => self.handle_status(&action, &message),
            Purpose::Feedback(action) => {
                let due = |at: Instant| at.elapsed() >= FEEDBACK_INTERVAL;
                let goal = uuid_of(&message["goal_id"]).and_then(|id| goal_of_uuid(&id, &self.execution.robot));
                let Some(active) = self.active.as_mut().filter(|active| {
                    active.action == action
                        && goal.is_some_and(|(number, _)| number == active.id.0)
                        && active.last_feedback.is_none_or(due)
                }) else {
                    return Ok(());
                };
                active.last_feedback = Some(Instant::now());
                let (feedback, pose) = feedback(&active.mapping, active.id, &message["feedback"]);
                if let Some(pose) = pose {
                    self.reports.set_pose(pose);
                }
                self.send(&feedback).await?;
            }
        }
        Ok(())
    }

    /// Notes the goals of previous processes. The node may resume one of them.
    fn handle_status(&mut self, action: &str, message: &Value) {
        let Some(mapping) = self.execution.description.actions.get(action) else { return };
        let Some(action) = self.execution.action(mapping) else { return };
        let in_progress = goals_in_progress(message, &self.execution.robot);
        self.leftovers.retain(|id, other| !other.is_same(&action) || in_progress.contains(id));
        let newest = self.active.as_ref().map(|active| active.id.0);
        for id in in_progress {
            let Some((number, _)) = goal_of_uuid(&id, &self.execution.robot) else { continue };
            // A goal that this process has just ended is no leftover.
            if newest.is_none_or(|newest| number < newest) && !self.session.has_ended(number) {
                self.leftovers.insert(id, action.clone());
            }
        }
        if self.resume_until.is_none() {
            self.cancel_leftovers();
        }
    }

    fn cancel_leftovers(&mut self) {
        for (id, action) in std::mem::take(&mut self.leftovers) {
            info!("canceling a goal of a previous process");
            tokio::spawn(async move { cancel_and_wait(&action, id).await });
        }
    }

    /// Releases a device that a previous process may have held, unless a goal is in progress.
    fn release_unused(&self) {
        if self.session.is_unused() {
            let execution = Arc::clone(&self.execution);
            tokio::spawn(async move { execution.release_all().await });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::described::description::load;

    #[test]
    fn lines_that_are_no_messages_are_reported_and_unknown_messages_are_ignored() {
        assert!(parse("{").is_err() && parse("{}").is_err() && parse(r#"{"type":"cancel","id":7}"#).is_err());
        assert_eq!(parse(r#"{"type":"sing"}"#), Ok(None));
        assert_eq!(parse("\n"), Ok(None));
        let message = parse(r#"{"type":"heartbeat","sequence":3,"later":true}"#);
        assert_eq!(message, Ok(Some(NodeMessage::Heartbeat { sequence: 3 })));
    }

    #[test]
    fn the_hello_offers_the_described_actions() {
        let DriverMessage::Hello { actions, resumes, .. } = hello(&load("nav2").unwrap(), "x") else {
            panic!("a hello")
        };
        let names: Vec<&str> = actions.keys().map(|name| name.as_str()).collect();
        let expected = ["dock", "follow_waypoints", "navigate_to_pose", "spin", "undock", "wait"];
        assert_eq!((names, resumes), (expected.to_vec(), true));
    }
}
