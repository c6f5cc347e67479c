//! Paths of fields in messages: `status[name=motor].values[0].value`.

use crate::dynamic::types::{Base, Shape, TypeRegistry};
use serde_json::Value;

/// A step of a path.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Step {
    Field(String),
    Index(usize),
    /// The first item of a list whose field has this text.
    Where(String, String),
}

/// Path of a field.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldPath(Vec<Step>);

/// A path cannot be read, or names no field of a message.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PathError {
    /// The text is no path.
    #[error(
        "{0:?} is no path of a field; allowed is for example pose.position.x or status[name=motor].values[0].value"
    )]
    Syntax(String),
    /// The message has no such field.
    #[error("{message} has no field {field:?}; allowed: {allowed}")]
    Field {
        /// The message.
        message: String,
        /// The field.
        field: String,
        /// Its fields.
        allowed: String,
    },
    /// A field is no list or no message.
    #[error("{field:?} of {message} is no {expected}")]
    Shape {
        /// The message.
        message: String,
        /// The field.
        field: String,
        /// What the path needs.
        expected: &'static str,
    },
}

impl FieldPath {
    /// Reads a path. The empty path is the whole message.
    ///
    /// # Errors
    /// [`PathError::Syntax`].
    pub fn parse(text: &str) -> Result<FieldPath, PathError> {
        let wrong = || PathError::Syntax(text.to_owned());
        let mut steps = vec![];
        let mut rest = text;
        while !rest.is_empty() {
            if let Some(inner) = rest.strip_prefix('[') {
                let (inside, after) = inner.split_once(']').ok_or_else(wrong)?;
                steps.push(match inside.split_once('=') {
                    Some((field, text)) => Step::Where(field.trim().to_owned(), text.trim().to_owned()),
                    None => Step::Index(inside.parse().map_err(|_| wrong())?),
                });
                rest = after;
            } else {
                let name = if steps.is_empty() { rest } else { rest.strip_prefix('.').ok_or_else(wrong)? };
                let end = name.find(['.', '[']).unwrap_or(name.len());
                let valid = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
                if end == 0 || !name[..end].chars().all(valid) {
                    return Err(wrong());
                }
                steps.push(Step::Field(name[..end].to_owned()));
                rest = &name[end..];
            }
        }
        Ok(FieldPath(steps))
    }

    /// Returns the value of the field, if the message has it.
    pub fn get<'a>(&self, message: &'a Value) -> Option<&'a Value> {
        self.0.iter().try_fold(message, |value, step| match step {
            Step::Field(name) => value.get(name),
            Step::Index(index) => value.get(index),
            Step::Where(field, text) => {
                value.as_array()?.iter().find(|item| item[field].as_str() == Some(text.as_str()))
            }
        })
    }

    /// Checks that a type has the field. A type that is not known passes.
    ///
    /// # Errors
    /// [`PathError`] with the fields that are allowed.
    pub fn check(&self, types: &TypeRegistry, message: &str) -> Result<(), PathError> {
        let (mut message, mut at) = (message.to_owned(), None);
        let mut steps = self.0.iter();
        while let Some(step) = steps.next() {
            match step {
                Step::Field(name) => {
                    let Ok(fields) = types.fields(&message) else { return Ok(()) };
                    let Some(field) = fields.iter().find(|field| field.name == *name) else {
                        let allowed = fields.iter().map(|field| field.name.as_str()).collect::<Vec<_>>().join(", ");
                        return Err(PathError::Field { message, field: name.clone(), allowed });
                    };
                    at = Some(field.clone());
                    match &field.base {
                        Base::Message(inner) => message = inner.clone(),
                        Base::Primitive(..) if matches!(steps.as_slice().first(), Some(Step::Field(_))) => {
                            return Err(PathError::Shape { message, field: name.clone(), expected: "message" });
                        }
                        Base::Primitive(..) => {}
                    }
                }
                Step::Index(_) | Step::Where(..) => {
                    if let Some(field) = at.as_ref().filter(|field| field.shape == Shape::Single) {
                        return Err(PathError::Shape { message, field: field.name.clone(), expected: "list" });
                    }
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_path_selects_fields_and_items() {
        let message = json!({"status": [{"name": "arm", "values": []},
            {"name": "motor", "values": [{"key": "temp", "value": "41.5"}]}]});
        let get = |path: &str| FieldPath::parse(path).unwrap().get(&message).cloned();
        assert_eq!(get("status[name=motor].values[key=temp].value"), Some(json!("41.5")));
        assert_eq!(get("status[1].name"), Some(json!("motor")));
        assert_eq!((get("status[2].name"), get("status[name=x].name"), get("")), (None, None, Some(message.clone())));
        for wrong in ["status[", "a..b", ".a", "a[x]", "a b"] {
            assert!(FieldPath::parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_wrong_field_is_reported_with_the_allowed_ones() {
        let types = TypeRegistry::shipped();
        let check = |path: &str| FieldPath::parse(path).unwrap().check(&types, "nav_msgs/msg/Odometry");
        assert_eq!(check("pose.pose.position.x"), Ok(()));
        let error = check("pose.position.x").unwrap_err().to_string();
        assert!(error.contains("PoseWithCovariance has no field \"position\"; allowed: pose, covariance"), "{error}");
        assert!(check("header[0]").unwrap_err().to_string().contains("is no list"));
        assert!(check("child_frame_id.x").unwrap_err().to_string().contains("is no message"));
    }
}
