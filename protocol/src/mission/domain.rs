//! Domain of missions: task types with their parameters, places, and ensembles.
//!
//! A mission is valid within a domain (thesis 3.5: its task types are among those that the system
//! has skills for). If the fleet's map is known, the places that a mission uses must be on it. The
//! domain contains no information on the implementation or the cost of a task: skills have that
//! information.

use super::diagnostic::MissionErrorKind;
use super::ihtn_names::IhtnNames;
use crate::domain_reference::DomainReference;
use crate::ids::{EnsembleId, PlaceId, TaskType, ZoneId};
use crate::scalar::{SCALAR_BYTES_MAX, Scalar};
use consort_text::AllowedNames;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::Arc;

/// Task types, places and ensembles that missions may use.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Domain {
    types: BTreeMap<TaskType, TaskSchema>,
    /// Places of the fleet's map; `None` without a map, and then every name is accepted.
    #[serde(skip)]
    places: Option<Arc<BTreeSet<PlaceId>>>,
    /// Lanes of the fleet's map, each with the end first whose name comes first; `None` without a map.
    #[serde(skip)]
    lanes: Option<Arc<BTreeSet<(PlaceId, PlaceId)>>>,
    /// Zones of the fleet.
    #[serde(skip)]
    zones: Arc<BTreeMap<ZoneId, BTreeSet<PlaceId>>>,
    /// Ensembles of the fleet; `None` if they are not known, and then every name is accepted.
    #[serde(skip)]
    ensembles: Option<Arc<BTreeSet<EnsembleId>>>,
    /// Readings of drivers.
    #[serde(skip)]
    readings: BTreeSet<String>,
    /// Meaning of names in missions in the flat iHTN form.
    #[serde(skip)]
    ihtn: IhtnNames,
}

/// Parameters of a task type.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskSchema {
    /// Parameters, by name.
    #[serde(default)]
    pub parameters: BTreeMap<String, ParameterSchema>,
    /// Results, by name.
    #[serde(default)]
    pub results: BTreeMap<String, ValueKind>,
    /// Domain file that declares the task type; `None` for a type without a file.
    #[serde(default)]
    pub domain: Option<DomainReference>,
    /// False if certainly no robot hands an item over in a task of this type, true if it may; `None` for a type without
    /// a file.
    #[serde(default)]
    pub hands_over: Option<bool>,
}

/// Schema of a parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ParameterSchema {
    /// Kind of value.
    pub kind: ValueKind,
    /// True if a task without it is rejected.
    #[serde(default)]
    pub required: bool,
}

/// Kind of a value. Values are text; the kind defines the valid texts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ValueKind {
    /// Place on the map.
    Place,
    /// Role of the mission.
    Role,
    /// Duration in seconds, 0 or more, with or without decimals.
    Seconds,
    /// Finite number within a range.
    Number(NumberRange),
    /// Whole number within a range.
    Integer(NumberRange),
    /// `true` or `false`.
    Bool,
    /// Any text.
    Text,
    /// A word from this set.
    OneOf(BTreeSet<String>),
}

/// Range of a number, both ends included.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NumberRange {
    /// Least value; `None` for no limit.
    pub minimum: Option<f64>,
    /// Greatest value; `None` for no limit.
    pub maximum: Option<f64>,
}

impl NumberRange {
    /// Checks whether a number is finite and within the range.
    pub fn contains(self, number: f64) -> bool {
        number.is_finite()
            && self.minimum.is_none_or(|minimum| minimum <= number)
            && self.maximum.is_none_or(|maximum| number <= maximum)
    }
}

impl fmt::Display for NumberRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.minimum, self.maximum) {
            (None, None) => Ok(()),
            (Some(minimum), None) => write!(f, ", {minimum} or more"),
            (None, Some(maximum)) => write!(f, ", {maximum} or less"),
            (Some(minimum), Some(maximum)) => write!(f, " from {minimum} to {maximum}"),
        }
    }
}

impl fmt::Display for ValueKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ValueKind::Place => f.write_str("a place"),
            ValueKind::Role => f.write_str("a role of the mission"),
            ValueKind::Seconds => f.write_str("a number of seconds, zero or more"),
            ValueKind::Number(range) => write!(f, "a number{range}"),
            ValueKind::Integer(range) => write!(f, "a whole number{range}"),
            ValueKind::Bool => f.write_str("true or false"),
            ValueKind::Text => f.write_str("a text"),
            ValueKind::OneOf(words) => {
                let words: Vec<&str> = words.iter().map(String::as_str).collect();
                write!(f, "one of {}", words.join(", "))
            }
        }
    }
}

impl ValueKind {
    /// Checks whether a result of this kind may be the value of a parameter of the kind `parameter`.
    /// Places and roles are known before a mission begins, so they are never results.
    pub(super) fn may_become(&self, parameter: &ValueKind) -> bool {
        use ValueKind::{Bool, Integer, Number, OneOf, Place, Role, Seconds, Text};
        match (self, parameter) {
            (_, Place | Role) => false,
            (_, Text) | (Bool, Bool) | (Integer(_), Integer(_)) | (Text | OneOf(_), OneOf(_)) => true,
            (Seconds | Number(_) | Integer(_), Seconds | Number(_)) => true,
            (_, Seconds | Number(_) | Integer(_) | Bool | OneOf(_)) => false,
        }
    }

    /// Returns the maximum size of a result of this kind in bytes.
    pub(super) fn result_bytes_max(&self) -> usize {
        match self {
            ValueKind::Bool => 2,
            ValueKind::Seconds | ValueKind::Number(_) | ValueKind::Integer(_) => 11,
            ValueKind::OneOf(words) => 4 + words.iter().map(String::len).max().unwrap_or(0).min(SCALAR_BYTES_MAX),
            ValueKind::Place | ValueKind::Role | ValueKind::Text => 4 + SCALAR_BYTES_MAX,
        }
    }

    /// Returns a typical value, for estimates.
    pub(super) fn typical(&self) -> String {
        let number = |range: &NumberRange| match (range.minimum, range.maximum) {
            (Some(minimum), Some(maximum)) => f64::midpoint(minimum, maximum),
            (minimum, maximum) => minimum.or(maximum).unwrap_or(1.0),
        };
        match self {
            ValueKind::Seconds => "1".to_owned(),
            ValueKind::Number(range) => number(range).to_string(),
            ValueKind::Integer(range) => (number(range).round() as i64).to_string(),
            ValueKind::Bool => "true".to_owned(),
            ValueKind::OneOf(words) => words.first().cloned().unwrap_or_default(),
            ValueKind::Place | ValueKind::Role | ValueKind::Text => "unknown".to_owned(),
        }
    }

    /// Returns a result or a reading in the type of this kind: a whole number is also a number. `None` if
    /// it is not of this kind.
    pub fn accept(&self, value: &Scalar) -> Option<Scalar> {
        let value = match (self, value) {
            (ValueKind::Number(_) | ValueKind::Seconds, Scalar::Integer(number)) => Scalar::Number(*number as f64),
            (_, value) => value.clone(),
        };
        let is_valid = match (self, &value) {
            (ValueKind::Bool, Scalar::Bool(_)) => true,
            (ValueKind::Integer(range), Scalar::Integer(number)) => range.contains(*number as f64),
            (ValueKind::Number(range), Scalar::Number(number)) => range.contains(*number),
            (ValueKind::Seconds, Scalar::Number(number)) => number.is_finite() && *number >= 0.0,
            (ValueKind::Text | ValueKind::OneOf(_) | ValueKind::Place | ValueKind::Role, Scalar::Text(text)) => {
                text.len() <= SCALAR_BYTES_MAX && self.admits(text)
            }
            _ => false,
        };
        is_valid.then_some(value)
    }

    /// Returns the result of this kind that a text denotes; `None` if it denotes none.
    pub fn parse(&self, text: &str) -> Option<Scalar> {
        let value = match self {
            ValueKind::Bool => Scalar::Bool(text.parse().ok()?),
            ValueKind::Integer(_) => Scalar::Integer(text.parse().ok()?),
            ValueKind::Number(_) | ValueKind::Seconds => Scalar::Number(text.parse().ok()?),
            ValueKind::Text | ValueKind::OneOf(_) | ValueKind::Place | ValueKind::Role => Scalar::Text(text.to_owned()),
        };
        self.accept(&value)
    }

    /// Checks whether `text` is a value of this kind. The existence of a role in the mission is
    /// checked elsewhere.
    pub(crate) fn admits(&self, text: &str) -> bool {
        match self {
            ValueKind::Place => PlaceId::new(text).is_ok(),
            ValueKind::Role => crate::ids::RoleId::new(text).is_ok(),
            ValueKind::Seconds => text.parse::<f64>().is_ok_and(|seconds| seconds.is_finite() && seconds >= 0.0),
            ValueKind::Number(range) => text.parse::<f64>().is_ok_and(|number| range.contains(number)),
            ValueKind::Integer(range) => text.parse::<i64>().is_ok_and(|number| range.contains(number as f64)),
            ValueKind::Bool => matches!(text, "true" | "false"),
            ValueKind::Text => !text.is_empty() && !text.chars().any(char::is_control),
            ValueKind::OneOf(words) => words.contains(text),
        }
    }
}

/// Checks that results are exactly those of a form, each of its kind. Returns them in the types of the
/// form.
///
/// # Errors
/// Description of the first problem, with what is allowed.
pub fn check_results(
    form: &BTreeMap<String, ValueKind>,
    results: &BTreeMap<String, Scalar>,
) -> Result<BTreeMap<String, Scalar>, String> {
    if let Some(name) = results.keys().find(|name| !form.contains_key(*name)) {
        return Err(match form.is_empty() {
            true => format!("the task has no result `{name}`; it has no results"),
            false => format!("the task has no result `{name}`; {}", AllowedNames::suggest_for(name, form.keys())),
        });
    }
    let result = |(name, kind): (&String, &ValueKind)| {
        let value = results.get(name).ok_or_else(|| format!("the result `{name}` is missing; it is {kind}"))?;
        let accepted = kind.accept(value);
        let value = accepted.ok_or_else(|| format!("the result `{name}` is `{value}`, but it must be {kind}"))?;
        Ok((name.clone(), value))
    };
    form.iter().map(result).collect()
}

impl TaskSchema {
    /// Adds a required parameter.
    #[must_use]
    pub fn required(self, name: &str, kind: ValueKind) -> Self {
        self.with(name, kind, true)
    }

    /// Adds an optional parameter.
    #[must_use]
    pub fn optional(self, name: &str, kind: ValueKind) -> Self {
        self.with(name, kind, false)
    }

    /// Adds a result.
    #[must_use]
    pub fn returning(mut self, name: &str, kind: ValueKind) -> Self {
        self.results.insert(name.to_owned(), kind);
        self
    }

    fn with(mut self, name: &str, kind: ValueKind, required: bool) -> Self {
        self.parameters.insert(name.to_owned(), ParameterSchema { kind, required });
        self
    }
}

impl Domain {
    /// Adds the task types of another domain; replaces existing types of the same names.
    #[must_use]
    pub fn with_types(mut self, types: impl IntoIterator<Item = (TaskType, TaskSchema)>) -> Self {
        self.types.extend(types);
        self
    }

    /// Adds a task type; replaces an existing type of the same name.
    #[must_use]
    pub fn with(mut self, task_type: TaskType, schema: TaskSchema) -> Self {
        self.types.insert(task_type, schema);
        self
    }

    /// Sets the complete list of places.
    #[must_use]
    pub fn with_places(self, places: impl IntoIterator<Item = PlaceId>) -> Self {
        Self { places: Some(Arc::new(places.into_iter().collect())), ..self }
    }

    /// Returns the places of the fleet's map, if it is known.
    pub fn places(&self) -> Option<&BTreeSet<PlaceId>> {
        self.places.as_deref()
    }

    /// Sets the complete list of lanes, each by its two ends.
    #[must_use]
    pub fn with_lanes(self, lanes: impl IntoIterator<Item = (PlaceId, PlaceId)>) -> Self {
        let sorted = lanes.into_iter().map(|(a, b)| if a <= b { (a, b) } else { (b, a) });
        Self { lanes: Some(Arc::new(sorted.collect())), ..self }
    }

    /// Returns the lanes of the fleet's map, if it is known: each with the end first whose name comes first.
    pub fn lanes(&self) -> Option<&BTreeSet<(PlaceId, PlaceId)>> {
        self.lanes.as_deref()
    }

    /// Sets the zones, each with its places. No zone has the name of a place.
    #[must_use]
    pub fn with_zones(self, zones: BTreeMap<ZoneId, BTreeSet<PlaceId>>) -> Self {
        Self { zones: Arc::new(zones), ..self }
    }

    /// Returns the zones of the fleet, each with its places.
    pub fn zones(&self) -> &BTreeMap<ZoneId, BTreeSet<PlaceId>> {
        &self.zones
    }

    /// Sets the complete list of ensembles.
    #[must_use]
    pub fn with_ensembles(self, ensembles: impl IntoIterator<Item = EnsembleId>) -> Self {
        Self { ensembles: Some(Arc::new(ensembles.into_iter().collect())), ..self }
    }

    /// Returns the ensembles of the fleet, if they are known.
    pub fn ensembles(&self) -> Option<&BTreeSet<EnsembleId>> {
        self.ensembles.as_deref()
    }

    /// Adds readings of drivers.
    #[must_use]
    pub fn with_readings(mut self, readings: impl IntoIterator<Item = String>) -> Self {
        self.readings.extend(readings);
        self
    }

    /// Returns the readings that drivers may send.
    pub fn readings(&self) -> &BTreeSet<String> {
        &self.readings
    }

    /// Adds the meaning of names in flat iHTNs; replaces earlier meanings of the same names.
    #[must_use]
    pub fn with_ihtn_names(mut self, names: IhtnNames) -> Self {
        self.ihtn.extend(names);
        self
    }

    /// Returns the meaning of names in flat iHTNs.
    pub fn ihtn_names(&self) -> &IhtnNames {
        &self.ihtn
    }

    /// Returns the problem of a well-formed value of this kind: a place that is not on the map.
    pub(super) fn unknown_place(&self, name: &str, kind: &ValueKind, value: &str) -> Option<MissionErrorKind> {
        let places = self.places().filter(|_| *kind == ValueKind::Place)?;
        if places.iter().any(|place| place.as_str() == value) {
            return None;
        }
        let allowed = AllowedNames::suggest_for(value, places);
        Some(MissionErrorKind::UnknownPlace { name: name.to_owned(), place: value.to_owned(), allowed })
    }

    /// Returns the parameters of a task type, if the domain has the type.
    pub fn get(&self, task_type: &TaskType) -> Option<&TaskSchema> {
        self.types.get(task_type)
    }

    /// Returns the domain files of the task types, except the standard domain.
    pub fn files(&self) -> BTreeSet<DomainReference> {
        self.types.values().filter_map(|schema| schema.domain.clone()).collect()
    }

    /// Returns the task types in which a robot may hand an item over, in the order of their names.
    pub(super) fn handing_over(&self) -> impl Iterator<Item = &TaskType> {
        self.types.iter().filter(|(_, schema)| schema.hands_over != Some(false)).map(|(name, _)| name)
    }

    /// Returns the task types, in the order of their names.
    pub fn task_types(&self) -> impl Iterator<Item = &TaskType> {
        self.types.keys()
    }
}
