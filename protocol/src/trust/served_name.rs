//! Names that a driver server's certificate contains.

use crate::ids::{NameError, NodeId};
use std::fmt;
use std::str::FromStr;

/// Robot, or role of a person, that a driver server serves: a name, or the beginning of names
/// followed by `*` (`drone-*`; `*` for all).
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct ServedName(String);

impl ServedName {
    /// All names.
    pub fn all() -> ServedName {
        ServedName("*".to_owned())
    }

    /// Checks whether it includes this robot, or role of a person.
    pub fn includes(&self, name: &str) -> bool {
        match self.0.strip_suffix('*') {
            Some(beginning) => name.starts_with(beginning),
            None => self.0 == name,
        }
    }
}

impl fmt::Display for ServedName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}

impl FromStr for ServedName {
    type Err = NameError;

    fn from_str(text: &str) -> Result<ServedName, NameError> {
        let name = text.strip_suffix('*').unwrap_or(text);
        if text != "*" {
            NodeId::new(name)?;
        }
        Ok(ServedName(text.to_owned()))
    }
}
