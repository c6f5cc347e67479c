//! Maps, from wherever they come, as routes for estimators and skills and as a floor for the simulator.

use crate::config::{Diagnostic, Diagnostics};
use crate::file::{self, BYTES_MAX, FileReadError};
use consort_sim::map::{self, DEFAULT_LEVEL, Map, MapError};
use consort_skills::environment::TopologicalMap;
use serde_json::{Value, json};
use std::path::Path;

/// A map that was read.
#[derive(Debug, Clone)]
pub struct LoadedMap {
    /// Places and ways, for routes.
    pub topology: TopologicalMap,
    /// The floor as the simulator takes it; a map of the published form has none.
    pub map: Option<Map>,
}

impl LoadedMap {
    /// The map of which a node tells, as `view/map` has it.
    ///
    /// # Errors
    /// In words, if it tells of none.
    pub fn from_view(view: &Value) -> Result<LoadedMap, String> {
        Map::from_json(view, "view/map").map(LoadedMap::from).map_err(|problem| problem.to_string())
    }

    /// The map in JSON, as `view/map` has it: see [`Map::show`]. One of the published form has places and lanes alone.
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

/// Whether a map of this name comes with the program.
pub fn is_shipped(name: &str) -> bool {
    map::SHIPPED.contains(&name)
}

/// Reads a map by the name of one that is shipped, or else by path.
///
/// # Errors
/// [`Problems`] with all that is wrong.
pub fn load(name: &str) -> Result<LoadedMap, Diagnostics> {
    if is_shipped(name) {
        return map::shipped(name).map(LoadedMap::from).map_err(|error| diagnostics(name, error));
    }
    parse(&read_text(name)?, name)
}

/// The text of a map file.
///
/// # Errors
/// [`Problems`] that it cannot be read, with the maps that are shipped.
pub fn read_text(name: &str) -> Result<String, Diagnostics> {
    file::read_text(Path::new(name), BYTES_MAX).map_err(|problem| match problem {
        FileReadError::Unreadable(_) => {
            let shipped = map::SHIPPED.join(", ");
            let what = format!("this map {problem}; it is the path of a file, or one of {shipped}");
            Diagnostic::for_file(name, what).into()
        }
        FileReadError::TooLarge(..) | FileReadError::StreamTooLarge(_) => Diagnostic::for_file(name, problem).into(),
    })
}

/// Reads a map from the text of a file: in our own form, as a drawing or a building by the file's ending, or in the form of
/// the published evaluation, which has `nodes` and `edges`. `file` names it in messages.
///
/// # Errors
/// [`Problems`] with all that is wrong.
pub fn parse(text: &str, file: &str) -> Result<LoadedMap, Diagnostics> {
    if is_published_format(text) {
        let topology = TopologicalMap::from_reference_json(text)
            .map_err(|error| Diagnostics::from(Diagnostic::for_file(file, error)))?;
        return Ok(LoadedMap { topology, map: None });
    }
    map::read(text, file).map(LoadedMap::from).map_err(|error| diagnostics(file, error))
}

/// Whether a text is JSON with the keys of the published map.
pub fn is_published_format(text: &str) -> bool {
    let value: Result<Value, _> = serde_json::from_str(text);
    value.is_ok_and(|value| value.get("nodes").is_some() && value.get("edges").is_some())
}

/// What is wrong with a map, as problems of its file.
pub fn diagnostics(file: &str, error: MapError) -> Diagnostics {
    match error {
        MapError::Invalid { problems, .. } => {
            Diagnostics(problems.iter().map(|problem| Diagnostic::for_file(file, problem)).collect())
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
