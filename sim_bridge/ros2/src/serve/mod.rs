//! Simulated robots for ROS 2: a `NavigateToPose` action server for every robot that a driver
//! server of the fleet reports.
//!
//! ```text
//!  ROS 2 (rmw_zenoh)          this program                               fleet's bus
//!  /ada/navigate_to_pose ◀──▶ ActionServer ◀─▶ GoalExecutor ── wire/driver/ada/command ──▶ driver server (world)
//!                                                           ◀── wire/driver/ada/state ────
//! ```
//!
//! A simulated robot has a single client. Here it is the ROS 2 client, and only while a goal is in
//! progress: then this program sends the heartbeats, and the robot stops without them. A simulated
//! robot that belongs to a robot node of the fleet is controlled by that node, which cancels the
//! goals of other clients; the ROS 2 client receives that result.

pub mod goal_executor;
pub mod sensors;

use crate::action_server::{ActionServer, ClientRequest, GoalUpdate};
use crate::dynamic::graph::Graph;
use crate::mapping;
use crate::messages::Progress;
use crate::ros::{Ros, RosError};
use crate::route_planner::RoutePlanner;
use bytes::Bytes;
use consort_bus::{BusError, SharedBus};
use consort_fleet::robot_driver::{CLIENT_TIMEOUT, DriverState, GoalRequest};
use consort_protocol::codec;
use consort_protocol::ids::RobotId;
use consort_protocol::keys::{DriverCall, Key, Keys};
use goal_executor::{Action, GoalExecutor, Report};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior};
use tracing::{debug, info, warn};

/// Interval of heartbeats to a driver server while a goal is in progress; well below the three
/// seconds after which the server regards its client as lost. Feedback has the same interval.
const HEARTBEAT_INTERVAL: Duration = Duration::from_millis(300);

/// Time limit of a reply to a command; the command is then repeated.
const REPLY_TIMEOUT: Duration = Duration::from_secs(1);

/// Settings of the bridge.
pub struct ServeSettings {
    /// The fleet's bus.
    pub bus: SharedBus,
    /// The fleet's keys.
    pub keys: Keys,
    /// Route planner on the map of the robots.
    pub planner: Arc<RoutePlanner>,
    /// Number of this run: greater than in any previous run, for example the milliseconds since 1970.
    /// Goals of previous runs are canceled.
    pub run: u64,
    /// Session for the states of the robots: `/NAME/odom`, `/NAME/battery_state`, `/NAME/scan` and `/tf`.
    /// `None`: they are not published.
    pub graph: Option<Arc<Graph>>,
}

/// The bridge cannot serve, or no longer.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The fleet's bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The ROS 2 graph failed.
    #[error(transparent)]
    Ros(#[from] RosError),
    /// The bus was closed.
    #[error("the fleet's bus was closed")]
    Closed,
}

/// Time limit to stop the robots when the program ends. Without a reply a robot stops by itself.
const STOP_TIMEOUT: Duration = CLIENT_TIMEOUT;

/// Offers an action server on `ros` for every robot whose state is received on the bus, until `stop`
/// is ready. Then all goals are canceled, and their clients receive a result. A robot without further
/// states keeps its server: its goals are aborted.
pub async fn serve(ros: &Ros, settings: ServeSettings, stop: impl Future<Output = ()>) -> Result<(), ServeError> {
    let mut bridges = Bridges::default();
    tokio::select! {
        result = bridges.serve(ros, settings) => result,
        () = stop => {
            bridges.stop().await;
            Ok(())
        }
    }
}

/// The bridges of all robots.
#[derive(Default)]
struct Bridges {
    /// States for the bridge of each robot.
    robots: BTreeMap<RobotId, UnboundedSender<DriverState>>,
    tasks: JoinSet<()>,
    /// Publish the scans of robots with range sensors.
    scans: JoinSet<()>,
}

impl Bridges {
    async fn serve(&mut self, ros: &Ros, settings: ServeSettings) -> Result<(), ServeError> {
        let mut states = settings.bus.subscribe(&settings.keys.any_driver_state()).await?;
        let mut names: BTreeSet<String> = BTreeSet::new();
        while let Some(sample) = states.recv().await {
            let state: DriverState = match codec::decode(&sample.payload) {
                Ok(state) => state,
                Err(problem) => {
                    warn!(key = sample.key, %problem, "unreadable state");
                    continue;
                }
            };
            let robot = state.robot.clone();
            if !self.robots.contains_key(&robot) {
                let (sender, states) = unbounded_channel();
                self.robots.insert(robot.clone(), sender);
                let name = mapping::ros_name(&robot);
                if !names.insert(name.clone()) {
                    warn!(%robot, name, "another robot has the same name in ROS 2; no action server is offered");
                    continue;
                }
                let server = ActionServer::offer(&ros.node, &format!("/{name}/navigate_to_pose"))?;
                let executor = GoalExecutor::new(robot.clone(), Arc::clone(&settings.planner), settings.run);
                let command = settings.keys.write(&Key::Driver(robot.clone(), DriverCall::Command));
                let since = Instant::now();
                let graph = settings.graph.clone();
                if let Some(graph) = graph.clone() {
                    let (bus, world) = (settings.bus.clone(), settings.keys.write(&Key::World));
                    self.scans.spawn(sensors::publish_scans(graph, bus, world, robot.clone()));
                }
                let bridge = Bridge { robot, name, graph, server, executor, bus: settings.bus.clone(), command, since };
                self.tasks.spawn(bridge.run(states));
            }
            // A robot that is not offered has no receiver.
            let _ = self.robots[&state.robot].send(state);
        }
        Err(ServeError::Closed)
    }

    /// Stops all robots, and waits until the clients of their goals have the results.
    async fn stop(mut self) {
        // A bridge stops when no more states can arrive.
        self.robots.clear();
        while self.tasks.join_next().await.is_some() {}
    }
}

/// Performs the actions of a robot's executor.
struct Bridge {
    robot: RobotId,
    /// Its name in ROS 2.
    name: String,
    graph: Option<Arc<Graph>>,
    server: ActionServer,
    executor: GoalExecutor,
    bus: SharedBus,
    command: String,
    since: Instant,
}

impl Bridge {
    async fn run(mut self, mut states: UnboundedReceiver<DriverState>) {
        let mut heartbeat = tokio::time::interval(HEARTBEAT_INTERVAL);
        heartbeat.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let now = self.since.elapsed();
            let actions = tokio::select! {
                // A goal is not handled before the state with which the robot was offered.
                biased;
                state = states.recv() => match state {
                    Some(state) => {
                        if let Some(graph) = &self.graph {
                            sensors::publish(graph, &self.name, &state.telemetry).await;
                        }
                        self.executor.handle_state(state, now)
                    }
                    None => return self.stop().await,
                },
                request = self.server.next_request() => match request {
                    Some(ClientRequest::Execute(goal, goal_message)) => {
                        info!(robot = %self.robot, "goal received from ROS 2");
                        self.executor.handle_goal(goal, mapping::from_ros(&goal_message.pose), now)
                    }
                    Some(ClientRequest::Cancel(goal)) => self.executor.cancel(goal),
                    None => return,
                },
                _ = heartbeat.tick(), if self.executor.is_busy() => self.executor.tick(now),
            };
            self.perform(actions).await;
        }
    }

    /// Cancels all goals; ends when the robot has stopped and the clients have their results.
    async fn stop(mut self) {
        let actions = self.executor.stop();
        let canceled = async {
            self.perform(actions).await;
            while self.executor.is_busy() {
                tokio::time::sleep(HEARTBEAT_INTERVAL).await;
                let repeated = self.executor.tick(self.since.elapsed());
                self.perform(repeated).await;
            }
        };
        if tokio::time::timeout(STOP_TIMEOUT, canceled).await.is_err() {
            warn!(robot = %self.robot, "no reply to a cancel; the robot stops at its client timeout");
        }
        self.server.close().await;
    }

    async fn perform(&mut self, actions: Vec<Action>) {
        let mut actions = VecDeque::from(actions);
        while let Some(action) = actions.pop_front() {
            match action {
                Action::Command(request) => {
                    if let Some(state) = self.command(request).await {
                        actions.extend(self.executor.handle_state(state, self.since.elapsed()));
                    }
                }
                Action::Feedback(goal, report) => self.server.apply(GoalUpdate::Progress(goal, progress(report))),
                Action::End(goal, end_state, outcome) => {
                    info!(robot = %self.robot, ?end_state, error = outcome.error_code, outcome.error_msg, "goal ended");
                    self.server.apply(GoalUpdate::Ended(goal, end_state, outcome));
                }
            }
        }
    }

    /// Sends a command to the driver server; returns the state in its reply, if any. Driver servers
    /// of other robots may refuse it.
    async fn command(&self, request: Option<GoalRequest>) -> Option<DriverState> {
        let command = self.executor.command(request, self.since.elapsed());
        let bytes = Bytes::from(codec::encode(&command).expect("a goal is small enough for a message"));
        let mut replies = match self.bus.query(&self.command, bytes, REPLY_TIMEOUT).await {
            Ok(replies) => replies,
            Err(problem) => {
                warn!(robot = %self.robot, %problem, "a command was not sent");
                return None;
            }
        };
        while let Some(reply) = replies.recv().await {
            match reply.payload {
                Ok(payload) => match codec::decode::<DriverState>(&payload) {
                    Ok(state) if state.robot == self.robot => return Some(state),
                    Ok(state) => {
                        warn!(robot = %self.robot, other = %state.robot, "received the state of another robot");
                    }
                    Err(problem) => warn!(robot = %self.robot, %problem, "unreadable state"),
                },
                Err(refused) => {
                    debug!(robot = %self.robot, problem = refused.0, "a driver server refused a command");
                }
            }
        }
        None
    }
}

fn progress(report: Report) -> Progress {
    Progress {
        current_pose: mapping::to_ros(report.pose, mapping::now()),
        navigation_time: mapping::duration(report.navigation_s),
        estimated_time_remaining: mapping::duration(report.remaining_s),
        number_of_recoveries: report.recoveries,
        distance_remaining: report.distance.get() as f32,
    }
}
