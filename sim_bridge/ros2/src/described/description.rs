//! The file that describes a robot under ROS 2.

use crate::dynamic::types::{TypeError, TypeRegistry};
use consort_skills::actions::JsonObject;
use schemars::{JsonSchema, schema_for};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Shipped descriptions, by name.
pub const SHIPPED: [(&str, &str); 5] = [
    ("nav2", include_str!("../../robots/nav2.yaml")),
    ("nav2_moves", include_str!("../../robots/nav2_moves.yaml")),
    ("turtlebot", include_str!("../../robots/turtlebot.yaml")),
    ("rmf_door", include_str!("../../robots/rmf_door.yaml")),
    ("rmf_lift", include_str!("../../robots/rmf_lift.yaml")),
];

/// Greatest number of descriptions that extend each other.
const EXTENDS_DEPTH: usize = 8;

/// A robot, or a device of a building, under ROS 2.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RobotDescription {
    /// Descriptions that this one extends: `nav2`, `nav2_moves`, `turtlebot`, `rmf_door`, `rmf_lift`, or files relative to this one. A later one
    /// replaces the actions, readings and tables of an earlier one by name, and this file those of all.
    pub extends: Vec<String>,
    /// Description for people.
    pub description: String,
    /// Namespace of the robot. Names without a leading slash are in it.
    pub namespace: String,
    /// Frame of the fleet's map. Default `map`.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub map_frame: String,
    /// True if the stamps of messages are those of `/clock`.
    pub use_sim_time: bool,
    /// Folders with definitions, as `package/msg/Name.msg`, `package/srv/Name.srv` and
    /// `package/action/Name.action`, relative to this file. Types without one are requested from the nodes that use them.
    pub types: Vec<PathBuf>,
    /// Lifecycle nodes that must be active.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lifecycle: Option<Lifecycle>,
    /// Source of the pose. Without it, the robot is where it started, or where the feedback says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose: Option<PoseSource>,
    /// Source of the charge. Without it, the battery counts as full.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub charge: Option<ChargeSource>,
    /// Sources of readings, by the name that a domain file declares.
    pub readings: BTreeMap<String, FieldSource>,
    /// Mappings of actions, by the name that a domain file declares.
    pub actions: BTreeMap<String, ActionMapping>,
    /// Tables for `${table[parameter]}`: the value for each value of the parameter.
    pub tables: Tables,
}

/// Values by the value of a parameter, by the name of the table.
pub type Tables = BTreeMap<String, BTreeMap<String, Value>>;

/// Lifecycle nodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Lifecycle {
    /// The nodes. A goal fails while one of them is not active.
    pub nodes: Vec<String>,
    /// True if the driver configures and activates them before a goal. Default false.
    #[serde(default)]
    pub activate: bool,
}

/// Source of the pose: a topic, or transforms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PoseSource {
    /// Topic with the pose in the frame of the map.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub topic: Option<String>,
    /// Type of its messages.
    #[serde(default, rename = "type", skip_serializing_if = "Option::is_none")]
    pub type_name: Option<String>,
    /// Path of the `geometry_msgs/msg/Pose` in the message. Default `pose.pose`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field: Option<String>,
    /// Frame of the robot: the pose is its transform to the frame of the map, from `/tf` and `/tf_static`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tf: Option<String>,
}

/// Source of the charge.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ChargeSource {
    /// Topic.
    pub topic: String,
    /// Type of its messages. Default `sensor_msgs/msg/BatteryState`.
    #[serde(default = "battery_state", rename = "type")]
    pub type_name: String,
    /// Path of the charge, a share from 0 to 1. Default `percentage`.
    #[serde(default = "percentage")]
    pub field: String,
    /// Factor to a share: 0.01 for a charge in percent. Default 1.
    #[serde(default = "one")]
    pub factor: f64,
    /// Charge below which the robot cannot move. Default 0.05.
    #[serde(default = "able_above")]
    pub able_above: f64,
}

/// A field of the messages of a topic.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FieldSource {
    /// Topic.
    pub topic: String,
    /// Type of its messages.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Path of the field: `data`, `status[name=motor].values[key=temp].value`.
    pub field: String,
    /// Type of the reading, if it differs from that of the field.
    #[serde(default, rename = "as", skip_serializing_if = "Option::is_none")]
    pub convert: Option<Conversion>,
}

/// Type of a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Conversion {
    /// A number, also from a text.
    Number,
    /// A whole number, also from a text or another number, which is rounded.
    Integer,
    /// A text.
    Text,
    /// A boolean, also from a number (not 0) or the texts `true` and `false`.
    Boolean,
}

/// Mapping of an action: exactly one of `action`, `service` and `topic`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ActionMapping {
    /// Description for people.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub description: String,
    /// ROS action that executes the goal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub action: Option<String>,
    /// Service that executes the goal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub service: Option<String>,
    /// Topic on which the goal is published.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub topic: Option<String>,
    /// Type of the action, the service or the messages.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Template of the goal, the request or the message. `${name}` is a parameter.
    #[serde(skip_serializing_if = "Value::is_null")]
    pub send: Value,
    /// Paths of fields in the feedback of an action, by the value that they give: `distance_remaining_m`,
    /// `time_remaining_s`, `pose`, or a value that the domain file declares.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub feedback: BTreeMap<String, String>,
    /// Paths of fields in the result or the response, by the result that the domain file declares.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub results: BTreeMap<String, String>,
    /// Path of a boolean in the result or the response that is false after a failure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub succeeded: Option<String>,
    /// Path of the number or text of the error in the result. Default `error_code`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error_code: Option<String>,
    /// Path of the text of the error in the result. Default `error_msg`, then `message`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error_message: Option<String>,
    /// Reasons of failures by error: a failure that the domain file declares, or a standard code.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub failures: BTreeMap<String, String>,
    /// Time limit of a service or of `until`, in seconds. Default 10.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub within_s: Option<f64>,
    /// Value of a topic that ends the goal, after a message or a service has been sent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub until: Option<Until>,
    /// The goal of a topic lasts until its cancel, as that of a door: the message is repeated meanwhile.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hold: Option<Hold>,
    /// Parameters with which `consort driver check` tries the action: a goal of about 2 s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub example: Option<JsonObject>,
}

/// Value of a topic that ends a goal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Until {
    /// Topic.
    pub topic: String,
    /// Type of its messages.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Path of the field.
    pub field: String,
    /// The value; it may contain `${name}`.
    pub equals: Value,
}

/// A goal that lasts until its cancel. Its feedback is the value `ready`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Hold {
    /// Template of the message at the end of the goal. It is repeated until `released` holds, for `within_s`
    /// at most.
    pub release: Value,
    /// Interval at which the messages are repeated, in seconds. Default 1.
    #[serde(default = "one")]
    pub repeat_s: f64,
    /// Topic with the state.
    pub topic: String,
    /// Type of its messages.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Values of the messages about this device, by the path of their field. Other messages are ignored.
    #[serde(default)]
    pub of: BTreeMap<String, Value>,
    /// Values with which the device is ready, by the path of their field.
    pub ready: BTreeMap<String, Value>,
    /// Values with which the device is released, by the path of their field. Without them, it is at once.
    #[serde(default)]
    pub released: BTreeMap<String, Value>,
    /// Age of the latest state from which the device is not ready, in seconds. Default 5.
    #[serde(default = "five")]
    pub stale_s: f64,
}

fn battery_state() -> String {
    "sensor_msgs/msg/BatteryState".to_owned()
}

fn percentage() -> String {
    "percentage".to_owned()
}

fn one() -> f64 {
    1.0
}

fn five() -> f64 {
    5.0
}

fn able_above() -> f64 {
    0.05
}

/// Kind of the endpoint that executes an action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Via<'a> {
    /// An action.
    Action(&'a str),
    /// A service.
    Service(&'a str),
    /// A topic.
    Topic(&'a str),
}

impl ActionMapping {
    /// Returns the endpoint; `None` if the mapping has none or several.
    pub fn via(&self) -> Option<Via<'_>> {
        match (&self.action, &self.service, &self.topic) {
            (Some(name), None, None) => Some(Via::Action(name)),
            (None, Some(name), None) => Some(Via::Service(name)),
            (None, None, Some(name)) => Some(Via::Topic(name)),
            _ => None,
        }
    }

    /// Returns the type of the message that is sent.
    pub fn sent_type(&self) -> String {
        let part = match self.via() {
            Some(Via::Action(_)) => "_Goal",
            Some(Via::Service(_)) => "_Request",
            _ => "",
        };
        format!("{}{part}", self.type_name)
    }

    /// Returns the type of the result or the response; `None` for a topic.
    pub fn result_type(&self) -> Option<String> {
        match self.via()? {
            Via::Action(_) => Some(format!("{}_Result", self.type_name)),
            Via::Service(_) => Some(format!("{}_Response", self.type_name)),
            Via::Topic(_) => None,
        }
    }
}

impl RobotDescription {
    /// Returns the frame of the map.
    pub fn frame(&self) -> &str {
        if self.map_frame.is_empty() { "map" } else { &self.map_frame }
    }

    /// Returns the namespace with a leading slash; empty for none.
    pub fn namespace(&self) -> String {
        match self.namespace.trim_matches('/') {
            "" => String::new(),
            namespace => format!("/{namespace}"),
        }
    }

    /// Returns the shipped definitions and those of the folders.
    ///
    /// # Errors
    /// [`DescriptionError`] if a folder cannot be read, or a definition is invalid.
    pub fn definitions(&self) -> Result<TypeRegistry, DescriptionError> {
        let mut types = TypeRegistry::shipped();
        for folder in &self.types {
            let unreadable = |path: &Path, problem: std::io::Error| DescriptionError::Read {
                path: path.to_owned(),
                problem: problem.to_string(),
            };
            let mut files = vec![];
            for kind in ["msg", "srv", "action"] {
                let packages = std::fs::read_dir(folder).map_err(|problem| unreadable(folder, problem))?;
                for package in packages.flatten() {
                    let entries = std::fs::read_dir(package.path().join(kind)).into_iter().flatten().flatten();
                    files.extend(entries.map(|entry| (package.file_name(), kind, entry.path())));
                }
            }
            files.sort();
            for (package, kind, path) in files {
                let (Some(stem), true) = (path.file_stem(), path.extension().is_some_and(|end| end == kind)) else {
                    continue;
                };
                let text = std::fs::read_to_string(&path).map_err(|problem| unreadable(&path, problem))?;
                let name = format!("{}/{kind}/{}", package.to_string_lossy(), stem.to_string_lossy());
                types.define(&name, &text)?;
            }
        }
        Ok(types)
    }
}

/// A description cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DescriptionError {
    /// A file cannot be read.
    #[error("{}: {problem}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        problem: String,
    },
    /// The file is no description.
    #[error("{file}: {problem}")]
    Syntax {
        /// The file.
        file: String,
        /// The problem, with its line.
        problem: String,
    },
    /// The descriptions extend each other without end.
    #[error("{0}: more than {EXTENDS_DEPTH} descriptions extend each other")]
    Depth(String),
    /// A definition is invalid.
    #[error(transparent)]
    Type(#[from] TypeError),
}

/// Reads a description and those that it extends: a file, or the name of a shipped one.
///
/// # Errors
/// [`DescriptionError`] with the file and the place.
pub fn load(name: &str) -> Result<RobotDescription, DescriptionError> {
    let merged = merged(name, Path::new(""), 0)?;
    let syntax =
        |problem: serde_json::Error| DescriptionError::Syntax { file: name.to_owned(), problem: problem.to_string() };
    serde_json::from_value(Value::Object(merged)).map_err(syntax)
}

fn merged(name: &str, folder: &Path, depth: usize) -> Result<Map<String, Value>, DescriptionError> {
    if depth > EXTENDS_DEPTH {
        return Err(DescriptionError::Depth(name.to_owned()));
    }
    let (text, file) = match SHIPPED.iter().find(|(shipped, _)| *shipped == name) {
        Some((_, text)) => ((*text).to_owned(), PathBuf::from(name)),
        None => {
            let path = folder.join(name);
            let read = std::fs::read_to_string(&path);
            let unreadable = |problem: std::io::Error| {
                let names: Vec<&str> = SHIPPED.iter().map(|(name, _)| *name).collect();
                let problem = format!("{problem}; allowed is a file, or one of {}", names.join(", "));
                DescriptionError::Read { path: path.clone(), problem }
            };
            (read.map_err(unreadable)?, path)
        }
    };
    let syntax = |problem: String| DescriptionError::Syntax { file: file.display().to_string(), problem };
    // The typed form has the errors with their lines.
    let mut own: RobotDescription = serde_saphyr::from_str(&text).map_err(|problem| syntax(problem.to_string()))?;
    let here = file.parent().unwrap_or(Path::new(""));
    own.types = own.types.iter().map(|types| here.join(types)).collect();
    let mut result = Map::new();
    for extended in std::mem::take(&mut own.extends) {
        merge(&mut result, merged(&extended, here, depth + 1)?);
    }
    let own = serde_json::to_value(own).map_err(|problem| syntax(problem.to_string()))?;
    let Value::Object(mut own) = own else { return Ok(result) };
    own.retain(|_, value| match value {
        Value::Bool(value) => *value,
        Value::String(text) => !text.is_empty(),
        Value::Array(items) => !items.is_empty(),
        _ => true,
    });
    merge(&mut result, own);
    Ok(result)
}

/// Adds the entries of another description. Actions, readings and tables are replaced by name.
fn merge(into: &mut Map<String, Value>, other: Map<String, Value>) {
    for (key, value) in other {
        let Some(old) = into.get_mut(&key) else {
            into.insert(key, value);
            continue;
        };
        match (old, value) {
            (Value::Object(entries), Value::Object(more))
                if matches!(key.as_str(), "actions" | "readings" | "tables") =>
            {
                entries.extend(more);
            }
            (Value::Array(folders), Value::Array(more)) if key == "types" => folders.extend(more),
            (old, value) => *old = value,
        }
    }
}

/// Returns the JSON Schema of a description.
pub fn schema() -> Value {
    schema_for!(RobotDescription).to_value()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_description_replaces_by_name_what_it_extends() {
        let turtlebot = load("turtlebot").unwrap();
        assert!(turtlebot.actions.contains_key("dock"), "of nav2");
        assert_eq!(turtlebot.charge.as_ref().unwrap().field, "percentage");
        let folder = std::env::temp_dir().join(format!("consort-ros2-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("robot.yaml");
        let text = "extends: [turtlebot]\nactions:\n  dock: { service: dock, type: std_srvs/srv/Trigger }\n";
        std::fs::write(&path, text).unwrap();
        let robot = load(&path.display().to_string()).unwrap();
        assert_eq!(robot.actions["dock"].via(), Some(Via::Service("dock")));
        assert_eq!((robot.actions.len(), &robot.readings), (turtlebot.actions.len(), &turtlebot.readings));
        std::fs::write(&path, "actoins: {}\n").unwrap();
        let error = load(&path.display().to_string()).unwrap_err().to_string();
        assert!(error.contains("robot.yaml") && error.contains("actoins") && error.contains("actions"), "{error}");
        assert!(load("nav3").unwrap_err().to_string().contains("allowed is a file, or one of nav2, nav2_moves"));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
