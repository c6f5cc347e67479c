//! A map as routes for estimators and skills, and as a floor plan.

use consort_skills::environment::TopologicalMap;
use consort_world::map::{DEFAULT_LEVEL, Map, MapError};
use serde_json::{Value, json};

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
    /// [`MapError`] if the reply has no map.
    pub fn from_view(view: &Value) -> Result<LoadedMap, MapError> {
        Map::from_json(view, "view/map").map(LoadedMap::from)
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

impl From<Map> for LoadedMap {
    fn from(map: Map) -> LoadedMap {
        LoadedMap { topology: map.topology(), map: Some(map) }
    }
}
