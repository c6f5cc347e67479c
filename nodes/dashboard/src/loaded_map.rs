//! A map as routes for estimators and skills, and as a floor plan.

use consort_protocol::view::{LaneView, LevelView, MapBounds, MapView, PlaceView};
use consort_skills::environment::TopologicalMap;
use consort_world::map::{DEFAULT_LEVEL, Map, MapError};
use serde_json::Value;
use std::collections::BTreeSet;

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

    /// Returns the view of the map. A map of the published format has places and lanes only.
    pub fn to_view(&self) -> MapView {
        if let Some(map) = &self.map {
            return map.to_view();
        }
        let places = self.topology.places.iter().map(|(place, pose)| PlaceView {
            name: place.to_string(),
            kind: "other".to_owned(),
            x_m: pose.x,
            y_m: pose.y,
            yaw_rad: pose.yaw,
            level: DEFAULT_LEVEL.to_owned(),
        });
        let lanes = self.topology.edges.iter().map(|edge| LaneView {
            between: (edge.a.to_string(), edge.b.to_string()),
            length_m: edge.length_m,
            one_way: edge.one_way,
            speed_limit_mps: None,
            graphs: BTreeSet::new(),
        });
        let poses = || self.topology.places.values();
        let (west, south) = poses().fold((f64::INFINITY, f64::INFINITY), |(x, y), pose| (x.min(pose.x), y.min(pose.y)));
        let least = f64::NEG_INFINITY;
        let (east, north) = poses().fold((least, least), |(x, y), pose| (x.max(pose.x), y.max(pose.y)));
        MapView {
            name: "published".to_owned(),
            bounds_m: MapBounds { west, south, east, north },
            levels: vec![LevelView { name: DEFAULT_LEVEL.to_owned(), elevation_m: 0.0 }],
            places: places.collect(),
            lanes: lanes.collect(),
            doors: vec![],
            lifts: vec![],
            walls: vec![],
        }
    }
}

impl From<Map> for LoadedMap {
    fn from(map: Map) -> LoadedMap {
        LoadedMap { topology: map.topology(), map: Some(map) }
    }
}
