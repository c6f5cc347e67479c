//! What a robot reports: its pose, its charge and its readings, from messages of topics.

use super::description::{ChargeSource, Conversion, PoseSource, RobotDescription};
use super::path::{FieldPath, PathError};
use crate::mapping;
use crate::messages::{Header, PoseStamped};
use consort_driver::DriverMessage;
use consort_protocol::pose::Pose;
use consort_protocol::scalar::Scalar;
use consort_protocol::units::BatteryShare;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Type of the messages with transforms.
pub const TRANSFORMS: &str = "tf2_msgs/msg/TFMessage";

/// Longest chain of transforms.
const CHAIN_MAX: usize = 32;

/// A topic that reports need.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topic {
    /// Name, without the namespace.
    pub name: String,
    /// Type.
    pub type_name: String,
}

#[derive(Debug)]
enum Purpose {
    Pose(FieldPath),
    Transforms,
    Charge(FieldPath, ChargeSource),
    Reading(String, FieldPath, Option<Conversion>),
}

/// The latest reports of a robot.
#[derive(Debug)]
pub struct Reports {
    purposes: Vec<(Topic, Purpose)>,
    frame: String,
    body: String,
    transforms: BTreeMap<String, (String, Pose)>,
    pose: Option<Pose>,
    charge: Option<(f64, bool)>,
    readings: BTreeMap<String, Scalar>,
    changed: BTreeMap<String, Scalar>,
}

impl Reports {
    /// Creates the reports of a description.
    ///
    /// # Errors
    /// [`PathError`] of a path.
    pub fn new(robot: &RobotDescription) -> Result<Reports, PathError> {
        let topic = |name: &str, type_name: &str| Topic { name: name.to_owned(), type_name: type_name.to_owned() };
        let mut purposes = vec![];
        let mut body = String::new();
        match &robot.pose {
            Some(PoseSource { topic: Some(name), type_name: Some(type_name), field, .. }) => {
                let path = FieldPath::parse(field.as_deref().unwrap_or("pose.pose"))?;
                purposes.push((topic(name, type_name), Purpose::Pose(path)));
            }
            Some(PoseSource { tf: Some(frame), .. }) => {
                body.clone_from(frame);
                for name in ["/tf", "/tf_static"] {
                    purposes.push((topic(name, TRANSFORMS), Purpose::Transforms));
                }
            }
            _ => {}
        }
        if let Some(charge) = &robot.charge {
            let path = FieldPath::parse(&charge.field)?;
            purposes.push((topic(&charge.topic, &charge.type_name), Purpose::Charge(path, charge.clone())));
        }
        for (name, reading) in &robot.readings {
            let purpose = Purpose::Reading(name.clone(), FieldPath::parse(&reading.field)?, reading.convert);
            purposes.push((topic(&reading.topic, &reading.type_name), purpose));
        }
        // Without a source, the battery counts as full.
        let charge = robot.charge.is_none().then_some((1.0, true));
        let (transforms, pose, frame) = (BTreeMap::new(), None, robot.frame().to_owned());
        let (readings, changed) = (BTreeMap::new(), BTreeMap::new());
        Ok(Reports { purposes, frame, body, transforms, pose, charge, readings, changed })
    }

    /// Returns the topics, in the order of their numbers.
    pub fn topics(&self) -> impl Iterator<Item = &Topic> {
        self.purposes.iter().map(|(topic, _)| topic)
    }

    /// Replaces the pose, for a robot whose description has no source of it.
    pub fn set_pose(&mut self, pose: Pose) {
        let has_source =
            self.purposes.iter().any(|(_, purpose)| matches!(purpose, Purpose::Pose(_) | Purpose::Transforms));
        if !has_source {
            self.pose = Some(pose);
        }
    }

    /// Handles a message of the topic with a number. Fields that are missing, or have no value, change
    /// nothing.
    pub fn handle(&mut self, number: usize, message: &Value) {
        match self.purposes.get(number).map(|(_, purpose)| purpose) {
            Some(Purpose::Pose(path)) => self.pose = path.get(message).and_then(to_pose).or(self.pose),
            Some(Purpose::Transforms) => {
                let transforms = message["transforms"].as_array().into_iter().flatten();
                let named = transforms.filter_map(transform);
                self.transforms.extend(named);
                self.pose = self.chain().or(self.pose);
            }
            Some(Purpose::Charge(path, source)) => {
                let share = path.get(message).and_then(Value::as_f64).map(|value| value * source.factor);
                if let Some(share) = share.filter(|share| (0.0..=1.001).contains(share)) {
                    self.charge = Some((share.min(1.0), share >= source.able_above));
                }
            }
            Some(Purpose::Reading(name, path, conversion)) => {
                let value = path.get(message).and_then(|value| converted(value, *conversion));
                if let Some(value) = value
                    && self.readings.get(name) != Some(&value)
                {
                    self.readings.insert(name.clone(), value.clone());
                    self.changed.insert(name.clone(), value);
                }
            }
            None => {}
        }
    }

    /// Returns the transform of the body to the map.
    fn chain(&self) -> Option<Pose> {
        let (mut frame, mut pose) = (&self.body, Pose::new(0.0, 0.0, 0.0));
        for _ in 0..CHAIN_MAX {
            let (parent, step) = self.transforms.get(frame)?;
            let (sin, cos) = step.yaw.sin_cos();
            let (x, y) = (step.x + cos * pose.x - sin * pose.y, step.y + sin * pose.x + cos * pose.y);
            pose = Pose::new(x, y, step.yaw + pose.yaw);
            if *parent == self.frame {
                return Some(pose);
            }
            frame = parent;
        }
        None
    }

    /// Returns the messages about pose and charge, and about the readings that have changed.
    pub fn messages(&mut self) -> Vec<DriverMessage> {
        let mut messages = vec![];
        if let Some(pose) = self.pose {
            messages.push(DriverMessage::Pose { x_m: pose.x, y_m: pose.y, yaw_rad: pose.yaw, place: None });
        }
        if let Some((share, able)) = self.charge
            && let Ok(share) = BatteryShare::new(share)
        {
            messages.push(DriverMessage::Charge { share, able });
        }
        let values = std::mem::take(&mut self.changed);
        if !values.is_empty() {
            messages.push(DriverMessage::Readings { values });
        }
        messages
    }
}

/// Converts a `geometry_msgs/msg/Pose`.
pub(super) fn to_pose(value: &Value) -> Option<Pose> {
    let pose = serde_json::from_value(value.clone()).ok()?;
    mapping::from_ros(&PoseStamped { header: Header::default(), pose }).ok()
}

fn transform(stamped: &Value) -> Option<(String, (String, Pose))> {
    let name = |value: &Value| Some(value.as_str()?.trim_start_matches('/').to_owned());
    let (translation, rotation) = (&stamped["transform"]["translation"], &stamped["transform"]["rotation"]);
    let pose = to_pose(&json!({"position": translation, "orientation": rotation}))?;
    Some((name(&stamped["child_frame_id"])?, (name(&stamped["header"]["frame_id"])?, pose)))
}

/// Converts a value to a reading; `None` if it is none.
fn converted(value: &Value, to: Option<Conversion>) -> Option<Scalar> {
    let number =
        || value.as_f64().or_else(|| value.as_str()?.trim().parse().ok()).filter(|number: &f64| number.is_finite());
    match to {
        None => Scalar::from_json(value),
        Some(Conversion::Number) => number().map(Scalar::Number),
        Some(Conversion::Integer) => number().map(|number| Scalar::Integer(number.round() as i64)),
        Some(Conversion::Text) => Some(Scalar::Text(value.as_str().map_or_else(|| value.to_string(), str::to_owned))),
        Some(Conversion::Boolean) => match value {
            Value::Bool(value) => Some(Scalar::Bool(*value)),
            Value::String(text) => text.trim().to_lowercase().parse().ok().map(Scalar::Bool),
            value => value.as_f64().map(|number| Scalar::Bool(number != 0.0)),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reports(text: &str) -> Reports {
        Reports::new(&serde_saphyr::from_str(text).unwrap()).unwrap()
    }

    #[test]
    fn charge_and_readings_come_from_fields() {
        let mut reports = reports(
            "charge: { topic: battery, field: percentage, factor: 0.01 }
readings:
  temp_c: { topic: /diagnostics, type: diagnostic_msgs/msg/DiagnosticArray, field: 'status[name=motor].values[key=temp].value', as: number }
  stop: { topic: stop, type: std_msgs/msg/Bool, field: data }",
        );
        let topics: Vec<&str> = reports.topics().map(|topic| topic.name.as_str()).collect();
        assert_eq!(topics, ["battery", "stop", "/diagnostics"]);
        assert_eq!(reports.messages(), [], "nothing is known");
        reports.handle(0, &json!({"percentage": null}));
        assert_eq!(reports.messages(), [], "a battery that does not measure its charge");
        reports.handle(0, &json!({"percentage": 4.0}));
        reports.handle(1, &json!({"data": true}));
        reports.handle(2, &json!({"status": [{"name": "motor", "values": [{"key": "temp", "value": " 41.5"}]}]}));
        let charge = DriverMessage::Charge { share: BatteryShare::new(0.04).unwrap(), able: false };
        let values = [("stop".to_owned(), Scalar::Bool(true)), ("temp_c".to_owned(), Scalar::Number(41.5))];
        assert_eq!(reports.messages(), [charge.clone(), DriverMessage::Readings { values: values.into() }]);
        reports.handle(1, &json!({"data": true}));
        assert_eq!(reports.messages(), [charge], "only changes are repeated");
    }

    #[test]
    fn a_pose_is_a_chain_of_transforms() {
        let mut reports = reports("pose: { tf: base_link }");
        let step = |parent: &str, child: &str, x: f64, z: f64, w: f64| {
            json!({"header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": parent}, "child_frame_id": child, "transform": {
                "translation": {"x": x, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": z, "w": w}}})
        };
        let quarter = std::f64::consts::FRAC_PI_4.sin_cos();
        reports.handle(0, &json!({"transforms": [step("odom", "base_link", 1.0, 0.0, 1.0)]}));
        assert!(reports.messages().iter().all(|message| !matches!(message, DriverMessage::Pose { .. })));
        reports.handle(1, &json!({"transforms": [step("map", "odom", 5.0, quarter.0, quarter.1)]}));
        let DriverMessage::Pose { x_m, y_m, yaw_rad, .. } = reports.messages()[0].clone() else { panic!("a pose") };
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
        assert!(
            near(x_m, 5.0) && near(y_m, 1.0) && near(yaw_rad, std::f64::consts::FRAC_PI_2),
            "{x_m} {y_m} {yaw_rad}"
        );
    }
}
