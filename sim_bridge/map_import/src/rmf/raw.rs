//! The building as written: lists of lists, with parameters as `[type, value]`.

use super::diagnostic::{EntryError, RmfDiagnostic};
use serde::Deserialize;
use serde::de::{Deserializer, MapAccess, Visitor};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;

/// The file. Unused content (models, floors, lights …) is ignored: the format grows.
#[derive(Debug, Deserialize)]
pub(super) struct Building {
    pub(super) name: Option<Value>,
    pub(super) building_name: Option<Value>,
    pub(super) coordinate_system: Option<String>,
    pub(super) parameters: Option<Value>,
    pub(super) reference_level_name: Option<String>,
    pub(super) levels: Ordered<Level>,
    pub(super) lifts: Option<Ordered<Lift>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Level {
    #[serde(default)]
    pub(super) elevation: f64,
    pub(super) vertices: Option<Vec<Value>>,
    pub(super) lanes: Option<Vec<Value>>,
    pub(super) walls: Option<Vec<Value>>,
    pub(super) doors: Option<Vec<Value>>,
    pub(super) measurements: Option<Vec<Value>>,
    pub(super) fiducials: Option<Vec<Value>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Lift {
    pub(super) x: f64,
    pub(super) y: f64,
    #[serde(default)]
    pub(super) yaw: f64,
    pub(super) width: f64,
    pub(super) depth: f64,
    pub(super) reference_floor_name: Option<String>,
    pub(super) lowest_floor: Option<String>,
    pub(super) highest_floor: Option<String>,
    pub(super) level_doors: Option<Ordered<Value>>,
}

/// A mapping that keeps the order of the file.
#[derive(Debug)]
pub(super) struct Ordered<T>(pub(super) Vec<(String, T)>);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Ordered<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct InOrder<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for InOrder<T> {
            type Value = Ordered<T>;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a mapping of names to entries")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                }
                Ok(Ordered(entries))
            }
        }
        deserializer.deserialize_map(InOrder(PhantomData))
    }
}

/// The values of parameters by name.
pub(super) type Parameters = BTreeMap<String, Value>;

/// A point of a level, in the coordinates of the file.
#[derive(Debug, Clone, Default)]
pub(super) struct Vertex {
    pub(super) at: (f64, f64),
    pub(super) name: String,
    pub(super) parameters: Parameters,
}

/// An entry between two vertices.
#[derive(Debug, Clone)]
pub(super) struct Edge {
    /// Its index in its list.
    pub(super) number: usize,
    pub(super) ends: [usize; 2],
    pub(super) parameters: Parameters,
}

/// A marker that occurs on several levels.
#[derive(Debug, Clone)]
pub(super) struct Fiducial {
    pub(super) at: (f64, f64),
    pub(super) name: String,
}

/// Reader of the entries of a level, with the errors found.
pub(super) struct EntryReader<'a> {
    pub(super) level: &'a str,
    pub(super) diagnostics: &'a mut Vec<RmfDiagnostic>,
}

impl EntryReader<'_> {
    pub(super) fn report(&mut self, what: &str, number: usize, error: EntryError) {
        self.diagnostics.push(RmfDiagnostic { at: format!("level {:?}, {what} {number}", self.level), error });
    }

    /// Returns all vertices. An invalid vertex keeps its number.
    pub(super) fn vertices(&mut self, list: Option<&Vec<Value>>) -> Vec<Vertex> {
        let entries = list.into_iter().flatten().enumerate();
        entries
            .map(|(number, entry)| {
                vertex(entry).unwrap_or_else(|error| {
                    self.report("vertex", number, error);
                    Vertex::default()
                })
            })
            .collect()
    }

    pub(super) fn fiducials(&mut self, list: Option<&Vec<Value>>) -> Vec<Fiducial> {
        let entries = list.into_iter().flatten().enumerate();
        entries
            .filter_map(|(number, entry)| fiducial(entry).map_err(|error| self.report("fiducial", number, error)).ok())
            .collect()
    }

    /// Returns all edges of a kind between `count` vertices.
    pub(super) fn edges(&mut self, what: &str, list: Option<&Vec<Value>>, count: usize) -> Vec<Edge> {
        let entries = list.into_iter().flatten().enumerate();
        entries
            .filter_map(|(number, entry)| {
                edge(number, entry, count).map_err(|error| self.report(what, number, error)).ok()
            })
            .collect()
    }
}

fn vertex(entry: &Value) -> Result<Vertex, EntryError> {
    let form = || EntryError::Malformed { text: entry.to_string(), allowed: "[x, y, z, name, {parameters}]" };
    let list = entry.as_array().filter(|list| (4..=5).contains(&list.len())).ok_or_else(form)?;
    let at = (number("x", &list[0])?, number("y", &list[1])?);
    Ok(Vertex { at, name: text(&list[3]).ok_or_else(form)?, parameters: parameters(list.get(4))? })
}

fn fiducial(entry: &Value) -> Result<Fiducial, EntryError> {
    let form = || EntryError::Malformed { text: entry.to_string(), allowed: "[x, y, name]" };
    let list = entry.as_array().filter(|list| list.len() == 3).ok_or_else(form)?;
    let at = (number("x", &list[0])?, number("y", &list[1])?);
    Ok(Fiducial { at, name: text(&list[2]).ok_or_else(form)? })
}

fn edge(index: usize, entry: &Value, count: usize) -> Result<Edge, EntryError> {
    let form = || EntryError::Malformed { text: entry.to_string(), allowed: "[vertex, vertex, {parameters}]" };
    let list = entry.as_array().filter(|list| (2..=3).contains(&list.len())).ok_or_else(form)?;
    let end = |value: &Value| {
        let vertex = value.as_i64().ok_or_else(form)?;
        let known = usize::try_from(vertex).ok().filter(|vertex| *vertex < count);
        known.ok_or(EntryError::UnknownVertex { vertex, count })
    };
    Ok(Edge { number: index, ends: [end(&list[0])?, end(&list[1])?], parameters: parameters(list.get(2))? })
}

/// Returns the values of parameters, each written as `[type, value]`.
pub(super) fn parameters(entry: Option<&Value>) -> Result<Parameters, EntryError> {
    let Some(entry) = entry.filter(|entry| !entry.is_null()) else { return Ok(Parameters::new()) };
    let form = || EntryError::Malformed { text: entry.to_string(), allowed: "{parameter: [type, value], …}" };
    let written = entry.as_object().ok_or_else(form)?;
    let value = |(name, value): (&String, &Value)| match value.as_array().map(Vec::as_slice) {
        Some([_, value]) => Ok((name.clone(), value.clone())),
        _ => Err(EntryError::InvalidValue {
            field: format!("parameter {name}"),
            text: value.to_string(),
            allowed: "[type, value] with type 1 for text, 2 for a whole number, 3 for a number, 4 for true or false",
        }),
    };
    written.iter().map(value).collect()
}

/// Returns the value of a parameter; `None` if it is not given.
pub(super) fn parameter<T>(
    parameters: &Parameters,
    name: &str,
    allowed: &'static str,
    read: fn(&Value) -> Option<T>,
) -> Result<Option<T>, EntryError> {
    let Some(value) = parameters.get(name) else { return Ok(None) };
    let error = || EntryError::InvalidValue { field: format!("parameter {name}"), text: value.to_string(), allowed };
    read(value).map(Some).ok_or_else(error)
}

fn number(field: &str, value: &Value) -> Result<f64, EntryError> {
    // A number that is not finite has become null.
    let error = || EntryError::InvalidValue { field: field.to_owned(), text: value.to_string(), allowed: "a number" };
    value.as_f64().ok_or_else(error)
}

/// Returns a name: numbers and booleans are names, too.
pub(super) fn text(value: &Value) -> Option<String> {
    match value {
        Value::String(text) => Some(text.clone()),
        Value::Number(_) | Value::Bool(_) => Some(value.to_string()),
        Value::Null => Some(String::new()),
        Value::Array(_) | Value::Object(_) => None,
    }
}
