//! Goals of robots, their status and feedback.

use super::error::ActionError;
use consort_protocol::ids::{PlaceId, RobotId, RoleId};
use consort_protocol::pose::Pose;
use consort_protocol::units::{Metres, Seconds};
use serde::{Deserialize, Serialize};

/// Default time for which an absent person is waited for, in seconds of world time. The task
/// parameter `timeout_s` overrides it. A larger value saves missions of a nurse called away
/// for longer, but detects a permanent absence later. A guess: two minutes are enough for a call
/// bell.
pub const PERSON_TIMEOUT_S: f64 = 120.0;

/// Task parameter with the time for which an absent person is waited for, in seconds.
pub const PERSON_TIMEOUT_PARAMETER: &str = "timeout_s";

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
