//! Maps, from wherever they come, as routes for estimators and skills and as a floor for the simulator.

use crate::config::{Problem, Problems};
use crate::file::{self, BYTES_MAX, ReadError};
use consort_sim::map::{self, GROUND, Map, MapError};
use consort_skills::environment::TopologicalMap;
use serde_json::{Value, json};
use std::path::Path;

/// A map that was read.
#[derive(Debug, Clone)]
pub struct Floor {
    /// Places and ways, for routes.
    pub topology: TopologicalMap,
    /// The floor as the simulator takes it; a map of the published form has none.
    pub map: Option<Map>,
}

impl Floor {
    /// The map of which a node tells, as `view/map` has it.
    ///
    /// # Errors
    /// In words, if it tells of none.
    pub fn told(view: &Value) -> Result<Floor, String> {
        Map::told(view, "view/map").map(Floor::from).map_err(|problem| problem.to_string())
    }

    /// The map in JSON, as `view/map` has it: see [`Map::show`]. One of the published form has places and lanes alone.
    pub fn show(&self) -> Value {
        if let Some(map) = &self.map {
            return map.show();
        }
        let places = self.topology.places.iter().map(|(place, pose)| {
            json!({ "name": place, "kind": "other", "x_m": pose.x, "y_m": pose.y, "yaw_rad": pose.yaw, "level": GROUND })
        });
        let lanes = self.topology.edges.iter().map(|edge| json!({ "between": [edge.a, edge.b] }));
        let poses = || self.topology.places.values();
        let (west, south) = poses().fold((f64::INFINITY, f64::INFINITY), |(x, y), pose| (x.min(pose.x), y.min(pose.y)));
        let least = f64::NEG_INFINITY;
        let (east, north) = poses().fold((least, least), |(x, y), pose| (x.max(pose.x), y.max(pose.y)));
        json!({
            "name": "published",
            "bounds_m": { "west": west, "south": south, "east": east, "north": north },
            "levels": [{ "name": GROUND, "elevation_m": 0.0 }],
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
pub fn load(name: &str) -> Result<Floor, Problems> {
    if is_shipped(name) {
        return map::shipped(name).map(Floor::from).map_err(|error| problems(name, error));
    }
    read(&text(name)?, name)
}

/// The text of a map file.
///
/// # Errors
/// [`Problems`] that it cannot be read, with the maps that are shipped.
pub fn text(name: &str) -> Result<String, Problems> {
    file::text(Path::new(name), BYTES_MAX).map_err(|problem| match problem {
        ReadError::Unreadable(_) => {
            let shipped = map::SHIPPED.join(", ");
            let what = format!("this map {problem}; it is the path of a file, or one of {shipped}");
            Problem::of(name, what).into()
        }
        ReadError::TooLarge(..) | ReadError::Endless(_) => Problem::of(name, problem).into(),
    })
}

/// Reads a map from the text of a file: in our own form, as a drawing or a building by the file's ending, or in the form of
/// the published evaluation, which has `nodes` and `edges`. `file` names it in messages.
///
/// # Errors
/// [`Problems`] with all that is wrong.
pub fn read(text: &str, file: &str) -> Result<Floor, Problems> {
    if is_published_form(text) {
        let topology =
            TopologicalMap::from_reference_json(text).map_err(|error| Problems::from(Problem::of(file, error)))?;
        return Ok(Floor { topology, map: None });
    }
    map::read(text, file).map(Floor::from).map_err(|error| problems(file, error))
}

/// Whether a text is JSON with the keys of the published map.
pub fn is_published_form(text: &str) -> bool {
    let value: Result<Value, _> = serde_json::from_str(text);
    value.is_ok_and(|value| value.get("nodes").is_some() && value.get("edges").is_some())
}

/// What is wrong with a map, as problems of its file.
pub fn problems(file: &str, error: MapError) -> Problems {
    match error {
        MapError::Unsound { problems, .. } => {
            Problems(problems.iter().map(|problem| Problem::of(file, problem)).collect())
        }
        MapError::Syntax { message, .. } => Problem::of(file, message).into(),
        other => Problem { file: String::new(), at: None, what: other.to_string() }.into(),
    }
}

impl From<Map> for Floor {
    fn from(map: Map) -> Floor {
        Floor { topology: map.topology(), map: Some(map) }
    }
}
