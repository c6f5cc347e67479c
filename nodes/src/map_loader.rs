//! Loads maps: as routes for estimators and skills, and as floors for the simulator.

use crate::config::{Diagnostic, Diagnostics};
use crate::file::{self, BYTES_MAX, FileReadError};
use consort_skills::environment::TopologicalMap;
use consort_world::map::{self, DEFAULT_LEVEL, Map, MapError};
use serde_json::{Value, json};
use std::path::Path;

/// A loaded map.
#[derive(Debug, Clone)]
pub struct LoadedMap {
    /// Places and lanes, for routes.
    pub topology: TopologicalMap,
    /// The floor plan for the simulator; a map of the published format has none.
    pub map: Option<Map>,
}

impl LoadedMap {
    /// Parses the map of a node's reply to `view/map`.
    ///
    /// # Errors
    /// A message, if the reply has no map.
    pub fn from_view(view: &Value) -> Result<LoadedMap, String> {
        Map::from_json(view, "view/map").map(LoadedMap::from).map_err(|problem| problem.to_string())
    }

    /// Returns the map in JSON, as in `view/map`: see [`Map::to_json`]. A map of the published
    /// format has places and lanes only.
    pub fn to_json(&self) -> Value {
        if let Some(map) = &self.map {
            return map.to_json();
        }
        let places = self.topology.places.iter().map(|(place, pose)| {
            json!({ "name": place, "kind": "other", "x_m": pose.x, "y_m": pose.y, "yaw_rad": pose.yaw, "level": DEFAULT_LEVEL })
        });
        let lanes = self.topology.edges.iter().map(|edge| json!({ "between": [edge.a, edge.b] }));
        let poses = || self.topology.places.values();
        let (west, south) = poses().fold((f64::INFINITY, f64::INFINITY), |(x, y), pose| (x.min(pose.x), y.min(pose.y)));
        let least = f64::NEG_INFINITY;
        let (east, north) = poses().fold((least, least), |(x, y), pose| (x.max(pose.x), y.max(pose.y)));
        json!({
            "name": "published",
            "bounds_m": { "west": west, "south": south, "east": east, "north": north },
            "levels": [{ "name": DEFAULT_LEVEL, "elevation_m": 0.0 }],
            "places": places.collect::<Vec<_>>(),
            "lanes": lanes.collect::<Vec<_>>(),
            "doors": [],
            "lifts": [],
            "walls": [],
        })
    }
}

/// Checks whether a map of this name is bundled.
pub fn is_shipped(name: &str) -> bool {
    map::SHIPPED.contains(&name)
}

/// Loads a bundled map by name, or else a file by path.
///
/// # Errors
/// [`Diagnostics`] with all problems.
pub fn load(name: &str) -> Result<LoadedMap, Diagnostics> {
    if is_shipped(name) {
        return map::shipped(name).map(LoadedMap::from).map_err(|error| diagnostics(name, error));
    }
    parse(&read_text(name)?, name)
}

/// Reads the text of a map file.
///
/// # Errors
/// [`Diagnostics`] if it cannot be read, with the bundled maps.
pub fn read_text(name: &str) -> Result<String, Diagnostics> {
    file::read_text(Path::new(name), BYTES_MAX).map_err(|problem| match problem {
        FileReadError::Unreadable(_) => {
            let shipped = map::SHIPPED.join(", ");
            let what = format!("this map {problem}; give the path of a file, or a bundled map: {shipped}");
            Diagnostic::for_file(name, what).into()
        }
        FileReadError::TooLarge(..) | FileReadError::StreamTooLarge(_) => Diagnostic::for_file(name, problem).into(),
    })
}

/// Parses a map from the text of a file: in Consort's own format, as a drawing or a building by the
/// file's extension, or in the format of the published evaluation, which has `nodes` and `edges`.
/// `file` is its name in messages.
///
/// # Errors
/// [`Diagnostics`] with all problems.
pub fn parse(text: &str, file: &str) -> Result<LoadedMap, Diagnostics> {
    if is_published_format(text) {
        let topology = TopologicalMap::from_reference_json(text)
            .map_err(|error| Diagnostics::from(Diagnostic::for_file(file, error)))?;
        return Ok(LoadedMap { topology, map: None });
    }
    map::read(text, file).map(LoadedMap::from).map_err(|error| diagnostics(file, error))
}

/// Checks whether a text is JSON with the keys of the published map.
pub fn is_published_format(text: &str) -> bool {
    let value: Result<Value, _> = serde_json::from_str(text);
    value.is_ok_and(|value| value.get("nodes").is_some() && value.get("edges").is_some())
}

/// Converts a map error to diagnostics of its file.
pub fn diagnostics(file: &str, error: MapError) -> Diagnostics {
    match error {
        MapError::Invalid { diagnostics, .. } => {
            Diagnostics(diagnostics.iter().map(|error| Diagnostic::for_file(file, error)).collect())
        }
        MapError::Syntax { message, .. } => Diagnostic::for_file(file, message).into(),
        other => Diagnostic { file: String::new(), position: None, message: other.to_string() }.into(),
    }
}

impl From<Map> for LoadedMap {
    fn from(map: Map) -> LoadedMap {
        LoadedMap { topology: map.topology(), map: Some(map) }
    }
}
