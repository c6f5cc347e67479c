//! The driver of a robot under Nav2, as a state machine: its commands leave as [`Nav2Command`]s,
//! the events of Nav2 arrive as [`Nav2Event`]s, and its driver server advances time.
//!
//! The driver drives and waits; it rejects goals that need an arm, a drawer or a charger. Between
//! two drives the robot stays where the last drive ended. Its battery is not known and counts as
//! full.

use crate::action_client::DriveResult;
use crate::mapping;
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, Metres, Seconds, WorldTime};
use consort_skills::actions::{
    ActionError, BackendEvent, ErrorCode, Feedback, FollowWaypoints, Goal, GoalId, GoalProgress, GoalStatus,
    NavigateToPose, PersonRequest, PersonResult, PlaceTracker, RobotBackend, Telemetry, Wait, Waypoint,
};
use std::collections::{BTreeMap, VecDeque};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender};

/// Number of ended goals with a known status.
const ENDED_GOALS_KEPT: usize = 32;

/// Interval at which the driver server checks for events of Nav2 during a drive.
const CHECK_INTERVAL_S: f64 = 0.05;

/// A command for Nav2.
#[derive(Debug, Clone, PartialEq)]
pub enum Nav2Command {
    /// Drive to a pose. The events of the drive have the same number.
    Drive(u64, Pose),
    /// Stop that drive.
    Stop(u64),
}

/// An event of Nav2, about the drive with a number.
#[derive(Debug, Clone, PartialEq)]
pub enum Nav2Event {
    /// Feedback.
    Progress {
        /// Number of the drive.
        drive: u64,
        /// Pose of the robot.
        pose: Pose,
        /// Remaining distance.
        distance_m: f64,
        /// Remaining seconds.
        remaining_s: f64,
    },
    /// The drive was rejected, with the reason.
    Rejected(u64, String),
    /// The drive has ended.
    Ended(u64, DriveResult),
}

/// Returns the progress of a goal, given the number of waypoints after the current waypoint.
fn waypoint_progress(goal: &Goal, following: usize) -> GoalProgress {
    match goal.read() {
        Some(Ok(FollowWaypoints { waypoints })) => {
            let current = waypoints.len().saturating_sub(following + 1);
            GoalProgress::Waypoint(u32::try_from(current).unwrap_or(u32::MAX))
        }
        _ => GoalProgress::Unspecified,
    }
}

/// See the [module](self).
pub struct Nav2Driver {
    robot: RobotId,
    places: PlaceTracker,
    commands: UnboundedSender<Nav2Command>,
    nav2_events: UnboundedReceiver<Nav2Event>,
    now: WorldTime,
    pose: Pose,
    current: Option<CurrentGoal>,
    ended: VecDeque<(GoalId, Goal, GoalStatus)>,
    pending_events: Vec<BackendEvent>,
    drive_count: u64,
}

struct CurrentGoal {
    id: GoalId,
    goal: Goal,
    activity: Activity,
}

enum Activity {
    /// Until this time, in seconds of world time.
    Waiting(f64),
    Driving {
        drive: u64,
        to: Waypoint,
        /// The following waypoints.
        following: VecDeque<Waypoint>,
        feedback: Feedback,
        stopping: bool,
    },
}

impl Nav2Driver {
    /// Creates the driver of a robot at a place of a map. Commands for Nav2 are sent to
    /// `commands`; events of Nav2 are received from `nav2_events`.
    ///
    /// # Errors
    /// [`ActionError`] if the place is not on the map.
    pub fn new(
        robot: RobotId,
        place: PlaceId,
        places: BTreeMap<PlaceId, Pose>,
        commands: UnboundedSender<Nav2Command>,
        nav2_events: UnboundedReceiver<Nav2Event>,
    ) -> Result<Nav2Driver, ActionError> {
        let Some(pose) = places.get(&place).copied() else {
            let names: Vec<&str> = places.keys().map(PlaceId::as_str).collect();
            let message = format!("{:?} is not on the map; allowed are {}", place.as_str(), names.join(", "));
            return Err(ActionError::new(ErrorCode::Unknown, message));
        };
        Ok(Nav2Driver {
            robot,
            places: PlaceTracker::new(place, places),
            commands,
            nav2_events,
            now: WorldTime::ZERO,
            pose,
            current: None,
            ended: VecDeque::new(),
            pending_events: vec![],
            drive_count: 0,
        })
    }

    fn send_command(&self, command: Nav2Command) {
        // Without a receiver the program is ending.
        let _ = self.commands.send(command);
    }

    fn has_goal(&self, id: GoalId) -> bool {
        self.current.as_ref().is_some_and(|current| current.id == id) || self.ended.iter().any(|(old, ..)| *old == id)
    }

    fn drive(&mut self, to: Waypoint, following: VecDeque<Waypoint>) -> Activity {
        self.drive_count += 1;
        let drive = self.drive_count;
        self.send_command(Nav2Command::Drive(drive, to.pose));
        let distance_remaining = self.pose.distance(to.pose);
        let feedback = Feedback::remaining(distance_remaining, Seconds::ZERO);
        Activity::Driving { drive, to, following, feedback, stopping: false }
    }

    /// Starts a goal, if this driver supports it.
    fn begin(&mut self, goal: &Goal) -> Result<Activity, ActionError> {
        let reject = |what: &str| {
            let message = format!("{} is driven by Nav2 and cannot {what}", self.robot);
            Err(ActionError::new(ErrorCode::Unknown, message))
        };
        if let Some(drive) = goal.read() {
            let NavigateToPose { pose, place, .. } = drive?;
            return Ok(self.drive(Waypoint { pose, place }, VecDeque::new()));
        }
        if let Some(follow) = goal.read() {
            let FollowWaypoints { waypoints } = follow?;
            let mut waypoints = VecDeque::from(waypoints);
            return match waypoints.pop_front() {
                Some(first) => Ok(self.drive(first, waypoints)),
                None => reject("follow no waypoints"),
            };
        }
        match goal.read() {
            Some(wait) => {
                let Wait { time } = wait?;
                Ok(Activity::Waiting(self.now.as_secs() + time.get()))
            }
            None => reject(&format!("perform the action {}", goal.action)),
        }
    }

    fn finish_goal(&mut self, id: GoalId, goal: Goal, status: GoalStatus) {
        self.pending_events.push(BackendEvent::GoalEnded {
            robot: self.robot.clone(),
            goal: id,
            status: status.clone(),
        });
        self.ended.push_back((id, goal, status));
        while self.ended.len() > ENDED_GOALS_KEPT {
            self.ended.pop_front();
        }
    }

    fn handle_event(&mut self, event: Nav2Event) {
        let number = match &event {
            Nav2Event::Progress { drive, .. } | Nav2Event::Rejected(drive, _) | Nav2Event::Ended(drive, _) => *drive,
        };
        let matches_drive =
            |activity: &Activity| matches!(activity, Activity::Driving { drive, .. } if *drive == number);
        let Some(CurrentGoal {
            id,
            goal,
            activity: Activity::Driving { drive, to, mut following, stopping, feedback: _ },
        }) = self.current.take_if(|current| matches_drive(&current.activity))
        else {
            return; // the drive has already ended
        };
        match event {
            Nav2Event::Progress { pose, distance_m, remaining_s, .. } => {
                self.set_pose(pose, None);
                let distance_remaining = Metres::new(distance_m).unwrap_or(Metres::ZERO);
                let time_remaining = Seconds::new(remaining_s).unwrap_or(Seconds::ZERO);
                let feedback = Feedback::remaining(distance_remaining, time_remaining);
                self.current = Some(CurrentGoal {
                    id,
                    goal,
                    activity: Activity::Driving { drive, to, following, feedback, stopping },
                });
            }
            Nav2Event::Ended(_, DriveResult::Succeeded) => {
                self.set_pose(to.pose, to.place);
                match following.pop_front() {
                    Some(next) if !stopping => {
                        let activity = self.drive(next, following);
                        self.current = Some(CurrentGoal { id, goal, activity });
                    }
                    Some(_) => self.finish_goal(id, goal, GoalStatus::Canceled),
                    None => self.finish_goal(id, goal, GoalStatus::succeeded()),
                }
            }
            Nav2Event::Ended(_, DriveResult::Canceled) if stopping => self.finish_goal(id, goal, GoalStatus::Canceled),
            Nav2Event::Ended(_, DriveResult::Canceled) => {
                self.abort(id, goal, ErrorCode::Unknown, "Nav2 canceled the drive".to_owned());
            }
            Nav2Event::Ended(_, DriveResult::Aborted(outcome)) => {
                let error = mapping::error(&outcome);
                if error.code == ErrorCode::Blocked {
                    self.add_closure(to.place);
                }
                self.finish_goal(id, goal, GoalStatus::Aborted(error));
            }
            Nav2Event::Ended(_, DriveResult::Lost(why)) => self.abort(id, goal, ErrorCode::TimedOut, why),
            Nav2Event::Rejected(_, why) => self.abort(id, goal, ErrorCode::Unknown, why),
        }
    }

    fn abort(&mut self, id: GoalId, goal: Goal, code: ErrorCode, message: String) {
        self.finish_goal(id, goal, GoalStatus::Aborted(ActionError::new(code, message)));
    }

    /// Sets the pose of the robot, and its place if the pose is at a place.
    fn set_pose(&mut self, pose: Pose, place: Option<PlaceId>) {
        self.pose = pose;
        self.places.set(pose, place);
    }

    fn add_closure(&mut self, to: Option<PlaceId>) {
        if let Some(to) = to {
            self.places.add_closure(to, self.now);
        }
    }
}

impl RobotBackend for Nav2Driver {
    fn robots(&self) -> Vec<RobotId> {
        vec![self.robot.clone()]
    }

    fn serves_people(&self) -> bool {
        false
    }

    fn start(&mut self, robot: &RobotId, id: GoalId, goal: Goal) {
        if *robot != self.robot || self.has_goal(id) {
            return;
        }
        if self.current.is_some() {
            let message = format!("{} has a goal in progress", self.robot);
            return self.abort(id, goal, ErrorCode::Busy, message);
        }
        match self.begin(&goal) {
            Ok(activity) => self.current = Some(CurrentGoal { id, goal, activity }),
            Err(error) => self.finish_goal(id, goal, GoalStatus::Aborted(error)),
        }
    }

    fn cancel(&mut self, robot: &RobotId, id: GoalId) {
        if *robot != self.robot {
            return;
        }
        let Some(current) = self.current.as_mut().filter(|current| current.id == id) else { return };
        match &mut current.activity {
            Activity::Driving { drive, stopping, .. } => {
                let drive = *drive;
                if !std::mem::replace(stopping, true) {
                    self.send_command(Nav2Command::Stop(drive));
                }
            }
            Activity::Waiting(_) => {
                if let Some(CurrentGoal { id, goal, .. }) = self.current.take() {
                    self.finish_goal(id, goal, GoalStatus::Canceled);
                }
            }
        }
    }

    fn request_person(&mut self, id: GoalId, _ask: PersonRequest) {
        let message = "this driver has no people".to_owned();
        self.pending_events.push(BackendEvent::PersonRequestEnded {
            request: id,
            result: Err(ActionError::new(ErrorCode::Unknown, message)),
        });
    }

    fn cancel_person_request(&mut self, _id: GoalId) {}

    fn now(&self) -> WorldTime {
        self.now
    }

    fn next_due(&self) -> Option<WorldTime> {
        let now = self.now.as_secs();
        match self.current.as_ref().map(|current| &current.activity) {
            _ if !self.pending_events.is_empty() => Some(self.now),
            Some(Activity::Waiting(until)) => Some(WorldTime::from_secs(until.max(now))),
            Some(Activity::Driving { .. }) => Some(WorldTime::from_secs(now + CHECK_INTERVAL_S)),
            None => None,
        }
    }

    fn advance(&mut self, to: WorldTime) -> Vec<BackendEvent> {
        self.now = WorldTime::from_secs(to.as_secs().max(self.now.as_secs()));
        while let Ok(event) = self.nav2_events.try_recv() {
            self.handle_event(event);
        }
        let now = self.now.as_secs();
        self.places.end_closures(self.now);
        let over = |activity: &Activity| matches!(activity, Activity::Waiting(until) if *until <= now);
        if let Some(CurrentGoal { id, goal, .. }) = self.current.take_if(|current| over(&current.activity)) {
            self.finish_goal(id, goal, GoalStatus::succeeded());
        }
        std::mem::take(&mut self.pending_events)
    }

    fn status(&self, robot: &RobotId, id: GoalId) -> Option<GoalStatus> {
        if *robot != self.robot {
            return None;
        }
        if let Some(current) = self.current.as_ref().filter(|current| current.id == id) {
            return Some(GoalStatus::Executing(match &current.activity {
                Activity::Driving { feedback, following, .. } => {
                    Feedback { progress: waypoint_progress(&current.goal, following.len()), ..feedback.clone() }
                }
                Activity::Waiting(until) => {
                    let left = Seconds::new(until - self.now.as_secs()).unwrap_or(Seconds::ZERO);
                    Feedback::remaining(Metres::ZERO, left)
                }
            }));
        }
        self.ended.iter().find(|(ended, ..)| *ended == id).map(|(.., status)| status.clone())
    }

    fn goals(&self, robot: &RobotId) -> Vec<GoalId> {
        if *robot != self.robot {
            return vec![];
        }
        let ended = self.ended.iter().map(|(id, ..)| *id);
        let mut goals: Vec<GoalId> = ended.chain(self.current.as_ref().map(|current| current.id)).collect();
        goals.sort();
        goals
    }

    fn goal(&self, robot: &RobotId, id: GoalId) -> Option<Goal> {
        if *robot != self.robot {
            return None;
        }
        let current = self.current.as_ref().filter(|current| current.id == id).map(|current| current.goal.clone());
        current.or_else(|| self.ended.iter().find(|(ended, ..)| *ended == id).map(|(_, goal, _)| goal.clone()))
    }

    fn open_person_requests(&self) -> Vec<GoalId> {
        vec![]
    }

    fn person_result(&self, _id: GoalId) -> Option<PersonResult> {
        None
    }

    fn was_person_request_canceled(&self, _id: GoalId) -> bool {
        false
    }

    fn telemetry(&self, robot: &RobotId) -> Option<Telemetry> {
        (*robot == self.robot).then(|| Telemetry {
            time: self.now,
            pose: self.pose,
            place: self.places.place().clone(),
            battery: BatteryShare::FULL,
            able: true,
            closed: self.places.closed(),
            readings: BTreeMap::new(),
        })
    }
}

#[cfg(test)]
mod tests;
