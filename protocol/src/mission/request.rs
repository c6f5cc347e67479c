//! Mission files in requests.

use super::file::{Format, MissionFileError, MissionTemplate};
use serde_json::Value;

impl MissionTemplate {
    /// Converts a mission file for a request to the coordinator: the whole file, as JSON, from any
    /// format.
    ///
    /// # Errors
    /// Same as [`parse`](MissionTemplate::parse): errors of form are reported here, where the file
    /// is, and not by the coordinator.
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

/// Converts scalars to text: mission files contain only texts, and YAML parses a bare `5` as a
/// number.
fn scalars_as_text(value: Value) -> Value {
    match value {
        Value::Array(list) => list.into_iter().map(scalars_as_text).collect(),
        Value::Object(map) => map.into_iter().map(|(key, value)| (key, scalars_as_text(value))).collect(),
        Value::Bool(value) => Value::String(value.to_string()),
        Value::Number(value) => Value::String(value.to_string()),
        Value::Null | Value::String(_) => value,
    }
}
