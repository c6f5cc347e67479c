//! Outcomes of tasks: their results, or that they were skipped.

use crate::bounds::limit_text;
use crate::ids::TaskId;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;

/// Maximum number of results of a task.
pub const RESULTS_MAX: usize = 16;

/// Maximum size of a text among the results, in bytes.
pub const RESULT_BYTES_MAX: usize = 256;

/// Maximum size of the outcomes of a mission in bytes: a report contains those of a role, and its reply
/// those that a role uses. The recovery branch has as many again.
pub(crate) const OUTCOMES_BYTES_MAX: usize = 8 * 1024;

/// Outcome of an elementary task that has ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TaskOutcome {
    /// Its condition did not hold.
    Skipped,
    /// Executed, with its results by name.
    Done(BTreeMap<String, ResultValue>),
}

/// Outcomes of the tasks of a mission. A task without results has an outcome only if it was skipped,
/// or if another task refers to it.
pub type TaskOutcomes = BTreeMap<TaskId, TaskOutcome>;

impl TaskOutcome {
    /// Returns the outcome with its results reduced to [`RESULTS_MAX`] and its texts to
    /// [`RESULT_BYTES_MAX`].
    #[must_use]
    pub fn limited(self) -> TaskOutcome {
        let TaskOutcome::Done(results) = self else { return self };
        let mut results: BTreeMap<_, _> = results.into_iter().take(RESULTS_MAX).collect();
        for value in results.values_mut() {
            if let ResultValue::Text(text) = value {
                limit_text(text, RESULT_BYTES_MAX);
            }
        }
        TaskOutcome::Done(results)
    }

    /// Returns the results; `None` for a skipped task.
    pub fn results(&self) -> Option<&BTreeMap<String, ResultValue>> {
        match self {
            TaskOutcome::Skipped => None,
            TaskOutcome::Done(results) => Some(results),
        }
    }
}

/// Value of a result.
#[derive(Debug, Clone, PartialEq)]
pub enum ResultValue {
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

impl ResultValue {
    /// Returns the value of a JSON scalar; `None` for anything else, and for numbers that are not
    /// finite.
    pub fn from_json(value: &serde_json::Value) -> Option<ResultValue> {
        match value {
            serde_json::Value::Bool(value) => Some(ResultValue::Bool(*value)),
            serde_json::Value::Number(number) => match number.as_i64() {
                Some(number) => Some(ResultValue::Integer(number)),
                None => number.as_f64().filter(|number| number.is_finite()).map(ResultValue::Number),
            },
            serde_json::Value::String(text) => Some(ResultValue::Text(text.clone())),
            serde_json::Value::Null | serde_json::Value::Array(_) | serde_json::Value::Object(_) => None,
        }
    }
}

impl fmt::Display for ResultValue {
    /// The value as the text of a parameter.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ResultValue::Bool(value) => value.fmt(f),
            ResultValue::Integer(number) => number.fmt(f),
            ResultValue::Number(number) => number.fmt(f),
            ResultValue::Text(text) => f.write_str(text),
        }
    }
}

impl Serialize for ResultValue {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            return match self {
                ResultValue::Bool(value) => serializer.serialize_bool(*value),
                ResultValue::Integer(number) => serializer.serialize_i64(*number),
                ResultValue::Number(number) => serializer.serialize_f64(*number),
                ResultValue::Text(text) => serializer.serialize_str(text),
            };
        }
        let binary = match self {
            ResultValue::Bool(value) => BinaryValue::Bool(*value),
            ResultValue::Integer(number) => BinaryValue::Integer(*number),
            ResultValue::Number(number) => BinaryValue::Number(*number),
            ResultValue::Text(text) => BinaryValue::Text(text.into()),
        };
        binary.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for ResultValue {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<ResultValue, D::Error> {
        if deserializer.is_human_readable() {
            let value = serde_json::Value::deserialize(deserializer)?;
            return ResultValue::from_json(&value)
                .ok_or_else(|| de::Error::custom(format_args!("{value}; allowed is a boolean, a number or a text")));
        }
        match BinaryValue::deserialize(deserializer)? {
            BinaryValue::Bool(value) => Ok(ResultValue::Bool(value)),
            BinaryValue::Integer(number) => Ok(ResultValue::Integer(number)),
            BinaryValue::Number(number) if number.is_finite() => Ok(ResultValue::Number(number)),
            BinaryValue::Number(number) => Err(de::Error::custom(format_args!("{number} is not finite"))),
            BinaryValue::Text(text) => Ok(ResultValue::Text(text.into_owned())),
        }
    }
}

impl JsonSchema for ResultValue {
    fn schema_name() -> Cow<'static, str> {
        "ResultValue".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": ["boolean", "number", "string"], "description": "Value of a result" })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec;

    fn values() -> [ResultValue; 5] {
        let text = |text: &str| ResultValue::Text(text.to_owned());
        [ResultValue::Bool(true), ResultValue::Integer(-3), ResultValue::Number(0.1), text("12"), text("")]
    }

    #[test]
    fn values_keep_their_type_in_messages_and_in_json() {
        for value in values() {
            assert_eq!(codec::decode::<ResultValue>(&codec::encode(&value).unwrap()).unwrap(), value);
            let json = serde_json::to_string(&value).unwrap();
            assert_eq!(serde_json::from_str::<ResultValue>(&json).unwrap(), value, "{json}");
        }
    }

    #[test]
    fn other_values_are_rejected() {
        let infinite = codec::encode(&BinaryValue::Number(f64::INFINITY)).unwrap();
        assert!(codec::decode::<ResultValue>(&infinite).is_err());
        for json in ["null", "[1]", "{}"] {
            let error = serde_json::from_str::<ResultValue>(json).unwrap_err().to_string();
            assert!(error.contains("allowed is a boolean, a number or a text"), "{error}");
        }
    }

    #[test]
    fn an_outcome_has_a_bounded_size() {
        let long = ResultValue::Text("x".repeat(10 * RESULT_BYTES_MAX));
        let results = (0..100).map(|number| (format!("r{number}"), long.clone())).collect();
        let TaskOutcome::Done(results) = TaskOutcome::Done(results).limited() else { panic!("the task was executed") };
        assert_eq!(results.len(), RESULTS_MAX);
        assert!(results.values().all(|value| value.to_string().len() <= RESULT_BYTES_MAX));
    }
}
