//! The actions that Nav2 has: their parameters, and its error codes.

use super::error::ErrorCode;
use super::goal::{ActionParameters, Goal};
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_protocol::units::{MetresPerSecond, Seconds};
use serde::{Deserialize, Serialize};

/// Drive to a pose in a straight line along a leg of a route.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NavigateToPose {
    /// Target pose.
    pub pose: Pose,
    /// The place on the map with this pose, if any.
    #[serde(default)]
    pub place: Option<PlaceId>,
    /// The highest allowed speed, if people have limited it.
    #[serde(default)]
    pub speed_max_mps: Option<MetresPerSecond>,
}

impl NavigateToPose {
    /// Returns a drive without a speed limit.
    pub fn to(pose: Pose, place: Option<PlaceId>) -> NavigateToPose {
        NavigateToPose { pose, place, speed_max_mps: None }
    }
}

/// Drive to poses in turn, each in a straight line along a leg. The goal ends at the first pose
/// that cannot be reached.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FollowWaypoints {
    /// Poses, in order.
    pub waypoints: Vec<Waypoint>,
}

/// A pose on the way.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Waypoint {
    /// The pose.
    pub pose: Pose,
    /// The place on the map with this pose, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<PlaceId>,
}

/// Turn on the spot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spin {
    /// Angle in radians, positive to the left.
    pub angle_rad: f64,
}

/// Stand still.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wait {
    /// Duration.
    pub time: Seconds,
}

/// Connect to the charger at the robot's place, and charge from then on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dock {
    /// Place of the charger, if a certain charger is required.
    #[serde(default)]
    pub charger: Option<PlaceId>,
}

/// Disconnect from the charger. A robot that drives off disconnects too.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Undock {}

impl ActionParameters for NavigateToPose {
    const ACTION: &'static str = "navigate_to_pose";
    const REPEATABLE: bool = true;
}

impl ActionParameters for FollowWaypoints {
    const ACTION: &'static str = "follow_waypoints";
    const REPEATABLE: bool = true;
}

impl ActionParameters for Spin {
    const ACTION: &'static str = "spin";
    // A repeated spin ends at a different heading.
    const REPEATABLE: bool = false;
}

impl ActionParameters for Wait {
    const ACTION: &'static str = "wait";
    const REPEATABLE: bool = true;
}

impl ActionParameters for Dock {
    const ACTION: &'static str = "dock";
    const REPEATABLE: bool = true;
}

impl ActionParameters for Undock {
    const ACTION: &'static str = "undock";
    const REPEATABLE: bool = true;
}

impl Goal {
    /// Checks whether the robot leaves its place or turns.
    pub fn moves_robot(&self) -> bool {
        self.is::<NavigateToPose>() || self.is::<FollowWaypoints>() || self.is::<Spin>()
    }

    /// Returns the `error_code` for this error in the results of `nav2_msgs` (of ROS 2 Jazzy);
    /// `None` for goals that Nav2 does not have.
    pub fn nav2_code(&self, error: ErrorCode) -> Option<u16> {
        Some(match (self.action.as_str(), error) {
            // Error codes of the planner and the controller pass through the navigator.
            (NavigateToPose::ACTION, ErrorCode::NoRoute) => 208, // ComputePathToPose: NO_VALID_PATH
            (NavigateToPose::ACTION, ErrorCode::Blocked) => 105, // FollowPath: FAILED_TO_MAKE_PROGRESS
            (NavigateToPose::ACTION, ErrorCode::TimedOut) => 9003, // TIMEOUT
            (NavigateToPose::ACTION, _) => 9000,                 // UNKNOWN
            (FollowWaypoints::ACTION, ErrorCode::NoRoute | ErrorCode::Blocked) => 601, // TASK_EXECUTOR_FAILED
            (FollowWaypoints::ACTION, _) => 600,                 // UNKNOWN
            (Spin::ACTION, ErrorCode::TimedOut) => 701,          // TIMEOUT
            (Spin::ACTION, ErrorCode::Blocked) => 703,           // COLLISION_AHEAD
            (Spin::ACTION | Wait::ACTION, _) => 700,             // UNKNOWN
            (Dock::ACTION, ErrorCode::Unknown) => 901,           // DOCK_NOT_IN_DB
            (Dock::ACTION | Undock::ACTION, ErrorCode::Charger) => 902, // DOCK_NOT_VALID
            (Dock::ACTION, ErrorCode::OutOfReach) => 903,        // FAILED_TO_STAGE
            (Dock::ACTION | Undock::ACTION, ErrorCode::Blocked) => 905, // FAILED_TO_CONTROL
            (Dock::ACTION | Undock::ACTION, _) => 999,           // UNKNOWN
            _ => return None,
        })
    }
}
