//! A robot under Nav2 for the fleet: its driver server on the fleet's bus, which drives through a
//! `NavigateToPose` action server.
//!
//! ```text
//!  fleet's bus                                                this program                          ROS 2 (rmw_zenoh)
//!  robot's node: skills ── wire/driver/ada/command ──▶ DriverServer ─▶ Nav2Driver ─▶ ActionClient ──▶ /navigate_to_pose
//!                       ◀── wire/driver/ada/state ────              ◀─ feedback, result ◀──────────
//! ```
//!
//! The robot's node is an ordinary node (`consort robot`); its skills do not depend on the kind of
//! driver. The map of the fleet and the map of Nav2 have the same origin and axes.

pub mod nav2_driver;

use crate::action_client::{ActionClient, DriveResult, RequestResult};
use crate::goals::GoalUuid;
use crate::mapping;
use crate::messages::{Goal, Progress};
use crate::ros::{Ros, RosError};
use consort_bus::SharedBus;
use consort_bus::clock::Clock;
use consort_fleet::robot_driver::{CLIENT_TIMEOUT, DriverServer, DriverServerSettings};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::keys::Keys;
use consort_protocol::pose::Pose;
use consort_skills::actions::ActionError;
use hiroz::action::GoalId;
use nav2_driver::{Nav2Command, Nav2Driver, Nav2Event};
use ractor::Actor;
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::future::Future;
use std::hash::{BuildHasher as _, Hasher as _, RandomState};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, sleep_until, timeout};
use tracing::{info, warn};

/// Interval at which the state is published without changes: the interval of a world.
const PUBLISH_INTERVAL: Duration = Duration::from_millis(500);

/// Time without feedback after which a drive is lost: Nav2 sends feedback several times a second.
/// The links of `rmw_zenoh` take a minute to detect a lost machine.
const FEEDBACK_TIMEOUT: Duration = Duration::from_secs(20);

/// Interval at which a cancel request is repeated until the drive ends.
const CANCEL_INTERVAL: Duration = Duration::from_secs(1);

/// Settings of the driven robot.
pub struct DriveSettings {
    /// The fleet's bus.
    pub bus: SharedBus,
    /// The fleet's keys.
    pub keys: Keys,
    /// The robot, by the name of its node in the fleet.
    pub robot: RobotId,
    /// Place of the robot at the start.
    pub place: PlaceId,
    /// The places of the fleet's map.
    pub places: BTreeMap<PlaceId, Pose>,
    /// Fully qualified name of its action, for example `/navigate_to_pose`.
    pub action: String,
}

/// The robot cannot be driven, or no longer.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// The start place is not on the map.
    #[error(transparent)]
    Place(#[from] ActionError),
    /// The ROS 2 graph failed.
    #[error(transparent)]
    Ros(#[from] RosError),
    /// The driver server is not on the fleet's bus, or no longer.
    #[error("the driver server of {robot} is not on the fleet's bus: {problem}")]
    DriverServer {
        /// The robot.
        robot: RobotId,
        /// The error of the bus.
        problem: String,
    },
}

/// Time limit for the end of Nav2's goals for others before the first drive.
const FREE_TIMEOUT: Duration = Duration::from_secs(10);

/// Time limit to stop the robot when the program ends.
const STOP_TIMEOUT: Duration = Duration::from_secs(5);

/// Runs the driver server of a robot on the bus, and has Nav2 execute its goals, until `stop` is
/// ready. At the start it cancels the goals that Nav2 still executes, perhaps for a previous run of
/// this program; at the end it cancels its own.
///
/// # Errors
/// [`DriveError`]: it ends with the driver server.
pub async fn drive(ros: &Ros, settings: DriveSettings, stop: impl Future<Output = ()>) -> Result<(), DriveError> {
    let DriveSettings { bus, keys, robot, place, places, action } = settings;
    let (client, feedback) = ActionClient::of(&ros.node, &action)?;
    let ((commands, command_receiver), (events, event_receiver)) = (unbounded_channel(), unbounded_channel());
    let driver = Nav2Driver::new(robot.clone(), place, places, commands, event_receiver)?;
    let server = DriverServerSettings {
        boot: random_number(),
        keys,
        bus,
        clock: Clock::real(),
        speed: 1.0,
        publish_interval: PUBLISH_INTERVAL,
        client_timeout: CLIENT_TIMEOUT,
    };
    let spawned = Actor::spawn(None, DriverServer, (server, Box::new(driver))).await;
    let failed = |problem: String| DriveError::DriverServer { robot: robot.clone(), problem };
    let (server, ended) = spawned.map_err(|problem| failed(problem.to_string()))?;
    let _stop = StopWhenDropped(server.get_cell());
    info!(%robot, action, served = client.is_served(), "driving");
    let relay = Relay::new(robot.clone(), client, events);
    tokio::select! {
        () = relay.run(command_receiver, feedback, stop) => Ok(()),
        ended = ended => Err(failed(ended.err().map_or("it was stopped".to_owned(), |problem| problem.to_string()))),
    }
}

/// Returns a number from the operating system: the keys of a new hasher are random.
fn random_number() -> u64 {
    RandomState::new().build_hasher().finish()
}

struct StopWhenDropped(ractor::ActorCell);

impl Drop for StopWhenDropped {
    fn drop(&mut self) {
        self.0.stop(None);
    }
}

/// A drive in progress at Nav2.
struct Running {
    number: u64,
    id: GoalUuid,
    progress: UnboundedSender<Progress>,
    stop: watch::Sender<bool>,
}

/// Forwards commands of the driver to Nav2, and events of Nav2 to the driver.
struct Relay {
    robot: RobotId,
    client: Arc<ActionClient>,
    events: UnboundedSender<Nav2Event>,
    running: Option<Running>,
    drives: JoinSet<()>,
    /// True once Nav2 has no goals of others.
    is_free: watch::Sender<bool>,
}

impl Relay {
    fn new(robot: RobotId, client: ActionClient, events: UnboundedSender<Nav2Event>) -> Relay {
        let (is_free, _) = watch::channel(false);
        Relay { robot, client: Arc::new(client), events, running: None, drives: JoinSet::new(), is_free }
    }

    /// Ends when the driver has ended or, after `stop` is ready, when Nav2 has ended its goal.
    async fn run(
        mut self,
        mut commands: UnboundedReceiver<Nav2Command>,
        mut feedback: UnboundedReceiver<(GoalUuid, Progress)>,
        stop: impl Future<Output = ()>,
    ) {
        let cancel_others = cancel_goals_of_others(Arc::clone(&self.client), self.is_free.clone());
        tokio::pin!(cancel_others, stop);
        loop {
            tokio::select! {
                never = &mut cancel_others => match never {},
                () = &mut stop => return self.stop().await,
                command = commands.recv() => match command {
                    Some(Nav2Command::Drive(number, to)) => self.drive(number, to),
                    Some(Nav2Command::Stop(number)) => self.cancel(|running| running.number == number),
                    None => return,
                },
                Some((id, progress)) = feedback.recv() => {
                    if let Some(running) = self.running.as_ref().filter(|running| running.id == id) {
                        // A finished drive receives no feedback.
                        let _ = running.progress.send(progress);
                    }
                }
                Some(_) = self.drives.join_next() => {}
            }
        }
    }

    fn drive(&mut self, number: u64, to: Pose) {
        let id = *GoalId::new().as_bytes();
        let ((progress, feedback), (stop, stopped)) = (unbounded_channel(), watch::channel(false));
        self.running = Some(Running { number, id, progress, stop });
        let (client, events, is_free) = (Arc::clone(&self.client), self.events.clone(), self.is_free.subscribe());
        let drive = Drive { client, number, id, to, events, is_free };
        let robot = self.robot.clone();
        self.drives.spawn(async move {
            let end = drive.run(feedback, stopped).await;
            info!(%robot, ?end, "drive at Nav2 ended");
        });
    }

    fn cancel(&self, matches: impl Fn(&Running) -> bool) {
        if let Some(running) = self.running.as_ref().filter(|running| matches(running)) {
            running.stop.send_replace(true);
        }
    }

    /// Cancels the drive in progress and waits for its end.
    async fn stop(mut self) {
        self.cancel(|_| true);
        let ended = async { while self.drives.join_next().await.is_some() {} };
        if timeout(STOP_TIMEOUT, ended).await.is_err() {
            warn!(robot = %self.robot, "Nav2 has not ended its goal in {} s", STOP_TIMEOUT.as_secs());
        }
    }
}

/// Cancels the goals that Nav2 executes for others, once it is on the graph. A previous run of this
/// program may have begun them, and nobody supervises them. A server that does not reply has none, or
/// cannot be stopped by anybody.
async fn cancel_goals_of_others(client: Arc<ActionClient>, is_free: watch::Sender<bool>) -> Infallible {
    loop {
        let was_served = client.is_served();
        if client.cancel_all().await != RequestResult::NoReply {
            break;
        }
        if was_served {
            warn!("no reply of Nav2 to the request to cancel all goals");
            break;
        }
        sleep(CANCEL_INTERVAL).await;
    }
    is_free.send_replace(true);
    std::future::pending().await
}

struct Drive {
    client: Arc<ActionClient>,
    number: u64,
    id: GoalUuid,
    to: Pose,
    events: UnboundedSender<Nav2Event>,
    is_free: watch::Receiver<bool>,
}

impl Drive {
    /// Sends the drive to Nav2; returns the last event sent to the driver.
    async fn run(mut self, mut feedback: UnboundedReceiver<Progress>, stop: watch::Receiver<bool>) -> Nav2Event {
        let goal = Goal { pose: mapping::to_ros(self.to, mapping::now()), behavior_tree: String::new() };
        // Without a reply to the cancel request of the start, there is none to the goal either.
        let is_free =
            self.client.is_served() && timeout(FREE_TIMEOUT, self.is_free.wait_for(|is_free| *is_free)).await.is_ok();
        let result = match is_free {
            true if *stop.borrow() => None,
            true => Some(self.client.send(self.id, goal).await),
            false => Some(RequestResult::NoReply),
        };
        let last = match result {
            // The robot must not begin to drive after it was stopped.
            None => Nav2Event::Ended(self.number, DriveResult::Canceled),
            Some(RequestResult::Accepted) => {
                Nav2Event::Ended(self.number, self.run_until_end(&mut feedback, stop).await)
            }
            Some(RequestResult::Rejected) => Nav2Event::Rejected(self.number, "Nav2 has rejected the goal".to_owned()),
            Some(RequestResult::NoReply) => {
                Nav2Event::Rejected(self.number, "no server of Nav2 has replied".to_owned())
            }
        };
        self.send_event(last.clone());
        last
    }

    async fn run_until_end(
        &self,
        feedback: &mut UnboundedReceiver<Progress>,
        stop: watch::Receiver<bool>,
    ) -> DriveResult {
        tokio::select! {
            end = self.forward_feedback(feedback) => end,
            never = self.cancel_when_requested(stop) => match never {},
        }
    }

    /// Forwards the feedback until the drive ends.
    async fn forward_feedback(&self, feedback: &mut UnboundedReceiver<Progress>) -> DriveResult {
        let result = self.client.result(self.id);
        tokio::pin!(result);
        let mut feedback_deadline = Instant::now() + FEEDBACK_TIMEOUT;
        loop {
            tokio::select! {
                end = &mut result => return end,
                Some(progress) = feedback.recv() => {
                    feedback_deadline = Instant::now() + FEEDBACK_TIMEOUT;
                    self.report_progress(&progress);
                }
                () = sleep_until(feedback_deadline) => {
                    let _ = self.client.cancel(self.id).await; // in case it is still running
                    return DriveResult::Lost(format!("no feedback of the drive for {} s", FEEDBACK_TIMEOUT.as_secs()));
                }
            }
        }
    }

    /// Sends cancel requests to Nav2, repeatedly, once requested.
    async fn cancel_when_requested(&self, mut stop: watch::Receiver<bool>) -> Infallible {
        // An error means that another drive has replaced this drive: no cancel is needed.
        let _ = stop.wait_for(|requested| *requested).await;
        loop {
            let result = self.client.cancel(self.id).await;
            if result != RequestResult::Accepted {
                warn!(?result, "cancel request to Nav2 failed");
            }
            sleep(CANCEL_INTERVAL).await;
        }
    }

    fn report_progress(&self, progress: &Progress) {
        match mapping::from_ros(&progress.current_pose) {
            Ok(pose) => self.send_event(Nav2Event::Progress {
                drive: self.number,
                pose,
                distance_m: f64::from(progress.distance_remaining),
                remaining_s: f64::from(progress.estimated_time_remaining.sec)
                    + f64::from(progress.estimated_time_remaining.nanosec) * 1e-9,
            }),
            Err(problem) => warn!(%problem, "the pose in the feedback is invalid"),
        }
    }

    fn send_event(&self, event: Nav2Event) {
        // Without its receiver the program is ending.
        let _ = self.events.send(event);
    }
}
