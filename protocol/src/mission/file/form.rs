//! Parsed form of a mission file, before it is checked.

use crate::ids::{EnsembleId, RoleId, TaskId, TaskType};
use crate::mission::TIME_LIMIT_MAX_S;
use crate::mission::domain::{NumberRange, ValueKind};
use crate::mission::model::{ATTEMPTS_MAX, Escalation, OnLoss, PATIENCE_MAX_S, RoleKind, TaskOrder};
use crate::units::EnergyLimit;
use schemars::JsonSchema;
use serde::de::{Deserializer, Error as _, MapAccess, Unexpected, Visitor};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::iter;
use std::marker::PhantomData;

/// Parameter that a request provides.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TemplateParameter {
    /// Kind of the parameter.
    pub kind: TemplateKind,
    /// Value if the request gives none.
    #[serde(default)]
    pub default: Option<String>,
    /// Meaning, for people.
    #[serde(default)]
    pub description: String,
}

/// Kind of a mission parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum TemplateKind {
    /// Place on the map.
    Place,
    /// Duration in seconds.
    Seconds,
    /// Finite number.
    Number,
    /// Any text.
    Text,
    /// Places on the map, separated by commas.
    Places,
    /// Texts, separated by commas.
    Texts,
}

impl TemplateKind {
    pub(super) fn value_kind(self) -> ValueKind {
        match self {
            TemplateKind::Place | TemplateKind::Places => ValueKind::Place,
            TemplateKind::Seconds => ValueKind::Seconds,
            TemplateKind::Number => ValueKind::Number(NumberRange::default()),
            TemplateKind::Text | TemplateKind::Texts => ValueKind::Text,
        }
    }

    /// Returns the parts of a value that are of the [kind](Self::value_kind).
    pub(super) fn parts(self, value: &str) -> Vec<&str> {
        match self {
            TemplateKind::Places | TemplateKind::Texts => value.split(',').map(str::trim).collect(),
            TemplateKind::Place | TemplateKind::Seconds | TemplateKind::Number | TemplateKind::Text => vec![value],
        }
    }

    /// Returns the value as a literal of an expression.
    pub(super) fn literal(self, value: &str) -> String {
        match (self, value.parse::<f64>()) {
            (TemplateKind::Seconds | TemplateKind::Number, Ok(number)) => format!("{number:?}"),
            _ => text_literal(value),
        }
    }
}

/// Mission file.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct MissionFile {
    /// Name of the kind of mission.
    #[schemars(with = "TaskId")]
    pub(super) mission: String,
    /// Title, for people.
    #[serde(default)]
    pub(super) title: String,
    /// Parameters that a request provides, by name.
    #[serde(default, deserialize_with = "unique_keys")]
    pub(super) parameters: BTreeMap<String, TemplateParameter>,
    /// Participating roles, by name; at least 1 is managed.
    #[serde(deserialize_with = "unique_keys")]
    pub(super) roles: BTreeMap<String, RoleFile>,
    /// Ensembles whose robots get the roles, in order of preference: robots of the first if they can fill
    /// all roles, otherwise those of the first 2, and so on. Default: robots of any ensemble.
    #[serde(default)]
    #[schemars(with = "Vec<EnsembleId>")]
    pub(super) ensembles: Vec<String>,
    /// Condition (CEL) on the robots of all managed roles, in addition to those of the roles, such as
    /// `robot.attributes.section == ${section}`. `${name}` stands for a parameter of the mission.
    #[serde(default)]
    pub(super) eligible: Option<String>,
    /// Bound on the energy of all its robots together, in full batteries, such as `0.4`. It is compared with
    /// estimates: those of the bids, and those of its earlier awards. If every assignment of its roles
    /// would exceed the bound, the mission fails at once. Default: no bound.
    #[serde(default)]
    pub(super) energy_max: Option<EnergyLimit>,
    /// Bound on its time, in seconds from the request, or from its earliest start. It has the effect of a
    /// deadline: the mission fails, and its robots are free again. If the request has a deadline, too, the
    /// earlier of the two counts. Default: that of the fleet file.
    #[serde(default, deserialize_with = "time_limit")]
    #[schemars(range(min = 1, max = TIME_LIMIT_MAX_S))]
    pub(super) time_limit_s: Option<u32>,
    /// Tasks of the mission.
    pub(super) root: TaskFile,
    /// Branch executed instead if a robot is lost that has, or may have, an item. Its tasks have
    /// different names. In its values `${lost.item}`, `${lost.robot}` and `${lost.place}` stand for
    /// the loss.
    #[serde(default)]
    pub(super) recovery: Option<TaskFile>,
    /// Results of the mission, by name: expressions (CEL) over the results of its tasks, such as
    /// `inspect.dust_g`.
    #[serde(default, deserialize_with = "unique_keys")]
    pub(super) result: BTreeMap<String, String>,
}

/// Returns a text as a literal of an expression.
pub(super) fn text_literal(text: &str) -> String {
    serde_json::to_string(text).expect("a text serializes to JSON")
}

/// Role in the mission.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct RoleFile {
    /// Managed roles are filled by robots.
    pub(super) kind: RoleKind,
    /// Consequence if its holder is lost after other roles have acted on its work.
    #[serde(default)]
    pub(super) on_loss: OnLoss,
    /// Condition (CEL) on the robot of a managed role, such as `robot.attributes.section == ${section}` or
    /// `robot.name == "ada"`. `${name}` stands for a parameter of the mission.
    #[serde(default)]
    pub(super) eligible: Option<String>,
    /// Description, for people.
    #[serde(default, rename = "description")]
    _description: String,
}

/// Task: abstract, with a `method` over `tasks`, or elementary, with a `type` and `roles`; or a choice
/// (`choose`), a loop over a list (`for`, `in`, `do`), or a bounded repetition (`repeat`, `do`, `until`).
// The fields decide between the two forms; the builder checks them and reports problems with their
// path.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(extend("oneOf" = [
    { "required": ["method", "tasks"], "not": { "anyOf": [{ "required": ["type"] }, { "required": ["roles"] }] } },
    { "required": ["type", "roles"], "not": { "anyOf": [{ "required": ["method"] }, { "required": ["tasks"] }] } },
    { "required": ["choose"] },
    { "required": ["for", "in", "do"] },
    { "required": ["repeat", "do", "until"] },
]))]
pub(super) struct TaskFile {
    /// Name, unique within the mission.
    #[schemars(with = "TaskId")]
    pub(super) task: String,
    /// Abstract task: order of its tasks.
    #[serde(default)]
    pub(super) method: Option<TaskOrder>,
    /// Abstract task: its tasks.
    #[serde(default)]
    pub(super) tasks: Option<Vec<TaskFile>>,
    /// Elementary task: its type, which is the name of the skill that executes it.
    #[serde(default, rename = "type")]
    #[schemars(with = "Option<TaskType>")]
    pub(super) task_type: Option<String>,
    /// Elementary task: roles that execute it; several roles execute it jointly.
    #[serde(default)]
    #[schemars(with = "Option<Vec<RoleId>>")]
    pub(super) roles: Option<Vec<String>>,
    /// Condition (CEL) over the results of earlier tasks, such as `inspect.dust_g > 5.0`: the task is
    /// skipped unless it holds. `${name}` stands for a parameter of the mission.
    #[serde(default)]
    pub(super) when: Option<String>,
    /// Branches of a choice. The first branch with a true condition is executed.
    #[serde(default)]
    pub(super) choose: Option<Vec<ChoiceFile>>,
    /// Choice: executed if no condition holds.
    #[serde(default, rename = "else")]
    pub(super) otherwise: Option<Box<TaskFile>>,
    /// Loop: name of the variable, used as `${name}` in its task.
    #[serde(default, rename = "for")]
    pub(super) variable: Option<String>,
    /// Loop: its values, as a list or as `${name}` of a parameter of kind `places` or `texts`.
    #[serde(default, rename = "in")]
    pub(super) values: Option<ListFile>,
    /// Loop: each iteration is a role of its own, so that several robots share the iterations. Such are the managed
    /// roles of its task that no other task has; `${role}` stands for the name of the role in the iteration.
    /// The iterations are unordered.
    #[serde(default)]
    pub(super) spread: bool,
    /// Loop or repetition: the repeated task.
    #[serde(default, rename = "do")]
    pub(super) body: Option<Box<TaskFile>>,
    /// Repetition: maximum number of iterations, from 1 to 10.
    #[serde(default)]
    #[schemars(range(min = 1, max = ITERATIONS_MAX))]
    pub(super) repeat: Option<u32>,
    /// Repetition: condition (CEL) that ends it, over the results of its own tasks and of earlier tasks.
    #[serde(default)]
    pub(super) until: Option<String>,
    /// Parameters of the skill, by name. `${name}` stands for a parameter of the mission, and
    /// `${task.result}` for a result of an earlier task.
    #[serde(default, deserialize_with = "unique_keys")]
    pub(super) parameters: BTreeMap<String, String>,
    /// State that holds after the task, such as `location: ${room}`.
    #[serde(default, deserialize_with = "unique_keys")]
    pub(super) reaches: BTreeMap<String, String>,
    /// Items that roles have after the task.
    #[serde(default, deserialize_with = "unique_keys")]
    pub(super) acquires: BTreeMap<String, String>,
    /// Items that are outside the mission after the task.
    #[serde(default)]
    pub(super) releases: Vec<String>,
    /// Maximum number of attempts before the task has failed permanently; default 2.
    #[serde(default, deserialize_with = "attempts")]
    #[schemars(range(min = 1, max = ATTEMPTS_MAX))]
    pub(super) attempts: Option<u8>,
    /// Task of a person: seconds to wait for an answer before the mission fails. Default: that of the fleet file.
    #[serde(default)]
    #[schemars(range(min = 1, max = PATIENCE_MAX_S))]
    pub(super) patience_s: Option<u32>,
    /// Task of a person: escalation of a request without an answer to people with another role.
    #[serde(default)]
    pub(super) escalate: Option<Escalation>,
    /// Abstract task: other methods, tried in this order when a task of its own method has failed
    /// permanently. A single managed role executes all of them.
    #[serde(default)]
    pub(super) alternatives: Vec<MethodFile>,
}

/// Maximum number of iterations of a repetition.
pub(super) const ITERATIONS_MAX: u32 = 10;

/// Branch of a choice.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ChoiceFile {
    /// Condition (CEL) over the results of earlier tasks.
    pub(super) when: String,
    /// Task that is executed if it holds, and no earlier condition does.
    #[serde(rename = "do")]
    pub(super) body: TaskFile,
}

/// Values of a loop.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(untagged)]
pub(super) enum ListFile {
    /// `${name}` of a parameter.
    Reference(String),
    /// The values.
    Values(Vec<String>),
}

/// Alternative method of an abstract task.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct MethodFile {
    /// Always `sequential`.
    pub(super) method: TaskOrder,
    /// Elementary tasks.
    pub(super) tasks: Vec<TaskFile>,
}

impl TaskFile {
    /// Checks whether the task has fields of elementary tasks.
    pub(super) fn has_entries(&self) -> bool {
        let maps = [&self.parameters, &self.reaches, &self.acquires];
        maps.iter().any(|map| !map.is_empty())
            || !self.releases.is_empty()
            || self.attempts.is_some()
            || self.patience_s.is_some()
            || self.escalate.is_some()
    }

    /// Returns the tasks directly below it.
    pub(super) fn below(&self) -> impl Iterator<Item = &TaskFile> {
        let choices = self.choose.iter().flatten().map(|choice| &choice.body);
        let bodies = self.otherwise.iter().chain(&self.body).map(|task| &**task);
        self.tasks.iter().flatten().chain(choices).chain(bodies)
    }

    /// Returns the task and all tasks below it.
    fn all(&self) -> impl Iterator<Item = &TaskFile> {
        let mut open = vec![self];
        iter::from_fn(move || {
            let task = open.pop()?;
            open.extend(task.below());
            Some(task)
        })
    }

    /// Returns the names of the task and of all tasks below it.
    pub(super) fn names(&self) -> BTreeSet<&str> {
        self.all().map(|task| task.task.as_str()).collect()
    }

    /// Returns the number of elementary tasks of each role, here and below, also in alternatives.
    pub(super) fn tasks_by_role(&self) -> BTreeMap<&str, usize> {
        let roles = self
            .all()
            .flat_map(|task| iter::once(task).chain(task.alternatives.iter().flat_map(|method| &method.tasks)));
        let mut counts = BTreeMap::new();
        for role in roles.flat_map(|task| task.roles.iter().flatten()) {
            *counts.entry(role.as_str()).or_default() += 1;
        }
        counts
    }
}

/// Deserializes a map and rejects repeated keys; JSON parsers otherwise silently keep the last
/// value.
pub(in crate::mission) fn unique_keys<'de, D, V>(reader: D) -> Result<BTreeMap<String, V>, D::Error>
where
    D: Deserializer<'de>,
    V: Deserialize<'de>,
{
    struct UniqueKeys<V>(PhantomData<V>);
    impl<'de, V: Deserialize<'de>> Visitor<'de> for UniqueKeys<V> {
        type Value = BTreeMap<String, V>;
        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a map with names as keys")
        }
        fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
            let mut found = BTreeMap::new();
            while let Some((key, value)) = map.next_entry::<String, V>()? {
                if found.contains_key(&key) {
                    return Err(A::Error::custom(format!("the key `{key}` occurs twice")));
                }
                found.insert(key, value);
            }
            Ok(found)
        }
    }
    reader.deserialize_map(UniqueKeys(PhantomData))
}

/// Deserializes a bound on the time of a mission.
fn time_limit<'de, D: Deserializer<'de>>(reader: D) -> Result<Option<u32>, D::Error> {
    match Option::<u32>::deserialize(reader)? {
        Some(seconds) if !(1..=TIME_LIMIT_MAX_S).contains(&seconds) => {
            Err(D::Error::custom(format!("time_limit_s is {seconds}; allowed are 1 to {TIME_LIMIT_MAX_S} seconds")))
        }
        limit => Ok(limit),
    }
}

/// Deserializes a number of attempts. The allowed range is checked later, together with the task.
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
