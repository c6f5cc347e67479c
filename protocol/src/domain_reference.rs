//! References to domain files: nodes with different files of the same name notice it.

use crate::ids::{DomainId, TaskType};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

/// A domain file, by its name and content.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
pub struct DomainReference {
    /// Name of the domain.
    pub name: DomainId,
    /// Hash of its content.
    pub hash: DomainHash,
}

/// A task was made with another content of the domain file than this node has.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the mission has {task_type} of the domain {other}, and this node has the domain {own}: their files differ")]
pub struct OtherDomain {
    /// The type of the task.
    pub task_type: TaskType,
    /// Domain of this node.
    pub own: DomainReference,
    /// Domain of the task.
    pub other: DomainReference,
}

impl fmt::Display for DomainReference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.name, self.hash)
    }
}

/// Hash of the content of a domain: equal for equal content, without descriptions. As text, it has 16
/// hexadecimal digits. It shows mistakes; it is no protection against forgery.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct DomainHash(pub u64);

impl fmt::Display for DomainHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

impl FromStr for DomainHash {
    type Err = String;

    fn from_str(text: &str) -> Result<DomainHash, String> {
        let hash = u64::from_str_radix(text, 16).map_err(|_| format!("{text:?} is no hash of 16 hexadecimal digits"));
        hash.map(DomainHash)
    }
}

impl Serialize for DomainHash {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() { serializer.collect_str(self) } else { self.0.serialize(serializer) }
    }
}

impl<'de> Deserialize<'de> for DomainHash {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<DomainHash, D::Error> {
        if !deserializer.is_human_readable() {
            return u64::deserialize(deserializer).map(DomainHash);
        }
        String::deserialize(deserializer)?.parse().map_err(de::Error::custom)
    }
}

impl JsonSchema for DomainHash {
    fn schema_name() -> Cow<'static, str> {
        "DomainHash".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "string", "pattern": "^[0-9a-f]{16}$" })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hash_is_read_as_it_is_written() {
        let hash = DomainHash(0x1f);
        assert_eq!(serde_json::to_string(&hash).unwrap(), "\"000000000000001f\"");
        assert_eq!(serde_json::from_str::<DomainHash>("\"000000000000001f\"").unwrap(), hash);
        assert!(serde_json::from_str::<DomainHash>("\"x\"").is_err());
    }
}
