//! Goals of robots, their status and feedback.

use super::error::{ActionError, ErrorCode};
use consort_protocol::ids::{ActionName, PlaceId, RobotId, RoleId};
use consort_protocol::pose::Pose;
use consort_protocol::units::{Metres, Seconds};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de, ser};

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

/// A goal for a robot: an action of its driver, with parameters.
///
/// In JSON it is `{"action": "wait", "parameters": {"time": 5.0}}`, and messages between nodes contain
/// that text, so a goal of any action can be sent. The variants before the last are the actions that
/// the simulator and the adapter to ROS 2 know in detail.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(remote = "Self", tag = "action", content = "parameters", rename_all = "snake_case")]
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
    /// An action that a domain file declares.
    #[serde(untagged)]
    Declared(DeclaredGoal),
}

/// Goal of a declared action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeclaredGoal {
    /// The action.
    pub action: ActionName,
    /// Parameters, by name.
    #[serde(default)]
    pub parameters: JsonObject,
    /// True if a repetition has no further effect.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub repeatable: bool,
}

/// Parameters, feedback or result of an action: a JSON object.
pub type JsonObject = serde_json::Map<String, serde_json::Value>;

/// Result of a completed goal: values by name; empty for most actions.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GoalResult(pub JsonObject);

impl GoalResult {
    /// Maximum size as JSON, in bytes: the state of a robot, a single message, contains the results of its
    /// latest goals.
    pub const BYTES_MAX: usize = 512;
}

impl Serialize for GoalResult {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            return self.0.serialize(serializer);
        }
        let text = serde_json::to_string(&self.0).map_err(ser::Error::custom)?;
        text.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for GoalResult {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<GoalResult, D::Error> {
        if deserializer.is_human_readable() {
            return JsonObject::deserialize(deserializer).map(GoalResult);
        }
        let text = String::deserialize(deserializer)?;
        serde_json::from_str(&text).map(GoalResult).map_err(de::Error::custom)
    }
}

/// Names of the actions that are variants of [`Goal`].
pub const STANDARD_ACTIONS: [&str; 13] = [
    "navigate_to_pose",
    "approach_person",
    "authenticate_person",
    "operate_drawer",
    "approach_robot",
    "pick_up",
    "grasp",
    "deposit",
    "wait",
    "follow_waypoints",
    "spin",
    "dock",
    "undock",
];

impl Serialize for Goal {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            return Goal::serialize(self, serializer);
        }
        let text = serde_json::to_string(self).map_err(ser::Error::custom)?;
        text.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Goal {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Goal, D::Error> {
        if !deserializer.is_human_readable() {
            let text = String::deserialize(deserializer)?;
            return serde_json::from_str(&text).map_err(de::Error::custom);
        }
        match Goal::deserialize(deserializer)? {
            Goal::Declared(DeclaredGoal { action, .. }) if STANDARD_ACTIONS.contains(&action.as_str()) => {
                Err(de::Error::custom(format_args!("the parameters do not fit the action {action}")))
            }
            goal => Ok(goal),
        }
    }
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
    /// Returns the name of the action.
    pub fn action(&self) -> &str {
        match self {
            Goal::NavigateToPose { .. } => "navigate_to_pose",
            Goal::ApproachPerson { .. } => "approach_person",
            Goal::AuthenticatePerson { .. } => "authenticate_person",
            Goal::OperateDrawer { .. } => "operate_drawer",
            Goal::ApproachRobot { .. } => "approach_robot",
            Goal::PickUp { .. } => "pick_up",
            Goal::Grasp { .. } => "grasp",
            Goal::Deposit { .. } => "deposit",
            Goal::Wait { .. } => "wait",
            Goal::FollowWaypoints { .. } => "follow_waypoints",
            Goal::Spin { .. } => "spin",
            Goal::Dock { .. } => "dock",
            Goal::Undock => "undock",
            Goal::Declared(goal) => goal.action.as_str(),
        }
    }

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
            Goal::Declared(goal) => goal.repeatable,
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
    Succeeded(GoalResult),
    /// Ended by a cancel request. The robot stands still.
    Canceled,
    /// Rejected, or ended without success.
    Aborted(ActionError),
}

impl GoalStatus {
    /// Returns the status of a goal that succeeded without a result.
    pub fn succeeded() -> GoalStatus {
        GoalStatus::Succeeded(GoalResult::default())
    }

    /// Returns the status of a goal that succeeded with a result, or aborted if the result is larger than
    /// [`GoalResult::BYTES_MAX`].
    pub fn with_result(result: JsonObject) -> GoalStatus {
        let bytes = serde_json::to_string(&result).map_or(usize::MAX, |text| text.len());
        if bytes <= GoalResult::BYTES_MAX {
            return GoalStatus::Succeeded(GoalResult(result));
        }
        let message = format!("the result has {bytes} bytes of JSON; at most {} are allowed", GoalResult::BYTES_MAX);
        GoalStatus::Aborted(ActionError::new(ErrorCode::Failed, message))
    }

    /// Checks whether the goal has ended.
    pub fn is_final(&self) -> bool {
        matches!(self, GoalStatus::Succeeded(_) | GoalStatus::Canceled | GoalStatus::Aborted(_))
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

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::codec;
    use serde_json::json;

    fn goals() -> Vec<(Goal, serde_json::Value)> {
        let pose = Pose::new(0.1, -2.0, std::f64::consts::PI / 7.0);
        let declared = DeclaredGoal {
            action: "water".parse().unwrap(),
            parameters: JsonObject::from_iter([("litres".to_owned(), json!(0.5))]),
            repeatable: true,
        };
        vec![
            (
                Goal::NavigateToPose { pose, place: Some("Lab".parse().unwrap()) },
                json!({ "action": "navigate_to_pose", "parameters": { "pose": pose, "place": "Lab" } }),
            ),
            (
                Goal::Wait { time: Seconds::new(2.5).unwrap() },
                json!({ "action": "wait", "parameters": { "time": 2.5 } }),
            ),
            (Goal::Undock, json!({ "action": "undock" })),
            (
                Goal::Declared(declared),
                json!({ "action": "water", "parameters": { "litres": 0.5 }, "repeatable": true }),
            ),
        ]
    }

    #[test]
    fn a_goal_of_any_action_has_the_same_form() {
        for (goal, expected) in goals() {
            assert_eq!(serde_json::to_value(&goal).unwrap(), expected);
            assert_eq!(serde_json::from_value::<Goal>(expected).unwrap(), goal);
            let bytes = codec::encode(&goal).unwrap();
            assert_eq!(codec::decode::<Goal>(&bytes).unwrap(), goal, "to the bit");
            assert_eq!(goal.action(), serde_json::to_value(&goal).unwrap()["action"]);
        }
    }

    #[test]
    fn a_result_keeps_the_types_of_its_values() {
        let json = json!({ "litres": 0.1, "plants": 3, "dry": true, "kind": "fern" });
        let result: GoalResult = serde_json::from_value(json.clone()).unwrap();
        assert_eq!(codec::decode::<GoalResult>(&codec::encode(&result).unwrap()).unwrap(), result);
        assert_eq!(serde_json::to_value(&result).unwrap(), json);
    }

    #[test]
    fn wrong_parameters_of_a_standard_action_are_rejected() {
        for wrong in [json!({ "action": "wait", "parameters": { "time": "soon" } }), json!({ "action": "wait" })] {
            let error = serde_json::from_value::<Goal>(wrong).unwrap_err().to_string();
            assert_eq!(error, "the parameters do not fit the action wait");
        }
        let unnamed = serde_json::from_value::<Goal>(json!({ "action": "a/b" }));
        assert!(unnamed.is_err(), "{unnamed:?}");
    }

    #[test]
    fn every_standard_action_is_listed() {
        let unknown = STANDARD_ACTIONS.iter().filter(|action| {
            let with =
                |parameters| serde_json::from_value::<Goal>(json!({ "action": action, "parameters": parameters }));
            matches!(with(json!({ "x": 1 })), Ok(Goal::Declared(_)))
        });
        assert_eq!(unknown.count(), 0);
    }
}
