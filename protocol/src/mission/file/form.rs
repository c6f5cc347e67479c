//! A mission as people write it, before anything of it is judged.

use crate::ids::{RoleId, TaskId, TaskType};
use crate::mission::domain::ValueKind;
use crate::mission::model::{ATTEMPTS_MAX, OnLoss, RoleKind, TaskOrder};
use schemars::JsonSchema;
use serde::de::{Deserializer, Error as _, MapAccess, Unexpected, Visitor};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;

/// What a request fills in.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TemplateParameter {
    /// What it is.
    pub kind: TemplateKind,
    /// Its value where a request gives none.
    #[serde(default)]
    pub default: Option<String>,
    /// What it means, for people.
    #[serde(default)]
    pub description: String,
}

/// What a mission's parameter is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum TemplateKind {
    /// A place on the map.
    Place,
    /// A time span in seconds.
    Seconds,
    /// Any text.
    Text,
}

impl TemplateKind {
    pub(super) fn value_kind(self) -> ValueKind {
        match self {
            TemplateKind::Place => ValueKind::Place,
            TemplateKind::Seconds => ValueKind::Seconds,
            TemplateKind::Text => ValueKind::Text,
        }
    }
}

/// A mission as people write it.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct MissionFile {
    /// The name of the kind of mission.
    #[schemars(with = "TaskId")]
    pub(super) mission: String,
    /// What it is about, for people.
    #[serde(default)]
    pub(super) title: String,
    /// What a request fills in, by name.
    #[serde(default, deserialize_with = "unique_keys")]
    pub(super) parameters: BTreeMap<String, TemplateParameter>,
    /// Who takes part, by name; at least one is managed.
    #[serde(deserialize_with = "unique_keys")]
    pub(super) roles: BTreeMap<String, RoleFile>,
    /// What is done.
    pub(super) root: TaskFile,
    /// What is done instead if a robot is lost that has an item, or may have one. Its tasks have names of their own; in its
    /// values `${lost.item}`, `${lost.robot}` and `${lost.place}` say what was lost.
    #[serde(default)]
    pub(super) recovery: Option<TaskFile>,
}

/// A part in the mission.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct RoleFile {
    /// Whether a robot is sought for it.
    pub(super) kind: RoleKind,
    /// What becomes of the mission if its holder is lost after others have acted on its work.
    #[serde(default)]
    pub(super) on_loss: OnLoss,
    /// What it does, for people.
    #[serde(default, rename = "description")]
    _description: String,
}

/// A task: abstract, with a `method` over `tasks`, or elementary, with a `type` and `roles`.
// Which of the two is told by its fields and judged when the mission is built, with its path.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(extend("oneOf" = [
    { "required": ["method", "tasks"], "not": { "anyOf": [{ "required": ["type"] }, { "required": ["roles"] }] } },
    { "required": ["type", "roles"], "not": { "anyOf": [{ "required": ["method"] }, { "required": ["tasks"] }] } },
]))]
pub(super) struct TaskFile {
    /// Its name, unique within the mission.
    #[schemars(with = "TaskId")]
    pub(super) task: String,
    /// Of an abstract task: whether its tasks depend on one another.
    #[serde(default)]
    pub(super) method: Option<TaskOrder>,
    /// Of an abstract task: what it comes down to.
    #[serde(default)]
    pub(super) tasks: Option<Vec<TaskFile>>,
    /// Of an elementary task: its type, which names the skill that does it.
    #[serde(default, rename = "type")]
    #[schemars(with = "Option<TaskType>")]
    pub(super) task_type: Option<String>,
    /// Of an elementary task: who does it; several do it jointly.
    #[serde(default)]
    #[schemars(with = "Option<Vec<RoleId>>")]
    pub(super) roles: Option<Vec<String>>,
    /// What the skill is told, by name. `${name}` stands for a parameter of the mission.
    #[serde(default, deserialize_with = "unique_keys")]
    pub(super) parameters: BTreeMap<String, String>,
    /// What is so once the task has ended, as `location: ${room}`.
    #[serde(default, deserialize_with = "unique_keys")]
    pub(super) reaches: BTreeMap<String, String>,
    /// Which role has which item once the task has ended.
    #[serde(default, deserialize_with = "unique_keys")]
    pub(super) acquires: BTreeMap<String, String>,
    /// Items that nobody of the mission has any more once the task has ended.
    #[serde(default)]
    pub(super) releases: Vec<String>,
    /// How often its skill is tried before the task has failed; 2 if nothing is said.
    #[serde(default, deserialize_with = "attempts")]
    #[schemars(range(min = 1, max = ATTEMPTS_MAX))]
    pub(super) attempts: Option<u8>,
    /// Of an abstract task: other methods, tried in this order when a task of its own has failed for good. One managed role
    /// does all of them alone.
    #[serde(default)]
    pub(super) alternatives: Vec<MethodFile>,
}

/// Another way to do an abstract task.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct MethodFile {
    /// `sequential`.
    pub(super) method: TaskOrder,
    /// Elementary tasks.
    pub(super) tasks: Vec<TaskFile>,
}

impl TaskFile {
    /// Whether it says what only an elementary task does.
    pub(super) fn has_entries(&self) -> bool {
        let maps = [&self.parameters, &self.reaches, &self.acquires];
        maps.iter().any(|map| !map.is_empty()) || !self.releases.is_empty() || self.attempts.is_some()
    }
}

/// A map in which a key that stands twice is an error; JSON readers otherwise keep the last and say nothing.
pub(in crate::mission) fn unique_keys<'de, D, V>(reader: D) -> Result<BTreeMap<String, V>, D::Error>
where
    D: Deserializer<'de>,
    V: Deserialize<'de>,
{
    struct OnceEach<V>(PhantomData<V>);
    impl<'de, V: Deserialize<'de>> Visitor<'de> for OnceEach<V> {
        type Value = BTreeMap<String, V>;
        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a map from names")
        }
        fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
            let mut found = BTreeMap::new();
            while let Some((key, value)) = map.next_entry::<String, V>()? {
                if found.contains_key(&key) {
                    return Err(A::Error::custom(format!("`{key}` stands here twice")));
                }
                found.insert(key, value);
            }
            Ok(found)
        }
    }
    reader.deserialize_map(OnceEach(PhantomData))
}

/// A number of attempts, or a word on what it should be. Whether it is one that is allowed is told later, with its task.
fn attempts<'de, D: Deserializer<'de>>(reader: D) -> Result<Option<u8>, D::Error> {
    struct Attempts;
    impl Visitor<'_> for Attempts {
        type Value = Option<u8>;
        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "a whole number of attempts from 1 to {ATTEMPTS_MAX}")
        }
        fn visit_u64<E: serde::de::Error>(self, number: u64) -> Result<Self::Value, E> {
            let number = u8::try_from(number).map_err(|_| E::invalid_value(Unexpected::Unsigned(number), &self))?;
            Ok(Some(number))
        }
        fn visit_i64<E: serde::de::Error>(self, number: i64) -> Result<Self::Value, E> {
            let positive = u64::try_from(number).map_err(|_| E::invalid_value(Unexpected::Signed(number), &self))?;
            self.visit_u64(positive)
        }
        fn visit_unit<E: serde::de::Error>(self) -> Result<Self::Value, E> {
            Ok(None)
        }
    }
    reader.deserialize_any(Attempts)
}
