//! Goals of robots, their status and feedback.

use super::error::{ActionError, ErrorCode};
use consort_protocol::ids::ActionName;
use consort_protocol::mission::RESULTS_MAX;
use consort_protocol::scalar::{NamedScalarsError, Scalar, check_named_scalars};
use consort_protocol::units::{Metres, Seconds};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de, ser};
use serde_json::Value;
use std::collections::BTreeMap;

/// Identifies a goal among all goals that a robot ever sends. Later goals have larger numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct GoalId(pub u64);

/// A goal for a robot: an action that a domain file declares, with parameters.
///
/// In JSON it is `{"action": "wait", "parameters": {"time": 5.0}}`, and messages between nodes contain
/// that text.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(remote = "Self", deny_unknown_fields)]
pub struct Goal {
    /// The action.
    pub action: ActionName,
    /// Parameters, by name.
    #[serde(default)]
    pub parameters: JsonObject,
    /// True if a repetition has no further effect: a reached place is driven to. A goal that transfers an
    /// object is done once, and fails the second time.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub repeatable: bool,
    /// True if the goal may move items; `None` if the declaration of the action does not state it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hands_over: Option<bool>,
    /// First goal of the task, if an earlier process of the robot's node may have begun this goal with another
    /// id; only for goals that are not repeatable. A driver with a memory takes the result of that goal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub since: Option<GoalId>,
}

/// The parameters of an action, for programs that know the action: skills, simulators and adapters.
pub trait ActionParameters: Serialize + DeserializeOwned {
    /// Name of the action.
    const ACTION: &'static str;
    /// True if a repetition has no further effect, as in the declaration of the action.
    const REPEATABLE: bool;
}

impl<P: ActionParameters> From<P> for Goal {
    fn from(parameters: P) -> Goal {
        let action = ActionName::new(P::ACTION).expect("the name of an action is a slug");
        let parameters = match serde_json::to_value(parameters) {
            Ok(Value::Object(parameters)) => parameters,
            Ok(Value::Null) => JsonObject::new(),
            other => unreachable!("parameters are an object: {other:?}"),
        };
        // A parameter without a value is left out, as in a behavior tree.
        let parameters = parameters.into_iter().filter(|(_, value)| !value.is_null()).collect();
        Goal { action, parameters, repeatable: P::REPEATABLE, hands_over: None, since: None }
    }
}

impl Goal {
    /// Checks whether this is a goal of the action.
    pub fn is<P: ActionParameters>(&self) -> bool {
        self.action.as_str() == P::ACTION
    }

    /// Checks whether the goal may move items: as declared, or else if a repetition has a further effect.
    pub fn may_move_items(&self) -> bool {
        self.hands_over.unwrap_or(!self.repeatable)
    }

    /// Reads the parameters of a goal of this action; `None` for other actions.
    ///
    /// # Errors
    /// The parameters do not fit the action.
    pub fn read<P: ActionParameters>(&self) -> Option<Result<P, ActionError>> {
        self.is::<P>().then(|| {
            P::deserialize(&self.parameters).map_err(|problem| {
                let message = format!("the parameters do not fit the action {}: {problem}", self.action);
                ActionError::rejected(ErrorCode::Unknown, message)
            })
        })
    }
}

/// Parameters or result of an action: a JSON object.
pub type JsonObject = serde_json::Map<String, Value>;

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
        if deserializer.is_human_readable() {
            return Goal::deserialize(deserializer);
        }
        let text = String::deserialize(deserializer)?;
        serde_json::from_str(&text).map_err(de::Error::custom)
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

    /// Returns the status without the values of a feedback that is beyond the limits of a message. The goal continues.
    #[must_use]
    pub fn within_limits(self) -> GoalStatus {
        match self {
            GoalStatus::Executing(feedback) if check_feedback(&feedback.values).is_err() => {
                GoalStatus::Executing(Feedback { values: BTreeMap::new(), ..feedback })
            }
            status => status,
        }
    }

    /// Checks whether the goal has ended.
    pub fn is_final(&self) -> bool {
        matches!(self, GoalStatus::Succeeded(_) | GoalStatus::Canceled | GoalStatus::Aborted(_))
    }
}

/// Feedback of an active goal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Feedback {
    /// Remaining distance; zero for a goal without a drive.
    pub distance_remaining: Metres,
    /// Remaining time, as far as the backend can estimate it.
    pub time_remaining: Seconds,
    /// Progress in the goal's own terms, as in Nav2.
    pub progress: GoalProgress,
    /// Latest values of the feedback that the action declares, by name: as many as results.
    #[serde(default, deserialize_with = "feedback_values")]
    pub values: BTreeMap<String, Scalar>,
}

impl Feedback {
    /// Creates the feedback of a goal without terms of its own and without declared values.
    pub fn remaining(distance_remaining: Metres, time_remaining: Seconds) -> Feedback {
        let (progress, values) = (GoalProgress::Unspecified, BTreeMap::new());
        Feedback { distance_remaining, time_remaining, progress, values }
    }
}

/// Decodes the values of a feedback within their limits.
fn feedback_values<'de, D: Deserializer<'de>>(source: D) -> Result<BTreeMap<String, Scalar>, D::Error> {
    let values = BTreeMap::deserialize(source)?;
    check_feedback(&values).map_err(de::Error::custom)?;
    Ok(values)
}

fn check_feedback(values: &BTreeMap<String, Scalar>) -> Result<(), NamedScalarsError> {
    check_named_scalars("feedback value", values, RESULTS_MAX)
}

/// Progress of an active goal, in the goal's own terms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum GoalProgress {
    /// No progress beyond the remaining distance and time.
    Unspecified,
    /// Index of the current waypoint of [`FollowWaypoints`](super::FollowWaypoints), from 0 (`current_waypoint`).
    Waypoint(u32),
    /// Angle of [`Spin`](super::Spin) turned so far, in radians, positive to the left
    /// (`angular_distance_traveled`).
    Turned(f64),
    /// Time that [`Dock`](super::Dock) or [`Undock`](super::Undock) has taken so far (`docking_time`).
    Docking(Seconds),
}

#[cfg(test)]
mod tests {
    use super::super::{NavigateToPose, Spin, Undock, Wait};
    use super::*;
    use consort_protocol::codec;
    use consort_protocol::pose::Pose;
    use serde_json::json;

    fn goals() -> Vec<(Goal, Value)> {
        let pose = Pose::new(0.1, -2.0, std::f64::consts::PI / 7.0);
        let water = Goal {
            action: "water".parse().unwrap(),
            parameters: JsonObject::from_iter([("litres".to_owned(), json!(0.5))]),
            repeatable: true,
            hands_over: Some(false),
            since: Some(GoalId(7)),
        };
        let navigate = |place| Goal::from(NavigateToPose::to(pose, place));
        vec![
            (
                navigate(Some("Lab".parse().unwrap())),
                json!({ "action": "navigate_to_pose", "parameters": { "pose": pose, "place": "Lab" }, "repeatable": true }),
            ),
            (
                navigate(None),
                json!({ "action": "navigate_to_pose", "parameters": { "pose": pose }, "repeatable": true }),
            ),
            (
                Wait { time: Seconds::new(2.5).unwrap() }.into(),
                json!({ "action": "wait", "parameters": { "time": 2.5 }, "repeatable": true }),
            ),
            (Undock {}.into(), json!({ "action": "undock", "parameters": {}, "repeatable": true })),
            (
                water,
                json!({
                    "action": "water", "parameters": { "litres": 0.5 }, "repeatable": true, "hands_over": false,
                    "since": 7,
                }),
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
    fn feedback_keeps_its_declared_values_within_their_limits() {
        let sent = |values: Vec<(String, Scalar)>| {
            let remaining = Feedback::remaining(Metres::ZERO, Seconds::new(2.5).unwrap());
            GoalStatus::Executing(Feedback { values: values.into_iter().collect(), ..remaining })
        };
        let text = |size: usize| Scalar::Text("x".repeat(size));
        let soaked = sent(vec![("soaked".to_owned(), Scalar::Number(0.5)), ("phase".to_owned(), text(256))]);
        assert_eq!(codec::decode::<GoalStatus>(&codec::encode(&soaked).unwrap()).unwrap(), soaked);
        assert_eq!(soaked.clone().within_limits(), soaked);
        let many = (0..17).map(|number| (format!("f{number}"), Scalar::Bool(true))).collect();
        for (wrong, part) in [
            (sent(many), "17 feedback values; at most 16 are allowed"),
            (sent(vec![("phase".to_owned(), text(257))]), "the feedback value `phase` is a text of 257 bytes"),
        ] {
            let error = codec::decode::<GoalStatus>(&codec::encode(&wrong).unwrap()).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
            assert_eq!(wrong.within_limits(), sent(vec![]), "the goal continues");
        }
    }

    #[test]
    fn parameters_are_read_by_the_programs_that_know_the_action() {
        let goal = |json| serde_json::from_value::<Goal>(json).unwrap();
        let wait = goal(json!({ "action": "wait", "parameters": { "time": 2.5 } }));
        assert_eq!(wait.read::<Wait>(), Some(Ok(Wait { time: Seconds::new(2.5).unwrap() })));
        assert_eq!(wait.read::<Spin>(), None);
        assert_eq!(goal(json!({ "action": "undock" })).read::<Undock>(), Some(Ok(Undock {})));
        let wrong = goal(json!({ "action": "wait", "parameters": { "time": "soon" } })).read::<Wait>();
        let error = wrong.unwrap().unwrap_err();
        assert!(error.message.starts_with("the parameters do not fit the action wait: "), "{error}");
        assert!(error.moved_nothing);
        let unnamed = serde_json::from_value::<Goal>(json!({ "action": "a/b" }));
        assert!(unnamed.is_err(), "{unnamed:?}");
    }
}
