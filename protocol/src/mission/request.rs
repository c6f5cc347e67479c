//! Mission files as requests bring them.

use super::file::{Format, MissionFileError, MissionTemplate};
use serde_json::Value;

impl MissionTemplate {
    /// A mission file as a request to the coordinator brings it: whole, as JSON, whatever it was written in.
    ///
    /// # Errors
    /// As [`parse`](MissionTemplate::parse): mistakes of form are told here, where the file is, and not by the coordinator.
    pub fn request(text: &str, format: Format) -> Result<Value, MissionFileError> {
        MissionTemplate::parse(text, format)?;
        let syntax = |message: String| MissionFileError::Syntax { format, message };
        let text = text.trim_start_matches('\u{feff}');
        let value: Value = match format {
            Format::Json => serde_json::from_str(text).map_err(|problem| syntax(problem.to_string()))?,
            Format::Yaml => serde_saphyr::from_str(text).map_err(|problem| syntax(problem.to_string()))?,
        };
        Ok(scalars_as_text(value))
    }
}

/// Mission files hold texts only; YAML takes a bare `5` for a number.
fn scalars_as_text(value: Value) -> Value {
    match value {
        Value::Array(list) => list.into_iter().map(scalars_as_text).collect(),
        Value::Object(map) => map.into_iter().map(|(key, value)| (key, scalars_as_text(value))).collect(),
        Value::Bool(value) => Value::String(value.to_string()),
        Value::Number(value) => Value::String(value.to_string()),
        Value::Null | Value::String(_) => value,
    }
}
