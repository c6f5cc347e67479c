//! The form of a domain file.

use super::distribution::{Distribution, SimulatedDuration};
use crate::actions::{ActionError, ErrorCode};
use consort_protocol::cause::CauseClass;
use consort_protocol::ids::{ActionName, DomainId, PlaceId, RoleId, TaskType};
use consort_protocol::mission::{DomainReference, IhtnNames, NumberRange, ParameterSchema, TaskSchema, ValueKind};
use consort_protocol::scalar::Scalar;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// A domain: actions that drivers perform, and task types that use them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DomainForm {
    /// Name of the domain.
    pub domain: DomainId,
    /// Description for people.
    #[serde(default)]
    pub description: String,
    /// Actions, by name.
    #[serde(default)]
    pub actions: BTreeMap<ActionName, ActionForm>,
    /// Readings that drivers publish, by name: at most 64 in all domains of a fleet. Each is also a
    /// condition of behavior trees.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub readings: BTreeMap<String, ReadingForm>,
    /// Task types, by name.
    #[serde(default)]
    pub tasks: BTreeMap<TaskType, TaskForm>,
    /// Meaning of names in missions in the flat iHTN form.
    #[serde(default)]
    pub ihtn: IhtnForm,
}

/// Meaning of names in missions in the flat iHTN form, which has only names.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct IhtnForm {
    /// Agents that are people. All other agents are robots, except for the objects.
    pub people: BTreeSet<RoleId>,
    /// Agents that are things: they have no role, and become the parameter `object` of the action.
    pub objects: BTreeSet<String>,
    /// Places of the map, by locations that the map lacks.
    pub places: BTreeMap<String, PlaceId>,
    /// Task types, by names of actions that differ from them.
    pub actions: BTreeMap<String, TaskType>,
    /// Task types that bring a robot to their location.
    #[serde(skip_serializing_if = "BTreeSet::is_empty")]
    pub reaching: BTreeSet<TaskType>,
}

impl From<IhtnForm> for IhtnNames {
    fn from(IhtnForm { people, objects, places, actions, reaching }: IhtnForm) -> Self {
        IhtnNames { people, objects, places, actions, reaching }
    }
}

/// An action that a driver performs.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ActionForm {
    /// Description for people.
    pub description: String,
    /// Parameters, by name.
    pub parameters: BTreeMap<String, ParameterForm>,
    /// Values that a completed goal returns, by name. Their types are those of parameters without `place`
    /// and `role`.
    pub results: BTreeMap<String, ParameterForm>,
    /// Values that a driver sends while it executes a goal, by name: the latest ones are shown to people. Their types
    /// are those of results.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub feedback: BTreeMap<String, ParameterForm>,
    /// True if a repetition of a completed goal has no further effect. Default false: a completed goal is
    /// never sent again.
    pub repeatable: bool,
    /// True if a goal may move items from one holder to another: if it ends in another way than by a failure that
    /// `moved_nothing`, its items may be anywhere. Default: the opposite of `repeatable`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hands_over: Option<bool>,
    /// How a goal is canceled. Default: a driver has 3 s, and the simulator stops at once.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cancel: Option<CancelForm>,
    /// True if people perform the action: trees of robots do not contain it. A robot asks a person with the node
    /// `AskPerson`. Default false.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub by_people: bool,
    /// Reasons for which a goal fails, by name: the `code` of a driver. A failure for any other reason is of
    /// class `robot`.
    pub failures: BTreeMap<String, FailureForm>,
    /// Repetition of a goal that fails for a reason that may pass.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub retry: Option<RetryForm>,
    /// Discharge during a goal, as a multiple of the robot's usual discharge rate, 0 or more: 3 for an action that needs three
    /// times the power of a drive. Estimates and the simulator use it. Default 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub discharge: Option<f64>,
    /// What the simulator does with a goal of the action.
    pub simulate: SimulatedAction,
}

/// How a goal is canceled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CancelForm {
    /// Time from a cancel to the end of the goal, from 0.1 to 60 s. A driver that needs longer is killed. The simulator
    /// takes exactly this time, unless the goal reaches its end before, or a `system` executes it.
    pub within_s: f64,
}

/// Repetition of a goal that fails for a reason that may pass. The node of the action has the port `timeout_s`,
/// which overrides the time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RetryForm {
    /// Code of the failure.
    #[schemars(with = "String")]
    pub on: ErrorCode,
    /// Time for which the goal is tried again, a second apart, in seconds.
    pub timeout_s: f64,
}

/// A reason for which goals of an action fail.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FailureForm {
    /// Class of the reason. Default `robot`.
    pub class: CauseClass,
    /// Description for people.
    pub description: String,
    /// True if a goal that fails for this reason has certainly moved no item. Default false.
    pub moved_nothing: bool,
}

impl ActionForm {
    /// Checks whether a goal may move items: as declared, or else if a repetition has a further effect.
    pub(super) fn may_move_items(&self) -> bool {
        self.hands_over.unwrap_or(!self.repeatable)
    }

    /// Returns the error of a goal that failed for a declared reason; `None` for any other reason.
    pub fn failure(&self, reason: &str, message: &str) -> Option<ActionError> {
        let FailureForm { class, moved_nothing, .. } = *self.failures.get(reason)?;
        let message = format!("{reason}: {message}");
        Some(ActionError { class, moved_nothing, ..ActionError::new(ErrorCode::Failed, message) })
    }
}

/// A parameter of an action or a task type.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ParameterForm {
    /// Type of the value.
    #[serde(rename = "type")]
    pub kind: ParameterKind,
    /// Unit, for people.
    #[serde(default)]
    pub unit: String,
    /// Description for people.
    #[serde(default)]
    pub description: String,
    /// Least number.
    #[serde(default)]
    pub minimum: Option<f64>,
    /// Greatest number.
    #[serde(default)]
    pub maximum: Option<f64>,
    /// The allowed texts; for texts only. Without it every text is allowed.
    #[serde(default)]
    pub one_of: BTreeSet<String>,
    /// True if the value may be omitted.
    #[serde(default)]
    pub optional: bool,
}

/// A reading: a value that a driver publishes. Its form is that of a parameter without the type `role`
/// and without `optional`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReadingForm {
    /// The value.
    #[serde(flatten)]
    pub value: ParameterForm,
    /// How the simulator plays the reading.
    #[serde(default)]
    pub simulate: SimulatedReading,
}

/// How the simulator plays a reading.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SimulatedReading {
    /// Value at the start of the world. Default: a value within the declared range.
    pub value: Option<SimulatedResult>,
}

/// Type of a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ParameterKind {
    /// Place on the map.
    Place,
    /// Role of the mission.
    Role,
    /// Duration in seconds, 0 or more.
    Seconds,
    /// Finite number.
    Number,
    /// Whole number.
    Integer,
    /// `true` or `false`.
    Bool,
    /// Text.
    Text,
    /// Robot; in actions only.
    Robot,
    /// Pose on the floor: an object with `x`, `y` and `yaw`; in actions only.
    Pose,
    /// Poses, each with a place if it has one: a list of objects with `pose` and `place`; in actions only.
    Waypoints,
    /// Points `x,y` in metres, separated by `;`; in tasks only.
    Points,
}

/// A task type.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TaskForm {
    /// Description for people.
    #[serde(default)]
    pub description: String,
    /// Parameters, by name.
    #[serde(default)]
    pub parameters: BTreeMap<String, ParameterForm>,
    /// Results, by name: the values of the keys of the main tree with these names. Default for a task with
    /// an `action`: the results of the action.
    #[serde(default)]
    pub results: BTreeMap<String, ParameterForm>,
    /// The action that performs the task; its parameters are those of the task with the same names.
    /// Either this or `tree`.
    #[serde(default)]
    pub action: Option<ActionName>,
    /// Name of the file of the behavior tree that performs the task (BehaviorTree.CPP 4), relative to the
    /// domain file. Either this or `action`.
    #[serde(default)]
    pub tree: Option<String>,
    /// Condition in CEL on the robot and the parameters, such as `attributes.payload_kg >= mass_kg`. A robot for
    /// which it is false or unknown does not bid. The variables are those of the estimate, and the latest `readings` of
    /// the robot's driver: `readings.tank_l >= litres`.
    #[serde(default)]
    pub requires: Option<String>,
    /// Estimate of the cost. Default for a task with an `action`: the mean time that the simulator needs, and the energy for
    /// that time.
    #[serde(default)]
    pub estimate: Option<EstimateForm>,
}

/// Estimate of the cost of a task. Expressions are in CEL. Their variables are the parameters of the task,
/// `speed` (m/s), `discharge` (share of the battery per second) and `attributes` of the robot, and for each
/// parameter of type `place` the length of the route to it in `distance` (m) and the time of the drive, with the
/// waits at doors and lifts, in `travel_s` (s): `travel_s.at + 8.0`. For a parameter of type `points` they are those
/// of the path.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EstimateForm {
    /// Duration in seconds, as an expression.
    pub time_s: String,
    /// Energy as a share of a full battery, as an expression. Default: the time at the robot's discharge
    /// rate, times the `discharge` of the task's `action`.
    #[serde(default)]
    pub energy: Option<String>,
    /// Parameter with the place at which the task ends. Default: where it begins.
    #[serde(default)]
    pub ends_at: Option<String>,
}

/// What the simulator does with a goal: it takes a time, and succeeds or fails.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SimulatedAction {
    /// The system of the simulator that executes the goals, if one does: it determines how long they take and
    /// what they change.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub system: Option<String>,
    /// Kind of the goals, for a system with several kinds: the name of the standard action that the system
    /// executes. Default: the name of this action.
    #[serde(rename = "as", skip_serializing_if = "Option::is_none")]
    pub goal_kind: Option<ActionName>,
    /// Duration in seconds. Default 2 to 2 s.
    pub duration_s: SimulatedDuration,
    /// Share of the goals that fail at their end for no declared reason, from 0 to 1. Default 0.
    pub failure_rate: f64,
    /// Shares of the goals that fail at their end for the declared reasons, from 0 to 1, by name. Default 0.
    pub failures: BTreeMap<String, f64>,
    /// Results, by name. Default: a value within the declared range.
    pub results: BTreeMap<String, SimulatedResult>,
    /// Feedback, by name: during a goal a range passes from its first to its second number, and a list through its
    /// values. Default: the declared range, or the declared texts.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub feedback: BTreeMap<String, SimulatedResult>,
    /// Changes of readings when a goal succeeds, by the name of the reading.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub effects: BTreeMap<String, SimulatedEffect>,
    /// Move of an item when a goal succeeds: `from: nothing` creates it, and `to: nothing` consumes it. A goal that
    /// cannot move it is rejected, or fails at its end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moves: Option<SimulatedMove>,
    /// True if the robot has a full battery when a goal succeeds: a person has swapped it. Default false.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub renews_battery: bool,
}

/// Move of an item by a simulated goal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SimulatedMove {
    /// Holder of the item before.
    pub from: ItemHolder,
    /// Holder of the item afterwards.
    pub to: ItemHolder,
    /// Parameter of type `text` with the name of the item. Default: the item that `from` has had for the longest
    /// time; for a new item, the name of the action and a number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub item: Option<String>,
    /// Parameter of type `robot` with the robot of `other_container`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<String>,
    /// Declared failure of a goal that cannot move the item. Default: the standard code of the reason, such as
    /// `out_of_reach`, `container_state` or `too_heavy`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub otherwise: Option<String>,
}

/// Holder of an item of a simulated goal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ItemHolder {
    /// The table at the robot's place.
    Table,
    /// The robot's own container, open or closed.
    Container,
    /// The robot's arm, within its reach and payload.
    Arm,
    /// The open container of another robot at the same place, after one of the two has approached the other.
    OtherContainer,
    /// No holder: the item does not exist.
    Nothing,
}

/// Maximum number of whole numbers among which the simulator chooses a result that is not described.
const SIMULATED_INTEGERS_MAX: usize = 100;

/// Value in the simulator: a result or the feedback of a goal, or a reading.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(
    untagged,
    expecting = "allowed are [least, greatest], a list of values, a value, \
                 { normal: { mean, deviation, minimum, maximum } } and { exponential: { mean, maximum } }"
)]
pub enum SimulatedResult {
    /// A number from the first to the second; uniformly distributed.
    Range([f64; 2]),
    /// Any of these values, with equal probability.
    OneOf(Vec<Scalar>),
    /// Always this value.
    Value(Scalar),
    /// A number with this distribution; not for feedback.
    Distributed(Distribution),
}

/// Change of a reading by a simulated goal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(
    untagged,
    expecting = "allowed are { add: NUMBER }, [least, greatest], a list of values, a value, \
                 { normal: { mean, deviation, minimum, maximum } } and { exponential: { mean, maximum } }"
)]
pub enum SimulatedEffect {
    /// The reading grows by a number, up to the end of its range.
    Add(Addition),
    /// The reading gets a new value.
    Set(SimulatedResult),
}

/// Addition to a reading.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Addition {
    /// Number that is added; it may be negative.
    pub add: f64,
}

impl Default for SimulatedAction {
    fn default() -> Self {
        SimulatedAction {
            system: None,
            goal_kind: None,
            duration_s: SimulatedDuration::Range([2.0, 2.0]),
            failure_rate: 0.0,
            failures: BTreeMap::new(),
            results: BTreeMap::new(),
            feedback: BTreeMap::new(),
            effects: BTreeMap::new(),
            moves: None,
            renews_battery: false,
        }
    }
}

impl SimulatedAction {
    /// Returns the mean duration in seconds.
    pub fn mean_s(&self) -> f64 {
        self.duration_s.mean_s()
    }
}

impl ParameterKind {
    /// Checks whether only actions have parameters of this type.
    pub(super) fn is_of_actions(self) -> bool {
        matches!(self, ParameterKind::Robot | ParameterKind::Pose | ParameterKind::Waypoints)
    }

    /// Checks whether a robot can return a value of this type.
    pub(super) fn is_value(self) -> bool {
        !self.is_of_actions() && !matches!(self, ParameterKind::Role | ParameterKind::Points)
    }

    /// Checks whether a JSON value has this type.
    pub fn fits(self, value: &serde_json::Value) -> bool {
        match self {
            ParameterKind::Seconds => value.as_f64().is_some_and(|seconds| seconds >= 0.0),
            ParameterKind::Number => value.is_number(),
            ParameterKind::Integer => value.is_i64(),
            ParameterKind::Bool => value.is_boolean(),
            ParameterKind::Pose => value.is_object(),
            ParameterKind::Waypoints => value.is_array(),
            ParameterKind::Place
            | ParameterKind::Role
            | ParameterKind::Text
            | ParameterKind::Robot
            | ParameterKind::Points => value.is_string(),
        }
    }
}

impl ParameterForm {
    /// Returns a value of the type and within the range, for the simulator.
    pub(super) fn simulated(&self) -> SimulatedResult {
        let (minimum, maximum) = (self.minimum.unwrap_or(0.0), self.maximum.unwrap_or(1.0));
        match self.kind {
            ParameterKind::Number | ParameterKind::Seconds => SimulatedResult::Range([minimum, maximum.max(minimum)]),
            ParameterKind::Integer => {
                let numbers = (minimum.ceil() as i64..=maximum.floor() as i64).take(SIMULATED_INTEGERS_MAX);
                SimulatedResult::OneOf(numbers.map(Scalar::Integer).collect())
            }
            ParameterKind::Bool => SimulatedResult::OneOf(vec![Scalar::Bool(false), Scalar::Bool(true)]),
            _ if self.one_of.is_empty() => SimulatedResult::Value(Scalar::Text("simulated".to_owned())),
            _ => SimulatedResult::OneOf(self.one_of.iter().cloned().map(Scalar::Text).collect()),
        }
    }

    /// Returns the number within the range that is nearest to `number`, as a value of the type; `None` if
    /// the type has no numbers.
    pub fn nearest(&self, number: f64) -> Option<Scalar> {
        let (minimum, maximum) = (self.minimum.unwrap_or(f64::MIN), self.maximum.unwrap_or(f64::MAX));
        match self.kind {
            ParameterKind::Number => Some(Scalar::Number(number.max(minimum).min(maximum))),
            ParameterKind::Seconds => Some(Scalar::Number(number.max(0.0))),
            ParameterKind::Integer => {
                Some(Scalar::Integer(number.round().max(minimum.ceil()).min(maximum.floor()) as i64))
            }
            _ => None,
        }
    }

    /// Returns the text of a value of the type, for the check of expressions.
    pub(super) fn example(&self) -> String {
        match self.kind {
            ParameterKind::Seconds | ParameterKind::Number | ParameterKind::Integer => {
                self.minimum.or(self.maximum).unwrap_or(1.0).to_string()
            }
            ParameterKind::Bool => "true".to_owned(),
            _ => self.one_of.first().cloned().unwrap_or_else(|| "example".to_owned()),
        }
    }

    fn range(&self) -> NumberRange {
        NumberRange { minimum: self.minimum, maximum: self.maximum }
    }

    /// Returns the kind of the values.
    pub fn value_kind(&self) -> ValueKind {
        match self.kind {
            ParameterKind::Place => ValueKind::Place,
            ParameterKind::Role => ValueKind::Role,
            ParameterKind::Seconds => ValueKind::Seconds,
            ParameterKind::Number => ValueKind::Number(self.range()),
            ParameterKind::Integer => ValueKind::Integer(self.range()),
            ParameterKind::Bool => ValueKind::Bool,
            ParameterKind::Text if !self.one_of.is_empty() => ValueKind::OneOf(self.one_of.clone()),
            ParameterKind::Text
            | ParameterKind::Robot
            | ParameterKind::Pose
            | ParameterKind::Waypoints
            | ParameterKind::Points => ValueKind::Text,
        }
    }
}

impl ReadingForm {
    /// Returns the value at the start of a simulated world.
    pub fn simulated(&self) -> SimulatedResult {
        self.simulate.value.clone().unwrap_or_else(|| self.value.simulated())
    }
}

impl TaskForm {
    /// Returns the parameters and the results for missions, without what depends on the tree. The results are those
    /// of the `action` if the task declares none.
    pub(super) fn schema(&self, action: Option<&ActionForm>, domain: Option<DomainReference>) -> TaskSchema {
        let schema = |(name, parameter): (&String, &ParameterForm)| {
            (name.clone(), ParameterSchema { kind: parameter.value_kind(), required: !parameter.optional })
        };
        let results = self.results(action).iter().map(|(name, result)| (name.clone(), result.value_kind()));
        let (parameters, results) = (self.parameters.iter().map(schema).collect(), results.collect());
        TaskSchema { parameters, results, domain, hands_over: None }
    }

    /// Returns the results: those of the `action` if the task declares none.
    pub(super) fn results<'a>(&'a self, action: Option<&'a ActionForm>) -> &'a BTreeMap<String, ParameterForm> {
        action.map(|action| &action.results).filter(|_| self.results.is_empty()).unwrap_or(&self.results)
    }
}
