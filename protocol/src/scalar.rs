//! Scalars: booleans, numbers and texts that keep their type.

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;

/// Maximum size of a text as a result, an attribute or a reading, in bytes.
pub const SCALAR_BYTES_MAX: usize = 256;

/// Maximum size of the name of an attribute or a reading, in bytes.
pub const NAME_BYTES_MAX: usize = 64;

/// A boolean, a number or a text: value of a result of a task, or of an attribute or a reading of a robot.
#[derive(Debug, Clone, PartialEq)]
pub enum Scalar {
    /// `true` or `false`.
    Bool(bool),
    /// Whole number.
    Integer(i64),
    /// Finite number.
    Number(f64),
    /// Text.
    Text(String),
}

/// Form of a value in messages and in the ledger.
#[derive(Serialize, Deserialize)]
enum BinaryValue<'a> {
    Bool(bool),
    Integer(i64),
    Number(f64),
    Text(Cow<'a, str>),
}

impl Scalar {
    /// Returns the value of a JSON scalar; `None` for anything else, and for numbers that are not
    /// finite.
    pub fn from_json(value: &serde_json::Value) -> Option<Scalar> {
        match value {
            serde_json::Value::Bool(value) => Some(Scalar::Bool(*value)),
            serde_json::Value::Number(number) => match number.as_i64() {
                Some(number) => Some(Scalar::Integer(number)),
                None => number.as_f64().filter(|number| number.is_finite()).map(Scalar::Number),
            },
            serde_json::Value::String(text) => Some(Scalar::Text(text.clone())),
            serde_json::Value::Null | serde_json::Value::Array(_) | serde_json::Value::Object(_) => None,
        }
    }
}

impl fmt::Display for Scalar {
    /// The value as the text of a parameter.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Scalar::Bool(value) => value.fmt(f),
            Scalar::Integer(number) => number.fmt(f),
            Scalar::Number(number) => number.fmt(f),
            Scalar::Text(text) => f.write_str(text),
        }
    }
}

impl Serialize for Scalar {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            return match self {
                Scalar::Bool(value) => serializer.serialize_bool(*value),
                Scalar::Integer(number) => serializer.serialize_i64(*number),
                Scalar::Number(number) => serializer.serialize_f64(*number),
                Scalar::Text(text) => serializer.serialize_str(text),
            };
        }
        let binary = match self {
            Scalar::Bool(value) => BinaryValue::Bool(*value),
            Scalar::Integer(number) => BinaryValue::Integer(*number),
            Scalar::Number(number) => BinaryValue::Number(*number),
            Scalar::Text(text) => BinaryValue::Text(text.into()),
        };
        binary.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Scalar {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Scalar, D::Error> {
        if deserializer.is_human_readable() {
            let value = serde_json::Value::deserialize(deserializer)?;
            return Scalar::from_json(&value)
                .ok_or_else(|| de::Error::custom(format_args!("{value}; allowed is a boolean, a number or a text")));
        }
        match BinaryValue::deserialize(deserializer)? {
            BinaryValue::Bool(value) => Ok(Scalar::Bool(value)),
            BinaryValue::Integer(number) => Ok(Scalar::Integer(number)),
            BinaryValue::Number(number) if number.is_finite() => Ok(Scalar::Number(number)),
            BinaryValue::Number(number) => Err(de::Error::custom(format_args!("{number} is not finite"))),
            BinaryValue::Text(text) => Ok(Scalar::Text(text.into_owned())),
        }
    }
}

impl JsonSchema for Scalar {
    fn schema_name() -> Cow<'static, str> {
        "Scalar".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": ["boolean", "number", "string"], "description": "A boolean, a number or a text" })
    }
}

/// Error: attributes or readings are invalid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NamedScalarsError {
    /// A name is invalid.
    #[error(
        "the {what} `{name}` has an invalid name; allowed are 1 to {NAME_BYTES_MAX} letters, digits and `_`, and no digit at the beginning"
    )]
    Name {
        /// `attribute` or `reading`.
        what: &'static str,
        /// The name.
        name: String,
    },
    /// A text is too long.
    #[error("the {what} `{name}` is a text of {bytes} bytes; at most {SCALAR_BYTES_MAX} are allowed")]
    LongText {
        /// `attribute` or `reading`.
        what: &'static str,
        /// Name of the value.
        name: String,
        /// Size of the value.
        bytes: usize,
    },
    /// There are too many values.
    #[error("{found} {what}s; at most {max} are allowed")]
    TooMany {
        /// `attribute` or `reading`.
        what: &'static str,
        /// Number found.
        found: usize,
        /// Number allowed.
        max: usize,
    },
}

/// Checks the number, the names and the sizes of values that another process has sent. `what` names
/// such a value in errors.
///
/// # Errors
/// The first problem.
pub fn check_named_scalars(
    what: &'static str,
    values: &BTreeMap<String, Scalar>,
    max: usize,
) -> Result<(), NamedScalarsError> {
    if values.len() > max {
        return Err(NamedScalarsError::TooMany { what, found: values.len(), max });
    }
    for (name, value) in values {
        if !is_identifier(name) {
            return Err(NamedScalarsError::Name { what, name: name.chars().take(80).collect() });
        }
        if let Scalar::Text(text) = value
            && text.len() > SCALAR_BYTES_MAX
        {
            return Err(NamedScalarsError::LongText { what, name: name.clone(), bytes: text.len() });
        }
    }
    Ok(())
}

/// Checks whether a name can be used in scripts and in CEL.
fn is_identifier(name: &str) -> bool {
    let is_part = |c: char| c.is_ascii_alphanumeric() || c == '_';
    (1..=NAME_BYTES_MAX).contains(&name.len())
        && name.chars().all(is_part)
        && !name.starts_with(|c: char| c.is_ascii_digit())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec;

    fn values() -> [Scalar; 5] {
        let text = |text: &str| Scalar::Text(text.to_owned());
        [Scalar::Bool(true), Scalar::Integer(-3), Scalar::Number(0.1), text("12"), text("")]
    }

    #[test]
    fn values_keep_their_type_in_messages_and_in_json() {
        for value in values() {
            assert_eq!(codec::decode::<Scalar>(&codec::encode(&value).unwrap()).unwrap(), value);
            let json = serde_json::to_string(&value).unwrap();
            assert_eq!(serde_json::from_str::<Scalar>(&json).unwrap(), value, "{json}");
        }
    }

    #[test]
    fn other_values_are_rejected() {
        let infinite = codec::encode(&BinaryValue::Number(f64::INFINITY)).unwrap();
        assert!(codec::decode::<Scalar>(&infinite).is_err());
        for json in ["null", "[1]", "{}"] {
            let error = serde_json::from_str::<Scalar>(json).unwrap_err().to_string();
            assert!(error.contains("allowed is a boolean, a number or a text"), "{error}");
        }
    }
}
