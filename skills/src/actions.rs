//! The robot-actions interface: skills use it to drive a robot, and backends implement its other
//! side.
//!
//! The vocabulary is Nav2's: a *goal* is sent, reports *feedback* while it is executed, and ends
//! with a *result*: succeeded, canceled or aborted with an error code. The backend is a simulated
//! world (in this process or another) or a real robot's adapter. Skills cannot distinguish them.
//!
//! ```text
//!  skill (behavior tree) ── RobotActions ──▶ goals   ┌────────────────┐
//!                        ◀── status, telemetry ──────│  RobotBackend  │  a world, or an adapter
//! ```

use consort_protocol::ids::{PlaceId, RobotId, RoleId};
use consort_protocol::mission::TaskSpec;
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, Metres, Seconds, WorldTime};
use serde::{Deserialize, Serialize};

/// Default time for which an absent person is waited for, in seconds of world time. The task
/// parameter `patience` overrides it. A larger value saves missions of a nurse called away
/// for longer, but detects a permanent absence later. A guess: two minutes are enough for a call
/// bell.
pub const PERSON_TIMEOUT_S: f64 = 120.0;

/// Task parameter with the time for which an absent person is waited for, in seconds.
pub const PERSON_TIMEOUT_PARAMETER: &str = "patience";

/// Identifies a goal among all goals that a robot ever sends. Later goals have larger numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct GoalId(pub u64);

/// A goal for a robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Goal {
    /// Drive to a pose in a straight line along a leg of a route.
    NavigateToPose {
        /// Target pose.
        pose: Pose,
        /// The place on the map with this pose, if any.
        place: Option<PlaceId>,
    },
    /// Approach a person with this role at the robot's place.
    ApproachPerson {
        /// The person's role in the mission.
        role: RoleId,
    },
    /// Authenticate the approached person.
    AuthenticatePerson {
        /// The person's role in the mission.
        role: RoleId,
    },
    /// Open or close the robot's own drawer.
    OperateDrawer {
        /// Requested state.
        open: bool,
    },
    /// Approach another robot at the same place.
    ApproachRobot {
        /// The other robot.
        robot: RobotId,
    },
    /// Take an object from another robot's open drawer.
    PickUp {
        /// Robot with the drawer.
        from: RobotId,
    },
    /// Take an object from the table of the robot's place.
    Grasp {
        /// Name of the object.
        object: String,
    },
    /// Put the held object into another robot's open drawer or, without a robot, on the table of
    /// the place.
    Deposit {
        /// Robot with the drawer.
        into: Option<RobotId>,
    },
    /// Stand still.
    Wait {
        /// Duration.
        time: Seconds,
    },
    /// Drive to poses in turn, each in a straight line along a leg. The goal ends at the first pose
    /// that cannot be reached.
    FollowWaypoints {
        /// Poses, in order.
        waypoints: Vec<Waypoint>,
    },
    /// Turn on the spot.
    Spin {
        /// Angle in radians, positive to the left.
        angle_rad: f64,
    },
    /// Connect to the charger at the robot's place, and charge from then on.
    Dock {
        /// Place of the charger, if a certain charger is required.
        charger: Option<PlaceId>,
    },
    /// Disconnect from the charger. A robot that drives off disconnects too.
    Undock,
}

/// A pose on the way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Waypoint {
    /// The pose.
    pub pose: Pose,
    /// The place on the map with this pose, if any.
    pub place: Option<PlaceId>,
}

impl Goal {
    /// Checks whether repeating the goal has no further effect: an open drawer is opened, a reached
    /// place is driven to. A goal that transfers an object is done once, and fails the second time.
    pub fn is_repeatable(&self) -> bool {
        match self {
            Goal::NavigateToPose { .. }
            | Goal::ApproachPerson { .. }
            | Goal::AuthenticatePerson { .. }
            | Goal::OperateDrawer { .. }
            | Goal::ApproachRobot { .. }
            | Goal::Wait { .. }
            | Goal::FollowWaypoints { .. }
            | Goal::Dock { .. }
            | Goal::Undock => true,
            // A repeated spin ends at a different heading.
            Goal::Spin { .. } => false,
            Goal::PickUp { .. } | Goal::Grasp { .. } | Goal::Deposit { .. } => false,
        }
    }
}

/// Status of a goal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum GoalStatus {
    /// Sent, without a reply from the backend.
    Sent,
    /// Accepted and active.
    Executing(Feedback),
    /// Completed successfully.
    Succeeded,
    /// Ended by a cancel request. The robot stands still.
    Canceled,
    /// Rejected, or ended without success.
    Aborted(ActionError),
}

impl GoalStatus {
    /// Checks whether the goal has ended.
    pub fn is_final(&self) -> bool {
        matches!(self, GoalStatus::Succeeded | GoalStatus::Canceled | GoalStatus::Aborted(_))
    }
}

/// Feedback of an active goal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Feedback {
    /// Remaining distance; zero for a goal without a drive.
    pub distance_remaining: Metres,
    /// Remaining time, as far as the backend can estimate it.
    pub time_remaining: Seconds,
    /// Progress in the goal's own terms, as in Nav2.
    pub progress: GoalProgress,
}

impl Feedback {
    /// Creates the feedback of a goal without terms of its own.
    pub fn remaining(distance_remaining: Metres, time_remaining: Seconds) -> Feedback {
        Feedback { distance_remaining, time_remaining, progress: GoalProgress::Unspecified }
    }
}

/// Progress of an active goal, in the goal's own terms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum GoalProgress {
    /// No progress beyond the remaining distance and time.
    Unspecified,
    /// Index of the current waypoint of [`Goal::FollowWaypoints`], from 0 (`current_waypoint`).
    Waypoint(u32),
    /// Angle of [`Goal::Spin`] turned so far, in radians, positive to the left
    /// (`angular_distance_traveled`).
    Turned(f64),
    /// Time that [`Goal::Dock`] or [`Goal::Undock`] has taken so far (`docking_time`).
    Docking(Seconds),
}

/// A goal failed. The robot stands still where it is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{code}: {message}")]
pub struct ActionError {
    /// Code, for programs.
    pub code: ErrorCode,
    /// Message, for people. It names the objects involved.
    pub message: String,
}

/// Kinds of failure that skills may treat differently.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorCode {
    /// The robot, person or place is unknown here.
    Unknown,
    /// There is no route.
    NoRoute,
    /// There is a route, but an obstacle blocks it: [`Telemetry::closed`] contains the lane.
    Blocked,
    /// The other robot, person or object is not close enough.
    OutOfReach,
    /// The person is not the required person, or declined.
    NotAuthenticated,
    /// The drawer is in the wrong state: closed, open, full or empty.
    DrawerState,
    /// The object exceeds the payload of the arm.
    TooHeavy,
    /// The battery is too low to move.
    BatteryLow,
    /// The robot executes another goal.
    Busy,
    /// The goal exceeded its time limit.
    TimedOut,
    /// The place is not a charger, or the charger does not work.
    Charger,
}

impl std::fmt::Display for ErrorCode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            ErrorCode::Unknown => "unknown",
            ErrorCode::NoRoute => "no route",
            ErrorCode::Blocked => "blocked",
            ErrorCode::OutOfReach => "out of reach",
            ErrorCode::NotAuthenticated => "not authenticated",
            ErrorCode::DrawerState => "drawer state",
            ErrorCode::TooHeavy => "too heavy",
            ErrorCode::BatteryLow => "battery low",
            ErrorCode::Busy => "busy",
            ErrorCode::TimedOut => "timed out",
            ErrorCode::Charger => "charger",
        })
    }
}

impl Goal {
    /// Returns the `error_code` for this error in the results of `nav2_msgs` (of ROS 2 Jazzy);
    /// `None` for goals that Nav2 does not have.
    pub fn nav2_code(&self, error: ErrorCode) -> Option<u16> {
        Some(match (self, error) {
            // Error codes of the planner and the controller pass through the navigator.
            (Goal::NavigateToPose { .. }, ErrorCode::NoRoute) => 208, // ComputePathToPose: NO_VALID_PATH
            (Goal::NavigateToPose { .. }, ErrorCode::Blocked) => 105, // FollowPath: FAILED_TO_MAKE_PROGRESS
            (Goal::NavigateToPose { .. }, ErrorCode::TimedOut) => 9003, // TIMEOUT
            (Goal::NavigateToPose { .. }, _) => 9000,                 // UNKNOWN
            (Goal::FollowWaypoints { .. }, ErrorCode::NoRoute | ErrorCode::Blocked) => 601, // TASK_EXECUTOR_FAILED
            (Goal::FollowWaypoints { .. }, _) => 600,                 // UNKNOWN
            (Goal::Spin { .. }, ErrorCode::TimedOut) => 701,          // TIMEOUT
            (Goal::Spin { .. }, ErrorCode::Blocked) => 703,           // COLLISION_AHEAD
            (Goal::Spin { .. } | Goal::Wait { .. }, _) => 700,        // UNKNOWN
            (Goal::Dock { .. }, ErrorCode::Unknown) => 901,           // DOCK_NOT_IN_DB
            (Goal::Dock { .. } | Goal::Undock, ErrorCode::Charger) => 902, // DOCK_NOT_VALID
            (Goal::Dock { .. }, ErrorCode::OutOfReach) => 903,        // FAILED_TO_STAGE
            (Goal::Dock { .. } | Goal::Undock, ErrorCode::Blocked) => 905, // FAILED_TO_CONTROL
            (Goal::Dock { .. } | Goal::Undock, _) => 999,             // UNKNOWN
            (
                Goal::ApproachPerson { .. }
                | Goal::AuthenticatePerson { .. }
                | Goal::OperateDrawer { .. }
                | Goal::ApproachRobot { .. }
                | Goal::PickUp { .. }
                | Goal::Grasp { .. }
                | Goal::Deposit { .. },
                _,
            ) => return None,
        })
    }
}

/// State report of a robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Telemetry {
    /// Time, on the world's clock.
    pub time: WorldTime,
    /// Pose.
    pub pose: Pose,
    /// Current place, or the last place passed.
    pub place: PlaceId,
    /// State of charge.
    pub battery: BatteryShare,
    /// False once the battery has fallen below the stopping share and the robot can no longer move.
    pub able: bool,
    /// Lanes that the robot has found closed, or that were reported to it as closed: each once, by
    /// its two ends. The list is incomplete, and old entries expire, since a lane may be open
    /// again.
    pub closed: Vec<(PlaceId, PlaceId)>,
}

/// The actions of a robot, as its skills use them. Calls never block: results appear in
/// [`status`](RobotActions::status) later.
pub trait RobotActions {
    /// Sends a goal.
    fn send_goal(&mut self, goal: Goal) -> GoalId;

    /// Returns the status of a goal; `None` for a goal that was never sent, or ended long ago.
    fn status(&self, goal: GoalId) -> Option<GoalStatus>;

    /// Requests the cancelation of a goal. Its status becomes [`GoalStatus::Canceled`] when the
    /// robot stands still.
    fn cancel(&mut self, goal: GoalId);

    /// Returns the latest report of the robot; `None` before the first.
    fn telemetry(&self) -> Option<&Telemetry>;

    /// Consumes a completion of this goal by an earlier attempt at the same task: an attempt that
    /// was interrupted, or ended by a crash of the robot program without receiving the result.
    /// Returns true once for each completion, otherwise false. Called for goals that are not
    /// [repeatable](Goal::is_repeatable). An implementation without memory returns false.
    fn take_completed(&mut self, goal: &Goal) -> bool {
        let _ = goal;
        false
    }
}

/// A task for a person with an unmanaged role, requested by the messages of the mission's plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PersonRequest {
    /// The person's role in the mission.
    pub role: RoleId,
    /// The task, as in the mission.
    pub task: TaskSpec,
    /// Holders of the managed roles.
    pub holders: std::collections::BTreeMap<RoleId, RobotId>,
}

/// An event of a robot or a person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum BackendEvent {
    /// A robot's goal ended; the status is final.
    GoalEnded {
        /// Robot.
        robot: RobotId,
        /// Goal.
        goal: GoalId,
        /// Final status.
        status: GoalStatus,
    },
    /// A robot's battery fell below the share it needs to move. The robot stands where it is.
    Stranded {
        /// Robot.
        robot: RobotId,
    },
    /// A person cancels the mission for which a robot came.
    MissionCanceled {
        /// Name of the person.
        by: String,
        /// Role of the person.
        role: RoleId,
        /// The robot that came.
        robot: RobotId,
    },
    /// A person request ended.
    PersonRequestEnded {
        /// Id of the request.
        request: GoalId,
        /// `Err` if the person declined or could not do the task.
        result: Result<(), ActionError>,
    },
}

/// Backend of robots: a simulated world, or an adapter to real robots. Time only moves in
/// [`advance`](RobotBackend::advance).
pub trait RobotBackend: Send + Sync {
    /// The robots of this backend.
    fn robots(&self) -> Vec<RobotId>;

    /// Checks whether this backend serves person requests and world reports. In a fleet this is a
    /// single backend; an adapter to a single robot does not.
    fn serves_people(&self) -> bool {
        true
    }

    /// Starts a goal. A rejection, too, is reported as [`BackendEvent::GoalEnded`] by the next
    /// `advance`. A goal that arrives while another is active is rejected with [`ErrorCode::Busy`].
    /// A repeated id changes nothing.
    fn start(&mut self, robot: &RobotId, id: GoalId, goal: Goal);

    /// Cancels a goal. Without effect if it is not active.
    fn cancel(&mut self, robot: &RobotId, id: GoalId);

    /// Requests a task of a person. The result is reported as [`BackendEvent::PersonRequestEnded`],
    /// possibly much later: the person waits for a robot nearby with an open drawer. A repeated id
    /// changes nothing.
    fn request_person(&mut self, id: GoalId, request: PersonRequest);

    /// Cancels a person request. If the request arrives after its cancelation, it is not served.
    fn cancel_person_request(&mut self, id: GoalId);

    /// The world's clock.
    fn now(&self) -> WorldTime;

    /// Time of the next event without further input; `None` while nothing is active. Never earlier
    /// than `now`.
    fn next_due(&self) -> Option<WorldTime>;

    /// Advances time up to and including `to`, and returns the events in order.
    fn advance(&mut self, to: WorldTime) -> Vec<BackendEvent>;

    /// Status of a goal that is active (`Executing` with current feedback) or ended lately; `None`
    /// if unknown.
    fn status(&self, robot: &RobotId, id: GoalId) -> Option<GoalStatus>;

    /// Goals of a robot that are active or ended lately, in the order of their ids. Used by a
    /// driver server that restarts while robots are active.
    fn goals(&self, robot: &RobotId) -> Vec<GoalId>;

    /// The content of a robot's goal that is active or ended lately; `None` if unknown.
    fn goal(&self, robot: &RobotId, id: GoalId) -> Option<Goal>;

    /// Open person requests, in the order of their arrival. Used by a driver server that restarts
    /// while requests are open.
    fn open_person_requests(&self) -> Vec<GoalId>;

    /// Result of a person request; `None` if it is open, was canceled, or ended long ago.
    fn person_result(&self, id: GoalId) -> Option<Result<(), ActionError>>;

    /// Checks whether a person request was canceled lately, before it ended.
    fn was_person_request_canceled(&self, id: GoalId) -> bool;

    /// Report of a robot as of `now`; `None` for an unknown robot.
    fn telemetry(&self, robot: &RobotId) -> Option<Telemetry>;

    /// State of the world beyond the robots (objects, people), as JSON for displays. No decision
    /// depends on it.
    fn report(&self) -> serde_json::Value {
        serde_json::Value::Null
    }
}
