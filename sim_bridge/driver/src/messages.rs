//! The messages between a node and the driver of its robot: a JSON object per line.
//!
//! A node rejects unknown fields of a driver; a driver ignores unknown fields and messages of a
//! node, so that a later node can send more.

use consort_protocol::ids::{ActionName, PlaceId, RobotId};
use consort_protocol::pose::Pose;
use consort_protocol::scalar::Scalar;
use consort_protocol::units::{BatteryShare, Metres, Seconds};
use consort_skills::actions::{GoalId, JsonObject};
use consort_skills::domain_file::ParameterForm;
use schemars::{JsonSchema, Schema, schema_for};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Version of these messages. A later version may only add fields and messages of the node.
pub const PROTOCOL_VERSION: u32 = 1;

/// A message of the node to the driver.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum NodeMessage {
    /// The first message after the start of the process.
    Start {
        /// Version of the messages.
        protocol: u32,
        /// The robot.
        robot: RobotId,
        /// Place of the robot: the place of its file, or the last one that the previous process
        /// reported.
        place: PlaceId,
        /// Pose of the robot.
        pose: Pose,
    },
    /// Start a goal. A repeated id starts nothing.
    Goal {
        /// Id of the goal: a decimal number as text.
        #[serde(with = "goal_id")]
        #[schemars(with = "String")]
        id: GoalId,
        /// The action.
        action: ActionName,
        /// Parameters of the action, by name.
        #[serde(default)]
        parameters: JsonObject,
        /// Time from the receipt of this message for which the robot may act, in milliseconds. The
        /// driver stops the robot and ends the goal as `canceled` when it has passed.
        keep_for_ms: u64,
        /// True if a previous process of the driver ended while it executed the goal. The driver
        /// continues it, starts it again, or ends it as `aborted`.
        #[serde(default)]
        resumed: bool,
        /// Id of the first goal of the task, if an earlier process of the node may have begun this goal with
        /// another id; only for actions that are not `repeatable`. If the driver finds the same work begun since
        /// then, the end of that work is the result.
        #[serde(default, skip_serializing_if = "Option::is_none", with = "optional_goal_id")]
        #[schemars(with = "Option<String>")]
        since: Option<GoalId>,
    },
    /// Renew the permission of a goal. The new time replaces the former time.
    Keep {
        /// Id of the goal.
        #[serde(with = "goal_id")]
        #[schemars(with = "String")]
        id: GoalId,
        /// Time from the receipt of this message for which the robot may act, in milliseconds.
        keep_for_ms: u64,
    },
    /// Stop the robot, and end the goal as `canceled`. Without effect on a goal that has ended.
    Cancel {
        /// Id of the goal.
        #[serde(with = "goal_id")]
        #[schemars(with = "String")]
        id: GoalId,
    },
    /// Request for a sign of life, each second. The driver returns the same message.
    Heartbeat {
        /// Number of the heartbeat.
        sequence: u64,
    },
    /// Stop the robot and end the process. The end of the standard input means the same.
    Shutdown {},
}

/// A message of the driver to the node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum DriverMessage {
    /// The first message of the driver.
    Hello {
        /// Version of the messages.
        protocol: u32,
        /// Name and version of the driver, for people.
        driver: String,
        /// Actions that the driver offers, by name: standard ones, or actions that a domain file
        /// declares.
        actions: BTreeMap<ActionName, OfferedAction>,
        /// True if the driver takes `resumed` goals; otherwise a goal fails when the process ends.
        #[serde(default)]
        resumes: bool,
    },
    /// Feedback of the goal in progress.
    Feedback {
        /// Id of the goal.
        #[serde(with = "goal_id")]
        #[schemars(with = "String")]
        id: GoalId,
        /// Remaining distance in metres; omitted for a goal without a drive.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        distance_remaining_m: Option<Metres>,
        /// Remaining time in seconds, if the driver can estimate it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        time_remaining_s: Option<Seconds>,
        /// Values of the feedback that the action declares, by name, in the declared types. They replace those of
        /// the message before.
        #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
        values: BTreeMap<String, Scalar>,
    },
    /// A goal has ended, once for each goal. The robot stands still.
    Result {
        /// Id of the goal.
        #[serde(with = "goal_id")]
        #[schemars(with = "String")]
        id: GoalId,
        /// How the goal ended.
        status: ResultStatus,
        /// Reason of the failure of an aborted goal: one of the `failures` that the action declares, or a
        /// standard code such as `blocked`. Default `failed`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        code: Option<String>,
        /// Cause of the failure, for people.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        message: Option<String>,
        /// Results of a completed goal, by name: the values that its action declares.
        #[serde(default, skip_serializing_if = "JsonObject::is_empty")]
        results: JsonObject,
    },
    /// Pose of the robot, about once a second and after each drive.
    Pose {
        /// East of the map's origin, in metres.
        x_m: f64,
        /// North of the map's origin, in metres.
        y_m: f64,
        /// Heading in radians, counter-clockwise from +x.
        #[serde(default)]
        yaw_rad: f64,
        /// Place on the map. Default: the place within 0.25 m, or else the place before.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        place: Option<PlaceId>,
    },
    /// State of the battery.
    Charge {
        /// Charge as a share of a full battery, from 0 to 1.
        share: BatteryShare,
        /// False if the robot cannot move: the charge is too low, or the driver has no connection to it. Default
        /// true.
        #[serde(default = "yes", skip_serializing_if = "Clone::clone")]
        able: bool,
    },
    /// Latest values of the readings that a domain file declares. A value stays valid until the next one
    /// of the same name.
    Readings {
        /// Values, by name, in the declared types.
        values: BTreeMap<String, Scalar>,
    },
    /// Reply to a heartbeat.
    Heartbeat {
        /// Number of the heartbeat.
        sequence: u64,
    },
    /// The driver could not use a line of the node.
    Error {
        /// The problem.
        message: String,
    },
}

/// An action that a driver offers.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct OfferedAction {
    /// Description for people.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub description: String,
    /// Parameters, in the form of the domain file, to be compared with it; not compared if they are omitted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub parameters: Option<BTreeMap<String, ParameterForm>>,
    /// Results, in the form of the domain file, to be compared with it; not compared if they are omitted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub results: Option<BTreeMap<String, ParameterForm>>,
    /// Feedback, in the form of the domain file, to be compared with it; not compared if it is omitted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedback: Option<BTreeMap<String, ParameterForm>>,
    /// Parameters with which `consort driver check` tries the action: a goal of about 2 s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub example: Option<JsonObject>,
}

/// How a goal ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ResultStatus {
    /// The goal is completed.
    Succeeded,
    /// The goal ended by a cancel message, or its permission has passed.
    Canceled,
    /// The goal was rejected, or ended without success.
    Aborted,
}

fn yes() -> bool {
    true
}

/// Ids of goals exceed the integers that JavaScript can represent, so they are texts.
mod goal_id {
    use consort_skills::actions::GoalId;
    use serde::{Deserialize, Deserializer, Serializer, de};

    pub(super) fn serialize<S: Serializer>(id: &GoalId, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&id.0)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<GoalId, D::Error> {
        let text = String::deserialize(deserializer)?;
        let id = text.parse().map_err(|_| {
            de::Error::custom(format_args!("{text:?} is no id of a goal: allowed is a decimal number as text"))
        })?;
        Ok(GoalId(id))
    }
}

mod optional_goal_id {
    use super::goal_id;
    use consort_skills::actions::GoalId;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    #[derive(Serialize, Deserialize)]
    struct Id(#[serde(with = "goal_id")] GoalId);

    pub(super) fn serialize<S: Serializer>(id: &Option<GoalId>, serializer: S) -> Result<S::Ok, S::Error> {
        id.map(Id).serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<GoalId>, D::Error> {
        Ok(Option::<Id>::deserialize(deserializer)?.map(|Id(id)| id))
    }
}

impl NodeMessage {
    /// Returns the line of the message, with its end.
    pub fn to_line(&self) -> String {
        serde_json::to_string(self).expect("messages have a JSON form") + "\n"
    }
}

impl DriverMessage {
    /// Reads a line.
    ///
    /// # Errors
    /// The problem, with the position in the line.
    pub fn parse(line: &str) -> Result<DriverMessage, serde_json::Error> {
        serde_json::from_str(line)
    }
}

/// Returns the JSON Schema of each message, by name: `node-goal`, `driver-result`.
pub fn message_schemas() -> Vec<(String, Value)> {
    let of = |sender: &str, schema: Schema| {
        let schema = schema.to_value();
        let variants = schema["oneOf"].as_array().cloned().unwrap_or_default();
        let named = variants.into_iter().map(|mut variant| {
            let name = variant["properties"]["type"]["const"].as_str().unwrap_or_default().to_owned();
            let object = variant.as_object_mut().expect("a message is an object");
            object.insert("$schema".to_owned(), schema["$schema"].clone());
            object.insert("title".to_owned(), json!(name));
            let text = object.values().map(Value::to_string).collect::<String>();
            if text.contains("#/$defs/") {
                object.insert("$defs".to_owned(), schema["$defs"].clone());
            }
            (format!("{sender}-{name}"), variant)
        });
        named.collect::<Vec<_>>()
    };
    [of("node", schema_for!(NodeMessage)), of("driver", schema_for!(DriverMessage))].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_have_the_documented_form() {
        let goal = NodeMessage::Goal {
            id: GoalId(1 << 60),
            action: "vacuum".parse().unwrap(),
            parameters: JsonObject::from_iter([("passes".to_owned(), json!(2))]),
            keep_for_ms: 900,
            resumed: false,
            since: None,
        };
        let line = r#"{"type":"goal","id":"1152921504606846976","action":"vacuum","parameters":{"passes":2},"keep_for_ms":900,"resumed":false}"#;
        assert_eq!(goal.to_line(), format!("{line}\n"));
        let line = line.replace("false}", r#"false,"since":"7"}"#);
        let again = serde_json::from_str::<NodeMessage>(&line).unwrap();
        assert!(matches!(again, NodeMessage::Goal { since: Some(GoalId(7)), .. }), "{again:?}");
        assert_eq!(again.to_line(), format!("{line}\n"));
        assert_eq!(NodeMessage::Shutdown {}.to_line(), "{\"type\":\"shutdown\"}\n");
        assert_eq!(
            DriverMessage::parse(
                r#"{"type":"result","id":"7","status":"aborted","code":"blocked","message":"a chair"}"#
            )
            .unwrap(),
            DriverMessage::Result {
                id: GoalId(7),
                status: ResultStatus::Aborted,
                code: Some("blocked".to_owned()),
                message: Some("a chair".to_owned()),
                results: JsonObject::new(),
            }
        );
    }

    #[test]
    fn wrong_messages_of_a_driver_are_rejected_with_a_cause() {
        let error = |line: &str| DriverMessage::parse(line).unwrap_err().to_string();
        assert!(error(r#"{"type":"charge","share":1.5}"#).contains("allowed is a number from 0"));
        assert!(error(r#"{"type":"charge","share":0.5,"volts":12}"#).contains("unknown field `volts`"));
        assert!(error(r#"{"type":"result","id":7,"status":"succeeded"}"#).contains("expected a string"));
        assert!(error(r#"{"type":"result","id":"x","status":"succeeded"}"#).contains("no id of a goal"));
        assert!(error(r#"{"type":"sing"}"#).contains("unknown variant `sing`, expected one of `hello`"));
        assert!(error(r#"{"type":"readings","values":{"dust":[1]}}"#).contains("allowed is a boolean, a number"));
    }

    #[test]
    fn every_message_has_a_schema() {
        let schemas = message_schemas();
        let names: Vec<&str> = schemas.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(
            names,
            [
                "node-start",
                "node-goal",
                "node-keep",
                "node-cancel",
                "node-heartbeat",
                "node-shutdown",
                "driver-hello",
                "driver-feedback",
                "driver-result",
                "driver-pose",
                "driver-charge",
                "driver-readings",
                "driver-heartbeat",
                "driver-error",
            ]
        );
    }
}
