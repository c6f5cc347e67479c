//! A robot under Nav2 for the fleet: its body on the fleet's bus, which acts through a `NavigateToPose` action server.
//!
//! ```text
//!  fleet's bus                                            this program                    ROS 2 (rmw_zenoh)
//!  robot's node: skills ── wire/body/ada/command ──▶ Host ─▶ Nav2Body ─▶ ActionClient ──▶ /navigate_to_pose
//!                       ◀── wire/body/ada/state ────      ◀─ feedback, result ◀──────────
//! ```
//!
//! The robot's node is one like any other (`consort robot`), and its skills cannot tell. The map of the fleet and that of Nav2
//! have the same origin and axes.

pub mod nav2_body;

use crate::action_client::{ActionClient, Answer, End};
use crate::goals::Uuid;
use crate::mapping;
use crate::messages::{Goal, Progress};
use crate::ros::{Ros, RosError};
use consort_actors::body::{Host, HostSettings, SILENCE};
use consort_actors::bus::SharedBus;
use consort_actors::clock::Clock;
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::keys::Keys;
use consort_protocol::pose::Pose;
use consort_skills::actions::ActionError;
use hiroz::action::GoalId;
use nav2_body::{Ask, Heard, Nav2Body};
use ractor::Actor;
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, sleep_until};
use tracing::{info, warn};

/// How often the body's state is published while nothing changes: as a world's.
const BEAT: Duration = Duration::from_millis(500);

/// A drive of which nothing is heard for so long is lost: Nav2 tells of it many times a second. The links of `rmw_zenoh` take a
/// minute to notice that a machine has vanished.
const QUIET: Duration = Duration::from_secs(20);

/// How soon Nav2 is asked again to stop, until it has.
const STOP_AGAIN: Duration = Duration::from_secs(1);

/// Which robot is driven.
pub struct DriveSettings {
    /// The fleet's bus.
    pub bus: SharedBus,
    /// The fleet's keys.
    pub keys: Keys,
    /// The robot, by the name of its node in the fleet.
    pub robot: RobotId,
    /// Where it stands at first.
    pub place: PlaceId,
    /// The places of the fleet's map.
    pub places: BTreeMap<PlaceId, Pose>,
    /// The fully qualified name of its action, as `/navigate_to_pose`.
    pub action: String,
}

/// Why a robot is not driven, or no longer.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// The place where it stands.
    #[error(transparent)]
    Place(#[from] ActionError),
    /// The ROS 2 graph.
    #[error(transparent)]
    Ros(#[from] RosError),
    /// The body could not be offered on the fleet's bus, or no longer is.
    #[error("the body of {robot} is not on the fleet's bus: {problem}")]
    Host {
        /// Whose body.
        robot: RobotId,
        /// What the bus said.
        problem: String,
    },
}

/// Offers a robot's body on the bus, and has Nav2 do what it is to do, for as long as it is polled.
///
/// # Errors
/// [`DriveError`]: it ends when the body's host does.
pub async fn drive(ros: &Ros, settings: DriveSettings) -> Result<(), DriveError> {
    let DriveSettings { bus, keys, robot, place, places, action } = settings;
    let (client, feedback) = ActionClient::of(&ros.node, &action)?;
    let ((asks, asked), (hears, heard)) = (unbounded_channel(), unbounded_channel());
    let body = Nav2Body::new(robot.clone(), place, places, asks, heard)?;
    let host = HostSettings { keys, bus, clock: Clock::real(), speed: 1.0, beat: BEAT, silence: SILENCE };
    let hosted = Actor::spawn(None, Host, (host, Box::new(body))).await;
    let failed = |problem: String| DriveError::Host { robot: robot.clone(), problem };
    let (host, ended) = hosted.map_err(|problem| failed(problem.to_string()))?;
    let _stop = StopWhenDropped(host.get_cell());
    info!(%robot, action, served = client.is_served(), "drives");
    tokio::select! {
        () = relay(&robot, Arc::new(client), asked, feedback, hears) => Err(failed("it was closed".to_owned())),
        ended = ended => Err(failed(ended.err().map_or("it was stopped".to_owned(), |problem| problem.to_string()))),
    }
}

struct StopWhenDropped(ractor::ActorCell);

impl Drop for StopWhenDropped {
    fn drop(&mut self) {
        self.0.stop(None);
    }
}

/// A drive under way at Nav2.
struct Running {
    number: u64,
    id: Uuid,
    progress: UnboundedSender<Progress>,
    stop: watch::Sender<bool>,
}

/// Carries what the body asks to Nav2, and what Nav2 says to the body.
async fn relay(
    robot: &RobotId,
    client: Arc<ActionClient>,
    mut asked: UnboundedReceiver<Ask>,
    mut feedback: UnboundedReceiver<(Uuid, Progress)>,
    hears: UnboundedSender<Heard>,
) {
    let mut running: Option<Running> = None;
    let mut drives = JoinSet::new();
    loop {
        tokio::select! {
            ask = asked.recv() => match ask {
                Some(Ask::Drive(number, to)) => {
                    let id = *GoalId::new().as_bytes();
                    let ((progress, told), (stop, stopped)) = (unbounded_channel(), watch::channel(false));
                    running = Some(Running { number, id, progress, stop });
                    let drive = Drive { client: Arc::clone(&client), number, id, to, hears: hears.clone() };
                    let robot = robot.clone();
                    drives.spawn(async move {
                        let end = drive.run(told, stopped).await;
                        info!(%robot, ?end, "a drive at Nav2 is over");
                    });
                }
                Some(Ask::Stop(number)) => {
                    if let Some(running) = running.as_ref().filter(|running| running.number == number) {
                        running.stop.send_replace(true);
                    }
                }
                None => return,
            },
            Some((id, progress)) = feedback.recv() => {
                if let Some(running) = running.as_ref().filter(|running| running.id == id) {
                    // A drive that is over hears no more.
                    let _ = running.progress.send(progress);
                }
            }
            Some(_) = drives.join_next() => {}
        }
    }
}

struct Drive {
    client: Arc<ActionClient>,
    number: u64,
    id: Uuid,
    to: Pose,
    hears: UnboundedSender<Heard>,
}

impl Drive {
    /// Has Nav2 drive there; returns what the body was told at last.
    async fn run(self, mut told: UnboundedReceiver<Progress>, stop: watch::Receiver<bool>) -> Heard {
        let goal = Goal { pose: mapping::to_ros(self.to, mapping::now()), behavior_tree: String::new() };
        let last = match self.client.send(self.id, goal).await {
            Answer::Accepted => Heard::Ended(self.number, self.until_over(&mut told, stop).await),
            Answer::Rejected => Heard::Refused(self.number, "Nav2 has rejected the goal".to_owned()),
            Answer::Nobody => Heard::Refused(self.number, "no server of Nav2 has answered".to_owned()),
        };
        self.say(last.clone());
        last
    }

    async fn until_over(&self, told: &mut UnboundedReceiver<Progress>, stop: watch::Receiver<bool>) -> End {
        tokio::select! {
            end = self.follow(told) => end,
            never = self.stop_when_told(stop) => match never {},
        }
    }

    /// Hands on how it goes until it is over.
    async fn follow(&self, told: &mut UnboundedReceiver<Progress>) -> End {
        let result = self.client.result(self.id);
        tokio::pin!(result);
        let mut quiet_at = Instant::now() + QUIET;
        loop {
            tokio::select! {
                end = &mut result => return end,
                Some(progress) = told.recv() => {
                    quiet_at = Instant::now() + QUIET;
                    self.tell(&progress);
                }
                () = sleep_until(quiet_at) => {
                    let _ = self.client.cancel(self.id).await; // should it still be there
                    return End::Lost(format!("nothing was heard of the drive for {} s", QUIET.as_secs()));
                }
            }
        }
    }

    /// Asks Nav2 to stop, again and again, once that is wanted.
    async fn stop_when_told(&self, mut stop: watch::Receiver<bool>) -> Infallible {
        // An error says that another drive has taken this one's place: nobody wants it any more.
        let _ = stop.wait_for(|told| *told).await;
        loop {
            let answer = self.client.cancel(self.id).await;
            if answer != Answer::Accepted {
                warn!(?answer, "Nav2 was asked to stop");
            }
            sleep(STOP_AGAIN).await;
        }
    }

    fn tell(&self, progress: &Progress) {
        match mapping::from_ros(&progress.current_pose) {
            Ok(pose) => self.say(Heard::Progress {
                drive: self.number,
                pose,
                distance_m: f64::from(progress.distance_remaining),
                remaining_s: f64::from(progress.estimated_time_remaining.sec)
                    + f64::from(progress.estimated_time_remaining.nanosec) * 1e-9,
            }),
            Err(problem) => warn!(%problem, "where the robot is cannot be told"),
        }
    }

    fn say(&self, heard: Heard) {
        // The body is gone: the program is ending.
        let _ = self.hears.send(heard);
    }
}
