//! `nav2_msgs/action/NavigateToPose` of ROS 2 Jazzy and Kilted, with the messages it contains.
//!
//! The definition is `nav2_msgs/action/NavigateToPose.action` of Nav2:
//!
//! ```text
//! geometry_msgs/PoseStamped pose
//! string behavior_tree
//! ---
//! uint16 error_code
//! string error_msg
//! ---
//! geometry_msgs/PoseStamped current_pose
//! builtin_interfaces/Duration navigation_time
//! builtin_interfaces/Duration estimated_time_remaining
//! int16 number_of_recoveries
//! float32 distance_remaining
//! ```
//!
//! The order of the fields is that of the definition, because CDR writes them in this order. The
//! hash of a type (RIHS01, REP-2016) is part of every key: a ROS 2 system with another definition
//! neither finds nor misreads these messages. `tests/type_hashes.rs` computes the hashes again.

use hiroz::action::ZAction;
use hiroz::entity::{TypeHash, TypeInfo};
use hiroz::msg::{SerdeCdrSerdes, ZMessage};
use serde::{Deserialize, Serialize};

/// The action type for hiroz.
#[derive(Debug, Clone, Copy)]
pub struct NavigateToPose;

/// `builtin_interfaces/Time`: since 1970, or since the zero of the ROS clock.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Time {
    /// Whole seconds.
    pub sec: i32,
    /// Additional nanoseconds.
    pub nanosec: u32,
}

/// `builtin_interfaces/Duration`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Duration {
    /// Whole seconds.
    pub sec: i32,
    /// Additional nanoseconds.
    pub nanosec: u32,
}

/// `std_msgs/Header`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Time of the data.
    pub stamp: Time,
    /// Coordinate frame.
    pub frame_id: String,
}

/// `geometry_msgs/Point`, in metres.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// East.
    pub x: f64,
    /// North.
    pub y: f64,
    /// Up.
    pub z: f64,
}

/// `geometry_msgs/Quaternion`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// Component along x.
    pub x: f64,
    /// Component along y.
    pub y: f64,
    /// Component along z.
    pub z: f64,
    /// Real component.
    pub w: f64,
}

impl Default for Quaternion {
    /// No rotation, the default of `geometry_msgs`.
    fn default() -> Self {
        Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

/// `geometry_msgs/Pose`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Position.
    pub position: Point,
    /// Orientation.
    pub orientation: Quaternion,
}

/// `geometry_msgs/PoseStamped`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseStamped {
    /// Time and frame.
    pub header: Header,
    /// The pose.
    pub pose: Pose,
}

/// Goal of the action.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Goal {
    /// Target pose.
    pub pose: PoseStamped,
    /// File of a behavior tree; empty for the server's default.
    pub behavior_tree: String,
}

/// Result of the action.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct NavigateResult {
    /// 0 for success; else the code of the first failed server under the navigator.
    pub error_code: u16,
    /// The error in words; empty for success.
    pub error_msg: String,
}

/// Feedback of the action.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Pose of the robot.
    pub current_pose: PoseStamped,
    /// Time since the acceptance of the goal.
    pub navigation_time: Duration,
    /// Estimate of the robot.
    pub estimated_time_remaining: Duration,
    /// Number of recoveries.
    pub number_of_recoveries: i16,
    /// Remaining distance in metres.
    pub distance_remaining: f32,
}

impl ZMessage for Goal {
    type Serdes = SerdeCdrSerdes<Goal>;
}

impl ZMessage for NavigateResult {
    type Serdes = SerdeCdrSerdes<NavigateResult>;
}

impl ZMessage for Progress {
    type Serdes = SerdeCdrSerdes<Progress>;
}

fn typed(name: &str, hash: &str) -> TypeInfo {
    TypeInfo::new(name, TypeHash::from_rihs_string(hash).expect("a hash of 64 digits"))
}

impl ZAction for NavigateToPose {
    type Goal = Goal;
    type Result = NavigateResult;
    type Feedback = Progress;

    fn name() -> &'static str {
        "nav2_msgs/action/NavigateToPose"
    }

    fn send_goal_type_info() -> TypeInfo {
        typed(
            "nav2_msgs::action::dds_::NavigateToPose_SendGoal_",
            "RIHS01_a4fcb3bee1bf32e21a0e541a943b221aa0826996e2c98f079b47022b256f48b5",
        )
    }

    fn get_result_type_info() -> TypeInfo {
        typed(
            "nav2_msgs::action::dds_::NavigateToPose_GetResult_",
            "RIHS01_c407920357d566771e8882b4ef4d1f1a84ee922d609920ccd57faa6d6e391dc5",
        )
    }

    fn feedback_type_info() -> TypeInfo {
        typed(
            "nav2_msgs::action::dds_::NavigateToPose_FeedbackMessage_",
            "RIHS01_9d1f6fa2eb975ce733b419ac2e97b134d8ff92b6478b6559feed9a50bdfd82b3",
        )
    }

    fn cancel_goal_type_info() -> TypeInfo {
        typed(
            "action_msgs::srv::dds_::CancelGoal_",
            "RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a",
        )
    }

    fn status_type_info() -> TypeInfo {
        typed(
            "action_msgs::msg::dds_::GoalStatusArray_",
            "RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e",
        )
    }
}
