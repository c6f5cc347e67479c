//! The robot-actions interface: how skills move a body, and how a body is hosted.
//!
//! The vocabulary is Nav2's: a *goal* is sent, answered with *feedback* while it is executed, and ends with a *result*:
//! succeeded, canceled or aborted with an error code. Behind it is a simulated world (in this process or another) or a
//! real robot's adapter; skills cannot tell which.
//!
//! ```text
//!  skill (behavior tree) ── RobotActions ──▶ goals   ┌────────────┐
//!                        ◀── status, telemetry ──────│  BodyHost  │  a world, or an adapter
//! ```

use consort_protocol::ids::{PlaceId, RobotId, RoleId};
use consort_protocol::mission::TaskSpec;
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, Metres, Seconds, WorldTime};
use serde::{Deserialize, Serialize};

/// How long a person who has left is waited for, in seconds of world time, unless the task says otherwise (parameter
/// `patience`). Raised: a nurse who is called away for longer costs no mission, and one who does not come back is known for
/// gone later. A guess: two minutes see to a call bell.
pub const PERSON_TIMEOUT_S: f64 = 120.0;

/// The parameter of a task that says how long a person is waited for, in seconds.
pub const PERSON_TIMEOUT_PARAMETER: &str = "patience";

/// Names one goal among all that a robot ever sends; later goals have larger numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct GoalId(pub u64);

/// What a body is asked to do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Goal {
    /// Drive to a pose in a straight line along one leg of a route.
    NavigateToPose {
        /// Where to.
        pose: Pose,
        /// The place on the map that the pose stands for, if it is one.
        place: Option<PlaceId>,
    },
    /// Come within reach of a person who plays `role` and is at the robot's place.
    ApproachPerson {
        /// The person's role in the mission.
        role: RoleId,
    },
    /// Have the approached person prove who they are.
    AuthenticatePerson {
        /// The person's role in the mission.
        role: RoleId,
    },
    /// Open or close the robot's own drawer.
    OperateDrawer {
        /// Whether it is to stand open afterwards.
        open: bool,
    },
    /// Come within reach of another robot at the robot's place.
    ApproachRobot {
        /// Which one.
        robot: RobotId,
    },
    /// Take what lies in another robot's open drawer.
    PickUp {
        /// Whose drawer.
        from: RobotId,
    },
    /// Take a thing that lies on the table of the robot's place.
    Grasp {
        /// Which thing.
        object: String,
    },
    /// Put what is held into another robot's open drawer or, without one, onto the place's table.
    Deposit {
        /// Whose drawer, if one.
        into: Option<RobotId>,
    },
    /// Stand still.
    Wait {
        /// For how long.
        time: Seconds,
    },
    /// Drive to poses one after the other, each in a straight line along one leg; all of them, or none of those after the
    /// first that cannot be reached.
    FollowWaypoints {
        /// Where to, in this order.
        waypoints: Vec<Waypoint>,
    },
    /// Turn on the spot.
    Spin {
        /// By how much, in radians; to the left if it is positive.
        angle_rad: f64,
    },
    /// Connect to the charger at the robot's place, and charge from then on.
    Dock {
        /// The place of the charger, if it must be this one.
        charger: Option<PlaceId>,
    },
    /// Disconnect from the charger. A robot that drives off disconnects too.
    Undock,
}

/// Somewhere on the way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Waypoint {
    /// Where it is.
    pub pose: Pose,
    /// The place on the map that the pose stands for, if it is one.
    pub place: Option<PlaceId>,
}

impl Goal {
    /// Whether it leaves the world as it is when it is done once more: a drawer that is open is opened, a place that was
    /// reached is driven to. What moves a thing from hand to hand is done once, and fails the second time.
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
            // Turned once more it faces elsewhere.
            Goal::Spin { .. } => false,
            Goal::PickUp { .. } | Goal::Grasp { .. } | Goal::Deposit { .. } => false,
        }
    }
}

/// How far a goal has come.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum GoalStatus {
    /// Sent; the host has not answered yet.
    Sent,
    /// Accepted and under way.
    Executing(Feedback),
    /// Ended as asked.
    Succeeded,
    /// Ended because it was canceled; the body stands still.
    Canceled,
    /// Refused, or ended without success.
    Aborted(ActionError),
}

impl GoalStatus {
    /// Whether nothing more will come of it.
    pub fn is_final(&self) -> bool {
        matches!(self, GoalStatus::Succeeded | GoalStatus::Canceled | GoalStatus::Aborted(_))
    }
}

/// What is known of a goal under way.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Feedback {
    /// Way left; zero where nothing is driven.
    pub distance_remaining: Metres,
    /// Time left as far as the host can tell.
    pub time_remaining: Seconds,
    /// How far it is in terms of its own, as Nav2 tells it.
    pub progress: GoalProgress,
}

impl Feedback {
    /// Of a goal that has no terms of its own.
    pub fn remaining(distance_remaining: Metres, time_remaining: Seconds) -> Feedback {
        Feedback { distance_remaining, time_remaining, progress: GoalProgress::Unspecified }
    }
}

/// How far a goal under way has come, in terms of its own.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum GoalProgress {
    /// What is left says all.
    Unspecified,
    /// Of [`Goal::FollowWaypoints`]: the place in the list of the one it is on its way to, from 0 (`current_waypoint`).
    Waypoint(u32),
    /// Of [`Goal::Spin`]: the angle turned so far, in radians, to the left if it is positive (`angular_distance_traveled`).
    Turned(f64),
    /// Of [`Goal::Dock`] and [`Goal::Undock`]: the time taken so far (`docking_time`).
    Docking(Seconds),
}

/// Why a goal did not succeed. The body stands still where it is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{code}: {message}")]
pub struct ActionError {
    /// For programs.
    pub code: ErrorCode,
    /// For people: names who and which.
    pub message: String,
}

/// The kinds of failure that skills may treat differently.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorCode {
    /// No such robot, person or place here.
    Unknown,
    /// There is no way.
    NoRoute,
    /// There is a way, and something stands in it: [`Telemetry::closed`] says between which places.
    Blocked,
    /// Not close enough to who or what is needed.
    OutOfReach,
    /// The person is not who they should be, or declined.
    NotAuthenticated,
    /// The drawer is closed, open, full or empty where it must not be.
    DrawerState,
    /// It weighs more than the arm can lift.
    TooHeavy,
    /// The battery is too low to move.
    BatteryLow,
    /// The robot is doing something else.
    Busy,
    /// Not done within the time allowed.
    TimedOut,
    /// The charger is not one, or gives nothing.
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
    /// The code by which `nav2_msgs` (of ROS 2 Jazzy) knows an error of such a goal, `error_code` in the action's result;
    /// `None` for goals that Nav2 does not have.
    pub fn nav2_code(&self, error: ErrorCode) -> Option<u16> {
        Some(match (self, error) {
            // What the planner and the controller under the navigator say shows through.
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

/// What a body reports of itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Telemetry {
    /// When, on the world's clock.
    pub time: WorldTime,
    /// Where.
    pub pose: Pose,
    /// The place it stands at, or the last one it passed when under way.
    pub place: PlaceId,
    /// Charge left.
    pub battery: BatteryShare,
    /// Whether it can still move: false once its battery fell below the stopping share.
    pub able: bool,
    /// Ways between neighbouring places that the body has found closed, or was told are: each once, by its two ends. What
    /// it has not met it does not know, and what it met long ago it has forgotten: the way may be open again.
    pub closed: Vec<(PlaceId, PlaceId)>,
}

/// A body as its robot's skills drive it. Calls never wait: answers show in [`status`](RobotActions::status) later.
pub trait RobotActions {
    /// Sends a goal.
    fn send_goal(&mut self, goal: Goal) -> GoalId;

    /// How far a goal has come; `None` for one never sent, or which ended long ago.
    fn status(&self, goal: GoalId) -> Option<GoalStatus>;

    /// Asks to end a goal early. Its status becomes [`GoalStatus::Canceled`] when the body stands still.
    fn cancel(&mut self, goal: GoalId);

    /// The latest report of the body; `None` before the first.
    fn telemetry(&self) -> Option<&Telemetry>;

    /// Whether an earlier attempt at the same task has brought this goal to its end: one that was broken off before it was
    /// over, or whose robot crashed and never learned what its body went on to do. True once for each time that the goal was
    /// done. Asked of goals that are not [repeatable](Goal::is_repeatable). A body that remembers nothing says no.
    fn take_completed(&mut self, goal: &Goal) -> bool {
        let _ = goal;
        false
    }
}

/// What a person who plays an unmanaged role is asked to do, by the messages of the mission's plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PersonRequest {
    /// The person's role in the mission.
    pub role: RoleId,
    /// The task, as the mission has it.
    pub task: TaskSpec,
    /// Who holds the managed roles.
    pub holders: std::collections::BTreeMap<RoleId, RobotId>,
}

/// Something that happened to a body or a person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum BackendEvent {
    /// A robot's goal ended; the status is final.
    GoalEnded {
        /// Whose.
        robot: RobotId,
        /// Which.
        goal: GoalId,
        /// How.
        status: GoalStatus,
    },
    /// A robot's battery fell below the share it needs to move: it stands where it is.
    Stranded {
        /// Which robot.
        robot: RobotId,
    },
    /// A person calls off the mission for which a robot came to them.
    MissionCanceled {
        /// Who says so.
        by: String,
        /// The role they play.
        role: RoleId,
        /// The robot that came.
        robot: RobotId,
    },
    /// A person ended what they were asked to do.
    PersonRequestEnded {
        /// The number the ask was given.
        ask: GoalId,
        /// `Err` when they declined or could not.
        result: Result<(), ActionError>,
    },
}

/// What hosts bodies: a simulated world, or an adapter to real ones. Time only moves in [`advance`](BodyHost::advance).
pub trait RobotBackend: Send + Sync {
    /// The robots whose bodies are here.
    fn robots(&self) -> Vec<RobotId>;

    /// Whether people are asked, and the world is looked at, here. Of all hosts of a fleet one does that; an adapter to a
    /// single robot does not.
    fn serves_people(&self) -> bool {
        true
    }

    /// Begins a goal. A refusal, too, comes as [`BodyEvent::GoalEnded`] from the next `advance`. A goal sent while
    /// another is under way is refused with [`ErrorCode::Busy`]; a repeated id changes nothing.
    fn start(&mut self, robot: &RobotId, id: GoalId, goal: Goal);

    /// Ends a goal early; one that is not under way is left as it is.
    fn cancel(&mut self, robot: &RobotId, id: GoalId);

    /// Asks a person; the answer comes as [`BodyEvent::PersonEnded`]. They take their time: what they wait for (a robot
    /// beside them with an open drawer) may come much later. A repeated id changes nothing.
    fn request_person(&mut self, id: GoalId, ask: PersonRequest);

    /// Withdraws an ask. One that was never heard of is not served either when it comes late.
    fn cancel_person_request(&mut self, id: GoalId);

    /// The world's clock.
    fn now(&self) -> WorldTime;

    /// When something will next happen by itself; `None` while nothing is under way. Never earlier than `now`.
    fn next_due(&self) -> Option<WorldTime>;

    /// Lets time pass up to and including `to` and says what happened, in order.
    fn advance(&mut self, to: WorldTime) -> Vec<BackendEvent>;

    /// The state of one goal under way (`Executing` with fresh feedback) or lately ended; `None` if unknown.
    fn status(&self, robot: &RobotId, id: GoalId) -> Option<GoalStatus>;

    /// The goals of a robot that are under way or lately ended, in the order of their ids: for a host that is started anew
    /// while bodies are at work.
    fn goals(&self, robot: &RobotId) -> Vec<GoalId>;

    /// What a goal of a robot, under way or lately ended, asks for; `None` if unknown.
    fn goal(&self, robot: &RobotId, id: GoalId) -> Option<Goal>;

    /// The asks that have not ended, in the order in which they were made: for a host that is started anew while people are
    /// asked.
    fn open_person_requests(&self) -> Vec<GoalId>;

    /// What came of an ask; `None` for one that has not ended, was withdrawn, or ended long ago.
    fn person_result(&self, id: GoalId) -> Option<Result<(), ActionError>>;

    /// Whether an ask was withdrawn lately, before it ended.
    fn was_person_request_canceled(&self, id: GoalId) -> bool;

    /// The body's report as of `now`; `None` for a robot that is not here.
    fn telemetry(&self, robot: &RobotId) -> Option<Telemetry>;

    /// What there is to see beside the bodies (things, people), in JSON, for onlookers; nothing is decided by it.
    fn report(&self) -> serde_json::Value {
        serde_json::Value::Null
    }
}
