//! Conversion between the types of this project and `nav2_msgs`: poses, times, errors, names. Pure
//! functions.

use crate::messages::{Duration, Header, NavigateResult, Point, Pose as RosPose, PoseStamped, Quaternion, Time};
use consort_protocol::ids::RobotId;
use consort_protocol::pose::Pose;
use consort_skills::actions::{ActionError, ErrorCode, Goal, NavigateToPose};

/// Coordinate frame of Nav2's maps, and of the fleet's map.
pub const FRAME: &str = "map";

/// The `error_code` of `NavigateToPose` for an unknown error.
pub const UNKNOWN_ERROR: u16 = 9000;

/// A ROS pose cannot be converted. Nothing was sent to the robot.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PoseError {
    /// The pose is in another frame, and this program has no transforms.
    #[error("the pose is in the frame {0:?}; allowed: {FRAME:?}")]
    Frame(String),
    /// A number is not finite, or the orientation is not a rotation.
    #[error("the pose contains a number that is not finite, or the orientation is not a rotation")]
    Numbers,
}

impl PoseError {
    /// Returns the `error_code` of `NavigateToPose`.
    pub fn code(&self) -> u16 {
        match self {
            PoseError::Frame(_) => 9002, // TF_ERROR
            PoseError::Numbers => UNKNOWN_ERROR,
        }
    }
}

/// Converts a pose to ROS.
pub fn to_ros(pose: Pose, stamp: Time) -> PoseStamped {
    let (z, w) = (pose.yaw / 2.0).sin_cos();
    PoseStamped {
        header: Header { stamp, frame_id: FRAME.to_owned() },
        pose: RosPose {
            position: Point { x: pose.x, y: pose.y, z: 0.0 },
            orientation: Quaternion { x: 0.0, y: 0.0, z, w },
        },
    }
}

/// Converts a ROS pose to a pose on the map: height, roll and pitch are ignored.
///
/// # Errors
/// [`PoseError`] if the pose cannot be converted.
pub fn from_ros(stamped: &PoseStamped) -> Result<Pose, PoseError> {
    let frame = &stamped.header.frame_id;
    if !frame.is_empty() && frame != FRAME {
        return Err(PoseError::Frame(frame.clone()));
    }
    let RosPose { position, orientation: Quaternion { x, y, z, w } } = stamped.pose;
    let length = x * x + y * y + z * z + w * w;
    // At least half a unit of length: a quaternion this far from a rotation is not a rotation.
    if ![position.x, position.y, length].iter().all(|number| number.is_finite()) || length < 0.5 {
        return Err(PoseError::Numbers);
    }
    let yaw = (2.0 * (w * z + x * y)).atan2(w * w + x * x - y * y - z * z);
    Ok(Pose::new(position.x, position.y, yaw))
}

/// Converts seconds to a ROS duration. Invalid values become 0, too great values the maximum.
pub fn duration(seconds: f64) -> Duration {
    let whole = seconds.clamp(0.0, f64::from(i32::MAX)).floor();
    let sec = whole as i32; // NaN is 0
    let nanoseconds = ((seconds - f64::from(sec)) * 1e9).clamp(0.0, 999_999_999.0);
    Duration { sec, nanosec: nanoseconds as u32 }
}

/// Converts a time since 1970 to ROS.
pub fn time(since_1970: std::time::Duration) -> Time {
    let sec = i32::try_from(since_1970.as_secs()).unwrap_or(i32::MAX);
    Time { sec, nanosec: since_1970.subsec_nanos() }
}

/// Returns the time of this machine.
pub fn now() -> Time {
    time(std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default())
}

/// Returns the time of this machine as seconds since 1970 and nanoseconds.
pub fn seconds_now() -> (i64, u32) {
    let now = now();
    (i64::from(now.sec), now.nanosec)
}

/// Converts the error of a failed drive to a Nav2 result.
pub fn to_nav2_result(error: &ActionError) -> NavigateResult {
    let drive = Goal::from(NavigateToPose::to(Pose::default(), None));
    let error_code = drive.nav2_code(error.code).expect("Nav2 has this goal");
    NavigateResult { error_code, error_msg: error.to_string() }
}

/// Converts the Nav2 result of a failed drive to an error, by the codes of ROS 2 Jazzy: 1xx belong
/// to `FollowPath`, 2xx to `ComputePathToPose`, 90xx to `NavigateToPose`.
pub fn error(outcome: &NavigateResult) -> ActionError {
    let code = match outcome.error_code {
        // PATIENCE_EXCEEDED, FAILED_TO_MAKE_PROGRESS, NO_VALID_CONTROL; GOAL_OCCUPIED
        104..=106 | 206 => ErrorCode::Blocked,
        // CONTROLLER_TIMED_OUT; TIMEOUT of the planner and of the navigator
        107 | 207 | 9003 => ErrorCode::TimedOut,
        // START_OUTSIDE_MAP, GOAL_OUTSIDE_MAP; NO_VALID_PATH
        203 | 204 | 208 => ErrorCode::NoRoute,
        _ => ErrorCode::Unknown,
    };
    let message = if outcome.error_msg.is_empty() { "without a message" } else { outcome.error_msg.as_str() };
    ActionError::new(code, format!("Nav2 error {}: {message}", outcome.error_code))
}

/// Converts a robot's name to a part of a ROS name: letters, digits and `_`, with no digit at the
/// beginning.
pub fn ros_name(robot: &RobotId) -> String {
    let letters = robot.as_str().chars().map(|letter| if letter.is_ascii_alphanumeric() { letter } else { '_' });
    let name: String = letters.collect();
    if name.starts_with(|first: char| first.is_ascii_digit()) { format!("robot_{name}") } else { name }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    #[test]
    fn a_pose_survives_the_round_trip() {
        for yaw in [0.0, 1.0, FRAC_PI_2, -FRAC_PI_2, 3.1, -3.1] {
            let pose = Pose::new(1.5, -2.25, yaw);
            let back = from_ros(&to_ros(pose, Time::default())).unwrap();
            assert!(back.distance(pose).get() == 0.0 && (back.yaw - yaw).abs() < 1e-12, "{yaw}: {back:?}");
        }
    }

    #[test]
    fn a_quarter_turn_to_the_left_gives_the_quaternion_of_ros() {
        let orientation = to_ros(Pose::new(0.0, 0.0, FRAC_PI_2), Time::default()).pose.orientation;
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!((orientation.z - half).abs() < 1e-15 && (orientation.w - half).abs() < 1e-15, "{orientation:?}");
        let turned = |z, w| {
            let mut stamped = to_ros(Pose::default(), Time::default());
            stamped.pose.orientation = Quaternion { x: 0.0, y: 0.0, z, w };
            from_ros(&stamped).unwrap().yaw
        };
        assert!((turned(1.0, 0.0).abs() - PI).abs() < 1e-12);
        assert!((turned(2.0, 2.0) - FRAC_PI_2).abs() < 1e-12, "its length does not matter");
    }

    #[test]
    fn a_rolled_pose_keeps_its_heading() {
        let mut stamped = to_ros(Pose::default(), Time::default());
        // Rolled by 0.2 about its own axis, after a rotation of 1.0 to the left.
        let ((sz, cz), (sx, cx)) = (0.5_f64.sin_cos(), 0.1_f64.sin_cos());
        stamped.pose.orientation = Quaternion { x: cz * sx, y: sz * sx, z: sz * cx, w: cz * cx };
        assert!((from_ros(&stamped).unwrap().yaw - 1.0).abs() < 1e-12);
    }

    #[test]
    fn invalid_poses_are_rejected_with_a_code() {
        let stamped = to_ros(Pose::default(), Time::default());
        let elsewhere =
            PoseStamped { header: Header { frame_id: "odom".to_owned(), ..stamped.header.clone() }, ..stamped.clone() };
        let problem = from_ros(&elsewhere).unwrap_err();
        assert_eq!(
            (problem.code(), problem.to_string().as_str()),
            (9002, "the pose is in the frame \"odom\"; allowed: \"map\"")
        );
        let unset = PoseStamped { header: Header::default(), ..stamped.clone() };
        assert_eq!(from_ros(&unset), Ok(Pose::default()), "an empty frame counts as the map frame");
        for (x, w) in [(f64::NAN, 1.0), (f64::INFINITY, 1.0), (0.0, 0.0), (0.0, f64::NAN)] {
            let mut broken = stamped.clone();
            (broken.pose.position.x, broken.pose.orientation.w) = (x, w);
            assert_eq!(from_ros(&broken).unwrap_err().code(), 9000, "x {x}, w {w}");
        }
    }

    #[test]
    fn durations_are_split_into_seconds_and_nanoseconds() {
        assert_eq!(duration(2.5), Duration { sec: 2, nanosec: 500_000_000 });
        assert_eq!(duration(0.0), Duration::default());
        for none in [-1.0, f64::NAN, f64::NEG_INFINITY] {
            assert_eq!(duration(none), Duration::default(), "{none}");
        }
        assert_eq!(duration(f64::INFINITY).sec, i32::MAX);
        assert_eq!(time(std::time::Duration::from_millis(1_500)), Time { sec: 1, nanosec: 500_000_000 });
    }

    #[test]
    fn errors_keep_their_kind_over_the_codes_of_nav2() {
        let of = |code| to_nav2_result(&ActionError::new(code, "why".to_owned()));
        let cases = [
            (ErrorCode::NoRoute, 208, ErrorCode::NoRoute),
            (ErrorCode::Blocked, 105, ErrorCode::Blocked),
            (ErrorCode::TimedOut, 9003, ErrorCode::TimedOut),
            (ErrorCode::BatteryLow, 9000, ErrorCode::Unknown), // Nav2 has no code for it
        ];
        for (ours, theirs, back) in cases {
            let outcome = of(ours);
            assert_eq!((outcome.error_code, error(&outcome).code), (theirs, back), "{ours}");
        }
        assert_eq!(of(ErrorCode::NoRoute).error_msg, "no route: why");
        let silent = NavigateResult { error_code: 205, error_msg: String::new() };
        assert_eq!(error(&silent).to_string(), "unknown: Nav2 error 205: without a message");
    }

    #[test]
    fn names_are_converted_to_ros_names() {
        let name = |text: &str| ros_name(&RobotId::new(text).unwrap());
        assert_eq!([name("ada"), name("lab-arm.2"), name("7of9")], ["ada", "lab_arm_2", "robot_7of9"]);
    }
}
