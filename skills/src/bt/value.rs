//! Values on the blackboard, their types, and conversion from text.

use consort_protocol::ids::{PlaceId, RobotId, RoleId};
use consort_protocol::pose::Pose;
use consort_protocol::scalar::Scalar;
use consort_protocol::units::Seconds;
use std::fmt;

/// A value of a port.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// Any text.
    Text(String),
    /// A finite number without a unit.
    Number(f64),
    /// A whole number.
    Integer(i64),
    /// True or false.
    Bool(bool),
    /// A place on the map.
    Place(PlaceId),
    /// A robot.
    Robot(RobotId),
    /// A role of the mission.
    Role(RoleId),
    /// A pose on the floor; as text `x;y;yaw` in metres and radians.
    Pose(Pose),
    /// A duration of world time; as text the number of seconds without a unit.
    Seconds(Seconds),
    /// Several values in order; as text separated by `;`.
    List(Vec<Value>),
}

/// Type of a port or of a blackboard entry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum PortType {
    /// Any type.
    Any,
    /// [`Value::Text`].
    Text,
    /// [`Value::Number`].
    Number,
    /// [`Value::Integer`].
    Integer,
    /// [`Value::Bool`].
    Bool,
    /// [`Value::Place`].
    Place,
    /// [`Value::Robot`].
    Robot,
    /// [`Value::Role`].
    Role,
    /// [`Value::Pose`].
    Pose,
    /// [`Value::Seconds`].
    Seconds,
    /// [`Value::List`].
    List,
}

/// Greatest number up to which every whole number is exact: 2^53.
const MAX_EXACT: f64 = 9_007_199_254_740_992.0;

/// A value was rejected. Nothing was changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ValueError {
    /// The value is not of the requested type.
    #[error("{value:?} is not {wanted}: {problem}")]
    Type {
        /// The value, as text.
        value: String,
        /// The requested type.
        wanted: PortType,
        /// Cause, or the allowed values.
        problem: String,
    },
    /// The value has the right type, but is not allowed.
    #[error("{value:?} is rejected: {allowed}")]
    NotAllowed {
        /// The value, as text.
        value: String,
        /// The allowed values, as text.
        allowed: String,
    },
}

impl PortType {
    /// Name in a written model (`type="place"`).
    pub const fn name(self) -> &'static str {
        match self {
            PortType::Any => "any",
            PortType::Text => "text",
            PortType::Number => "number",
            PortType::Integer => "integer",
            PortType::Bool => "bool",
            PortType::Place => "place",
            PortType::Robot => "robot",
            PortType::Role => "role",
            PortType::Pose => "pose",
            PortType::Seconds => "seconds",
            PortType::List => "list",
        }
    }

    /// Parses `text` as a value of this type; [`PortType::Any`] keeps it as text.
    ///
    /// # Errors
    /// [`ValueError`] with the text and the allowed values.
    pub fn parse(self, text: &str) -> Result<Value, ValueError> {
        let reject = |problem: String| ValueError::Type { value: text.to_owned(), wanted: self, problem };
        let number = |text: &str| match text.trim().parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(reject("allowed is a finite number such as 2.5".to_owned())),
        };
        Ok(match self {
            PortType::Any | PortType::Text => Value::Text(text.to_owned()),
            PortType::Number => Value::Number(number(text)?),
            PortType::Integer => {
                let parsed = text.trim().parse();
                Value::Integer(parsed.map_err(|_| reject("allowed is a whole number such as 3".to_owned()))?)
            }
            PortType::Bool => match text.trim() {
                "true" | "1" => Value::Bool(true),
                "false" | "0" => Value::Bool(false),
                _ => return Err(reject("allowed are true and false".to_owned())),
            },
            PortType::Place => Value::Place(PlaceId::new(text).map_err(|e| reject(e.to_string()))?),
            PortType::Robot => Value::Robot(RobotId::new(text).map_err(|e| reject(e.to_string()))?),
            PortType::Role => Value::Role(RoleId::new(text).map_err(|e| reject(e.to_string()))?),
            PortType::Pose => {
                let parts: Vec<f64> = text.split(';').map(number).collect::<Result<_, _>>()?;
                let [x, y, yaw] = parts[..] else {
                    return Err(reject("allowed is `x;y;yaw` in metres and radians".to_owned()));
                };
                Value::Pose(Pose::new(x, y, yaw))
            }
            PortType::Seconds => Value::Seconds(Seconds::new(number(text)?).map_err(|e| reject(e.to_string()))?),
            PortType::List if text.is_empty() => Value::List(Vec::new()),
            PortType::List => Value::List(text.split(';').map(|part| Value::Text(part.to_owned())).collect()),
        })
    }

    /// Returns the type of an entry that ports of both types share. Text joins with any type (it is
    /// parsed or printed on conversion), and so does [`PortType::Any`]. `None` if the types
    /// conflict.
    pub(crate) fn join(self, other: PortType) -> Option<PortType> {
        match (self, other) {
            (PortType::Any, ty) | (ty, PortType::Any) | (PortType::Text, ty) | (ty, PortType::Text) => Some(ty),
            (a, b) if a == b => Some(a),
            _ => None,
        }
    }
}

impl fmt::Display for PortType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            PortType::Any => "any value",
            PortType::Text => "a text",
            PortType::Number => "a number",
            PortType::Integer => "a whole number",
            PortType::Bool => "true or false",
            PortType::Place => "a place",
            PortType::Robot => "a robot",
            PortType::Role => "a role",
            PortType::Pose => "a pose",
            PortType::Seconds => "a duration in seconds",
            PortType::List => "a list",
        })
    }
}

impl Value {
    /// Type of the value.
    pub(crate) fn port_type(&self) -> PortType {
        match self {
            Value::Text(_) => PortType::Text,
            Value::Number(_) => PortType::Number,
            Value::Integer(_) => PortType::Integer,
            Value::Bool(_) => PortType::Bool,
            Value::Place(_) => PortType::Place,
            Value::Robot(_) => PortType::Robot,
            Value::Role(_) => PortType::Role,
            Value::Pose(_) => PortType::Pose,
            Value::Seconds(_) => PortType::Seconds,
            Value::List(_) => PortType::List,
        }
    }

    /// Converts the value: text is parsed, every value can be printed as text, an integer is also a
    /// number, and a number is also an integer or a duration if it is a whole number or not
    /// negative.
    ///
    /// # Errors
    /// [`ValueError`] if the value is of another type or its text does not parse.
    pub fn convert(self, wanted: PortType) -> Result<Value, ValueError> {
        match (self, wanted) {
            (value, PortType::Any) => Ok(value),
            (value, wanted) if value.port_type() == wanted => Ok(value),
            (Value::Text(text), wanted) => wanted.parse(&text),
            (value, PortType::Text) => Ok(Value::Text(value.to_string())),
            // Exact up to 2^53, far above any count in a tree.
            (Value::Integer(n), PortType::Number) => Ok(Value::Number(n as f64)),
            (Value::Number(n), PortType::Integer) if n.fract() == 0.0 && n.abs() <= MAX_EXACT => {
                Ok(Value::Integer(n as i64))
            }
            (Value::Number(n), PortType::Seconds) => PortType::Seconds.parse(&n.to_string()),
            (value, wanted) => {
                let problem = format!("it is {}", value.port_type());
                Err(ValueError::Type { value: value.to_string(), wanted, problem })
            }
        }
    }
}

impl From<Scalar> for Value {
    fn from(value: Scalar) -> Value {
        match value {
            Scalar::Bool(value) => Value::Bool(value),
            Scalar::Integer(number) => Value::Integer(number),
            Scalar::Number(number) => Value::Number(number),
            Scalar::Text(text) => Value::Text(text),
        }
    }
}

impl From<&Value> for Scalar {
    /// Names, poses and lists become texts, durations numbers.
    fn from(value: &Value) -> Scalar {
        Scalar::from_json(&value.to_json()).unwrap_or_else(|| Scalar::Text(value.to_string()))
    }
}

impl Value {
    /// Returns the value as JSON: names are texts, a duration is its number of seconds.
    pub fn to_json(&self) -> serde_json::Value {
        match self {
            Value::Text(text) => text.as_str().into(),
            Value::Number(number) => (*number).into(),
            Value::Integer(number) => (*number).into(),
            Value::Bool(yes) => (*yes).into(),
            Value::Place(place) => place.as_str().into(),
            Value::Robot(robot) => robot.as_str().into(),
            Value::Role(role) => role.as_str().into(),
            Value::Pose(pose) => serde_json::json!({ "x": pose.x, "y": pose.y, "yaw": pose.yaw }),
            Value::Seconds(time) => time.get().into(),
            Value::List(values) => values.iter().map(Value::to_json).collect(),
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Value::Text(text) => f.write_str(text),
            Value::Number(number) => write!(f, "{number}"),
            Value::Integer(number) => write!(f, "{number}"),
            Value::Bool(yes) => write!(f, "{yes}"),
            Value::Place(place) => write!(f, "{place}"),
            Value::Robot(robot) => write!(f, "{robot}"),
            Value::Role(role) => write!(f, "{role}"),
            Value::Pose(pose) => write!(f, "{};{};{}", pose.x, pose.y, pose.yaw),
            Value::Seconds(time) => write!(f, "{}", time.get()),
            Value::List(values) => {
                for (i, value) in values.iter().enumerate() {
                    write!(f, "{}{value}", if i == 0 { "" } else { ";" })?;
                }
                Ok(())
            }
        }
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Value {
        Value::Text(text.to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_type_round_trips_through_text() {
        let values = [
            Value::from("a b"),
            Value::Number(-2.5),
            Value::Integer(-7),
            Value::Bool(true),
            Value::Place(PlaceId::new("IC Room 6").unwrap()),
            Value::Robot(RobotId::new("r1").unwrap()),
            Value::Role(RoleId::new("nurse").unwrap()),
            Value::Pose(Pose::new(1.0, -2.5, 1.5)),
            Value::Seconds(Seconds::new(2.0).unwrap()),
            Value::List(vec![Value::from("a"), Value::from("b")]),
            Value::List(Vec::new()),
        ];
        for value in values {
            assert_eq!(value.port_type().parse(&value.to_string()).unwrap(), value);
        }
    }

    #[test]
    fn invalid_text_is_reported_with_the_allowed_form() {
        let error = PortType::Pose.parse("1;2").unwrap_err().to_string();
        assert_eq!(error, "\"1;2\" is not a pose: allowed is `x;y;yaw` in metres and radians");
        for (ty, text) in [
            (PortType::Number, "NaN"),
            (PortType::Number, "inf"),
            (PortType::Integer, "1.5"),
            (PortType::Bool, "yes"),
            (PortType::Robot, "a/b"),
            (PortType::Place, ""),
            (PortType::Seconds, "-1"),
        ] {
            assert!(ty.parse(text).is_err(), "{ty} {text}");
        }
    }

    #[test]
    fn a_value_of_another_type_is_rejected_but_prints_as_text() {
        let pose = Value::Pose(Pose::new(1.0, 2.0, 0.0));
        assert_eq!(pose.clone().convert(PortType::Text).unwrap(), Value::from("1;2;0"));
        assert_eq!(pose.convert(PortType::Place).unwrap_err().to_string(), "\"1;2;0\" is not a place: it is a pose");
    }
}
