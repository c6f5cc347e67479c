//! What kinds of task there are, and what each needs to be told.
//!
//! A mission is valid within a domain (thesis 3.5: its task types are among those that the system has skills for). Where the
//! fleet's map is known, the places that it names are among those on it.
//! The domain says nothing of how a task is done or what it costs: that is the knowledge of skills.

use super::diagnostic::{AllowedNames, MissionErrorKind};
use crate::ids::{PlaceId, TaskType};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::Arc;

/// The task types that missions may use, and the places that they may name.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Domain {
    types: BTreeMap<TaskType, TaskSchema>,
    /// Those of the fleet's map; none where no map is at hand, and then every name will do.
    #[serde(skip)]
    places: Option<Arc<BTreeSet<PlaceId>>>,
}

/// What a task of one type is told.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskSchema {
    /// Its parameters, by name.
    #[serde(default)]
    pub parameters: BTreeMap<String, ParameterSchema>,
}

/// What one parameter holds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ParameterSchema {
    /// What its value is.
    pub kind: ValueKind,
    /// Whether a task without it is refused.
    #[serde(default)]
    pub required: bool,
}

/// What a value is. Values travel as text; the kind says which texts will do.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ValueKind {
    /// A place on the map.
    Place,
    /// A role of the mission.
    Role,
    /// A time span in seconds, zero or more, with or without decimals.
    Seconds,
    /// Any text.
    Text,
    /// One of these words.
    OneOf(BTreeSet<String>),
}

impl fmt::Display for ValueKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ValueKind::Place => f.write_str("a place"),
            ValueKind::Role => f.write_str("a role of the mission"),
            ValueKind::Seconds => f.write_str("a number of seconds, zero or more"),
            ValueKind::Text => f.write_str("a text"),
            ValueKind::OneOf(words) => {
                let words: Vec<&str> = words.iter().map(String::as_str).collect();
                write!(f, "one of {}", words.join(", "))
            }
        }
    }
}

impl ValueKind {
    /// Whether `text` is such a value. That a role exists in the mission is asked elsewhere.
    pub fn admits(&self, text: &str) -> bool {
        match self {
            ValueKind::Place => PlaceId::new(text).is_ok(),
            ValueKind::Role => crate::ids::RoleId::new(text).is_ok(),
            ValueKind::Seconds => text.parse::<f64>().is_ok_and(|seconds| seconds.is_finite() && seconds >= 0.0),
            ValueKind::Text => !text.is_empty() && !text.chars().any(char::is_control),
            ValueKind::OneOf(words) => words.contains(text),
        }
    }
}

impl TaskSchema {
    /// The same with one more parameter, without which a task is refused.
    #[must_use]
    pub fn required(self, name: &str, kind: ValueKind) -> Self {
        self.with(name, kind, true)
    }

    /// The same with one more parameter, which a task may leave out.
    #[must_use]
    pub fn optional(self, name: &str, kind: ValueKind) -> Self {
        self.with(name, kind, false)
    }

    fn with(mut self, name: &str, kind: ValueKind, required: bool) -> Self {
        self.parameters.insert(name.to_owned(), ParameterSchema { kind, required });
        self
    }
}

impl Domain {
    /// The same with one more task type; a type that is already there is replaced.
    #[must_use]
    pub fn with(mut self, task_type: TaskType, schema: TaskSchema) -> Self {
        self.types.insert(task_type, schema);
        self
    }

    /// The same, where these are all the places that there are.
    #[must_use]
    pub fn with_places(self, places: impl IntoIterator<Item = PlaceId>) -> Self {
        Self { places: Some(Arc::new(places.into_iter().collect())), ..self }
    }

    /// The places of the fleet's map, if it is known.
    pub fn places(&self) -> Option<&BTreeSet<PlaceId>> {
        self.places.as_deref()
    }

    /// What is wrong with a value that should be of this kind and is of its form: a place that is on no map.
    pub(super) fn unknown_place(&self, name: &str, kind: &ValueKind, value: &str) -> Option<MissionErrorKind> {
        let places = self.places().filter(|_| *kind == ValueKind::Place)?;
        if places.iter().any(|place| place.as_str() == value) {
            return None;
        }
        let allowed = AllowedNames::suggest_for(value, places);
        Some(MissionErrorKind::UnknownPlace { name: name.to_owned(), place: value.to_owned(), allowed })
    }

    /// What a task of this type is told, if the domain has it.
    pub fn get(&self, task_type: &TaskType) -> Option<&TaskSchema> {
        self.types.get(task_type)
    }

    /// The task types, in the order of their names.
    pub fn task_types(&self) -> impl Iterator<Item = &TaskType> {
        self.types.keys()
    }

    /// The task types of service robots in a hospital: what the shipped missions are made of.
    pub fn hospital() -> Self {
        use ValueKind::{OneOf, Place, Role, Seconds, Text};
        let position = || OneOf(["open", "close"].map(str::to_owned).into());
        let task = TaskSchema::default;
        [
            ("navigation", task().required("to", Place)),
            ("approach_person", task().optional("person_role", Role).optional("patience", Seconds)),
            ("authenticate_person", task().optional("person_role", Role).optional("patience", Seconds)),
            ("approach_robot", task().required("robot_role", Role)),
            ("operate_drawer", task().required("action", position())),
            ("operate_door", task().required("action", position()).optional("at", Place)),
            ("deposit", task().optional("into_role", Role).optional("item", Text).optional("patience", Seconds)),
            ("pick_up", task().required("from_role", Role).optional("item", Text)),
            ("carry", task().required("to", Place).optional("item", Text)),
            ("disinfect", task().optional("at", Place)),
            ("wait", task().required("seconds", Seconds)),
            ("follow_path", task().required("waypoints", Text)),
            ("grasp", task().required("object", Text)),
            ("dock", task().optional("charger", Place)),
            ("undock", task()),
        ]
        .into_iter()
        .fold(Self::default(), |domain, (name, schema)| {
            domain.with(TaskType::new(name).expect("the domain's own names are slugs"), schema)
        })
    }
}
