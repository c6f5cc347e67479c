//! Simulated robots for ROS 2: for every body that a host of the fleet tells of, a `NavigateToPose` action server.
//!
//! ```text
//!  ROS 2 (rmw_zenoh)          this program                        fleet's bus
//!  /ada/navigate_to_pose ◀──▶ ActionServer ◀─▶ Pursuit ── wire/body/ada/command ──▶ host (world)
//!                                                      ◀── wire/body/ada/state ────
//! ```
//!
//! A body has one driver. Here that is whoever asks through ROS 2, and only while a goal is under way: then this program is the
//! driver, and the body stops if it falls silent. A body that a robot of the fleet drives belongs to that robot, which calls off
//! what it did not begin; the client is told so.

pub mod pursuit;

use crate::action_server::{ActionServer, Wish, Word};
use crate::itinerary::Atlas;
use crate::mapping;
use crate::messages::Progress;
use crate::ros::{Ros, RosError};
use bytes::Bytes;
use consort_actors::body::{BodyCommand, BodyState, Order};
use consort_actors::bus::{BusError, SharedBus};
use consort_protocol::codec;
use consort_protocol::ids::RobotId;
use consort_protocol::keys::{BodyCall, Key, Keys};
use pursuit::{Action, Pursuit, Report};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior};
use tracing::{debug, info, warn};

/// How often a host is told that there is a driver, while a goal is under way; well below the three seconds after which it
/// takes the driver for silent. Feedback comes as often.
const BEAT: Duration = Duration::from_millis(300);

/// How long a host may take to answer a command; then it is asked again.
const ANSWER: Duration = Duration::from_secs(1);

/// What is served from.
pub struct ServeSettings {
    /// The fleet's bus.
    pub bus: SharedBus,
    /// The fleet's keys.
    pub keys: Keys,
    /// The floor that the bodies are on.
    pub atlas: Arc<Atlas>,
    /// The bodies' goals get ids from here on: larger than any that was ever used, as milliseconds since 1970 times a million
    /// are.
    pub first_goal: u64,
}

/// Why there is nothing to be served, or no longer.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The fleet's bus.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The ROS 2 graph.
    #[error(transparent)]
    Ros(#[from] RosError),
    /// The bus was closed: nothing more will be heard.
    #[error("the fleet's bus was closed")]
    Closed,
}

/// Offers an action server on `ros` for every body that is heard of on the bus, for as long as it is polled. A body that is no longer
/// told of keeps its server: goals for it are aborted.
///
/// # Errors
/// [`ServeError`]: it ends with the bus, or when an action cannot be offered.
pub async fn serve(ros: &Ros, settings: ServeSettings) -> Result<(), ServeError> {
    let mut states = settings.bus.subscribe(&settings.keys.any_body_state()).await?;
    let mut robots: BTreeMap<RobotId, UnboundedSender<BodyState>> = BTreeMap::new();
    let mut names: BTreeSet<String> = BTreeSet::new();
    let mut tasks = JoinSet::new();
    while let Some(sample) = states.recv().await {
        let state: BodyState = match codec::decode(&sample.payload) {
            Ok(state) => state,
            Err(problem) => {
                warn!(key = sample.key, %problem, "a state that cannot be read");
                continue;
            }
        };
        let robot = state.robot.clone();
        if !robots.contains_key(&robot) {
            let (sender, heard) = unbounded_channel();
            robots.insert(robot.clone(), sender);
            let name = mapping::ros_name(&robot);
            if !names.insert(name.clone()) {
                warn!(%robot, name, "another robot has this name in ROS 2: not offered");
                continue;
            }
            let server = ActionServer::offer(&ros.node, &format!("/{name}/navigate_to_pose"))?;
            let pursuit = Pursuit::new(robot.clone(), Arc::clone(&settings.atlas), settings.first_goal);
            let command = settings.keys.write(&Key::Body(robot.clone(), BodyCall::Command));
            let bridge = Bridge { robot, server, pursuit, bus: settings.bus.clone(), command, since: Instant::now() };
            tasks.spawn(bridge.run(heard));
        }
        // One that is not offered has nobody to hear it.
        let _ = robots[&state.robot].send(state);
    }
    Err(ServeError::Closed)
}

/// Carries out what is decided for one robot.
struct Bridge {
    robot: RobotId,
    server: ActionServer,
    pursuit: Pursuit,
    bus: SharedBus,
    command: String,
    since: Instant,
}

impl Bridge {
    async fn run(mut self, mut heard: UnboundedReceiver<BodyState>) {
        let mut beat = tokio::time::interval(BEAT);
        beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let now = self.since.elapsed();
            let actions = tokio::select! {
                state = heard.recv() => match state {
                    Some(state) => self.pursuit.hear(state, now),
                    None => return,
                },
                wish = self.server.wish() => match wish {
                    Some(Wish::Pursue(goal, wanted)) => {
                        info!(robot = %self.robot, "a goal from ROS 2");
                        self.pursuit.want(goal, mapping::from_ros(&wanted.pose), now)
                    }
                    Some(Wish::Cancel(goal)) => self.pursuit.cancel(goal),
                    None => return,
                },
                _ = beat.tick(), if self.pursuit.is_busy() => self.pursuit.tick(now),
            };
            self.perform(actions).await;
        }
    }

    async fn perform(&mut self, actions: Vec<Action>) {
        let mut actions = VecDeque::from(actions);
        while let Some(action) = actions.pop_front() {
            match action {
                Action::Command(order) => {
                    if let Some(state) = self.command(order).await {
                        actions.extend(self.pursuit.hear(state, self.since.elapsed()));
                    }
                }
                Action::Tell(goal, report) => self.server.say(Word::Progress(goal, progress(report))),
                Action::End(goal, how, outcome) => {
                    info!(robot = %self.robot, ?how, error = outcome.error_code, outcome.error_msg, "the goal has ended");
                    self.server.say(Word::Ended(goal, how, outcome));
                }
            }
        }
    }

    /// Sends a command to the body's host: how it says the body is, if it answers. Other hosts may refuse.
    async fn command(&self, order: Option<Order>) -> Option<BodyState> {
        let bytes = Bytes::from(codec::encode(&BodyCommand { order }).expect("a goal fits a message"));
        let mut replies = match self.bus.query(&self.command, bytes, ANSWER).await {
            Ok(replies) => replies,
            Err(problem) => {
                warn!(robot = %self.robot, %problem, "a command was not sent");
                return None;
            }
        };
        while let Some(reply) = replies.recv().await {
            match reply.payload {
                Ok(payload) => match codec::decode::<BodyState>(&payload) {
                    Ok(state) if state.robot == self.robot => return Some(state),
                    Ok(state) => warn!(robot = %self.robot, other = %state.robot, "a state of another body"),
                    Err(problem) => warn!(robot = %self.robot, %problem, "a state that cannot be read"),
                },
                Err(problem) => debug!(robot = %self.robot, problem, "a host refused a command"),
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
