//! `nav2_msgs/action/NavigateToPose` as ROS 2 Jazzy and Kilted have it, with the messages it is made of.
//!
//! The definition is Nav2's `nav2_msgs/action/NavigateToPose.action`:
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
//! Fields stand in the order of the definition: CDR writes them so. A type's hash (RIHS01, REP-2016) is part of every key, so
//! that a ROS 2 system with another definition neither sees nor misreads ours; `tests/type_hashes.rs` works them out again.

use hiroz::action::ZAction;
use hiroz::entity::{TypeHash, TypeInfo};
use hiroz::msg::{SerdeCdrSerdes, ZMessage};
use serde::{Deserialize, Serialize};

/// The action, as hiroz knows actions.
#[derive(Debug, Clone, Copy)]
pub struct NavigateToPose;

/// `builtin_interfaces/Time`: since 1970, or since whatever the ROS clock counts from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Time {
    /// Whole seconds.
    pub sec: i32,
    /// Nanoseconds beyond them.
    pub nanosec: u32,
}

/// `builtin_interfaces/Duration`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Duration {
    /// Whole seconds.
    pub sec: i32,
    /// Nanoseconds beyond them.
    pub nanosec: u32,
}

/// `std_msgs/Header`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// When what follows was so.
    pub stamp: Time,
    /// In which frame of coordinates.
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
    /// The part along x.
    pub x: f64,
    /// The part along y.
    pub y: f64,
    /// The part along z.
    pub z: f64,
    /// The real part.
    pub w: f64,
}

impl Default for Quaternion {
    /// No rotation, as `geometry_msgs` has it.
    fn default() -> Self {
        Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

/// `geometry_msgs/Pose`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Where.
    pub position: Point,
    /// Turned how.
    pub orientation: Quaternion,
}

/// `geometry_msgs/PoseStamped`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseStamped {
    /// When, and in which frame.
    pub header: Header,
    /// The pose.
    pub pose: Pose,
}

/// What a robot is asked to do.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Goal {
    /// Where to.
    pub pose: PoseStamped,
    /// The file of a behavior tree; empty for the server's own.
    pub behavior_tree: String,
}

/// What came of it.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Outcome {
    /// 0 when all is well; else the code of the first server under the navigator that failed.
    pub error_code: u16,
    /// The error in words; empty when all is well.
    pub error_msg: String,
}

/// How it goes.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Where the robot is.
    pub current_pose: PoseStamped,
    /// Since the goal was accepted.
    pub navigation_time: Duration,
    /// As far as the robot can tell.
    pub estimated_time_remaining: Duration,
    /// How often it had to begin anew.
    pub number_of_recoveries: i16,
    /// Way left, in metres.
    pub distance_remaining: f32,
}

impl ZMessage for Goal {
    type Serdes = SerdeCdrSerdes<Goal>;
}

impl ZMessage for Outcome {
    type Serdes = SerdeCdrSerdes<Outcome>;
}

impl ZMessage for Progress {
    type Serdes = SerdeCdrSerdes<Progress>;
}

fn typed(name: &str, hash: &str) -> TypeInfo {
    TypeInfo::new(name, TypeHash::from_rihs_string(hash).expect("a hash of 64 digits"))
}

impl ZAction for NavigateToPose {
    type Goal = Goal;
    type Result = Outcome;
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
