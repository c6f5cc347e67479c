//! Error codes of Nav2.

use super::error::ErrorCode;
use super::goal::Goal;

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
                | Goal::Deposit { .. }
                | Goal::Declared(_),
                _,
            ) => return None,
        })
    }
}
