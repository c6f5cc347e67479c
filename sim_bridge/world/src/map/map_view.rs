//! Maps as views: written for programs that draw a map, and read back from such a view.

use super::file::{DoorEntry, LaneEntry, LevelEntry, LiftEntry, MapFile, PlaceEntry};
use super::model::{Door, Lane, LevelIndex, Lift, Map, MapLevel, MapPlace, PlaceKind};
use super::read::MapError;
use consort_protocol::view::{DoorView, LaneView, LevelView, LiftView, MapBounds, MapView, PlaceView, WallView};
use serde::Deserialize;
use serde_json::Value;

impl Map {
    /// Builds a map from the JSON of a [`MapView`]; `from` names the source in errors.
    ///
    /// # Errors
    /// [`MapError`] if the JSON has another form or describes an invalid map.
    pub fn from_json(json: &Value, from: &str) -> Result<Map, MapError> {
        let view = MapView::deserialize(json)
            .map_err(|error| MapError::Syntax { file: from.to_owned(), message: error.to_string() })?;
        Map::from_view(view, from)
    }

    /// Builds a map from its view; `from` names the source in errors. A view does not contain the
    /// required headings on lanes and the names of docks, so the map has none. A place of an unknown kind gets
    /// [`PlaceKind::Other`].
    ///
    /// # Errors
    /// [`MapError`] if the map is invalid.
    pub fn from_view(view: MapView, from: &str) -> Result<Map, MapError> {
        let MapView { name, levels, places, lanes, doors, lifts, walls, .. } = view;
        let level = |LevelView { name, elevation_m }: LevelView| LevelEntry { name, elevation_m, walls: vec![] };
        let mut levels: Vec<LevelEntry> = levels.into_iter().map(level).collect();
        for WallView { level, line } in walls {
            if let Some(level) = levels.iter_mut().find(|known| known.name == level) {
                level.walls.push(line);
            }
        }
        let place = |PlaceView { name, kind, x_m, y_m, yaw_rad, level }: PlaceView| {
            let kind = PlaceKind::ALL.into_iter().find(|known| known.as_str() == kind).unwrap_or_default();
            PlaceEntry { name, kind, x_m, y_m, yaw_rad, level: Some(level), dock: None }
        };
        let lane = |LaneView { between, length_m, one_way, speed_limit_mps, graphs }: LaneView| LaneEntry {
            between,
            length_m: Some(length_m),
            one_way,
            speed_limit_mps,
            facing: None,
            graphs,
        };
        let door = |DoorView { name, on, posts, opening_s, level }: DoorView| {
            // A door at several positions has no posts of its own.
            let span = posts.first().copied().filter(|_| posts.len() == 1);
            let level = level.filter(|_| on.is_empty());
            DoorEntry { name, on, opening_s, span, level }
        };
        let lift = |LiftView { name, stops, capacity, opening_s, speed_mps }: LiftView| LiftEntry {
            name,
            stops,
            capacity,
            opening_s,
            speed_mps,
        };
        let file = MapFile {
            name,
            levels,
            walls: vec![],
            places: places.into_iter().map(place).collect(),
            lanes: lanes.into_iter().map(lane).collect(),
            doors: doors.into_iter().map(door).collect(),
            lifts: lifts.into_iter().map(lift).collect(),
        };
        file.check(from)
    }

    /// Returns the view of the whole map.
    pub fn to_view(&self) -> MapView {
        let name = |level: LevelIndex| self.level(level).name.clone();
        let place = |place: &MapPlace| PlaceView {
            name: place.id.to_string(),
            kind: place.kind.as_str().to_owned(),
            x_m: place.pose.x,
            y_m: place.pose.y,
            yaw_rad: place.pose.yaw,
            level: name(place.level),
        };
        let lane = |lane: &Lane| LaneView {
            between: (lane.from.to_string(), lane.to.to_string()),
            length_m: lane.length.get(),
            one_way: !lane.two_way,
            speed_limit_mps: lane.speed_limit.map(|limit| limit.get()),
            graphs: lane.graphs.clone(),
        };
        let door = |door: &Door| DoorView {
            name: door.name.clone(),
            on: door.lanes.iter().map(|(from, to)| (from.to_string(), to.to_string())).collect(),
            posts: self.door_posts(door),
            opening_s: door.opening.get(),
            level: Some(name(door.level)),
        };
        let lift = |lift: &Lift| LiftView {
            name: lift.name.clone(),
            stops: lift.stops.iter().map(ToString::to_string).collect(),
            capacity: lift.capacity,
            opening_s: lift.opening.get(),
            speed_mps: lift.speed.get(),
        };
        let walls = self.level_indices().flat_map(|level| {
            self.walls_on(level).map(move |line| WallView { level: name(level), line: line.to_vec() })
        });
        let ((west, south), (east, north)) = self.bounds();
        let level = |level: &MapLevel| LevelView { name: level.name.clone(), elevation_m: level.elevation_m };
        MapView {
            name: self.name().to_owned(),
            bounds_m: MapBounds { west, south, east, north },
            levels: self.levels().iter().map(level).collect(),
            places: self.places().iter().map(place).collect(),
            lanes: self.lanes().iter().map(lane).collect(),
            doors: self.doors().iter().map(door).collect(),
            lifts: self.lifts().iter().map(lift).collect(),
            walls: walls.collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::map::{Map, SHIPPED, shipped};
    use serde_json::json;

    #[test]
    fn a_map_read_back_from_its_json_is_equal() {
        for name in SHIPPED {
            let view = shipped(name).unwrap().to_view();
            let mut json = serde_json::to_value(&view).unwrap();
            let read_back = Map::from_json(&json, "view/map").unwrap();
            assert_eq!(read_back.to_view(), view, "{name}");
            json["seen_by"] = json!("station-1");
            assert_eq!(Map::from_json(&json, "view/map").unwrap(), read_back, "{name}");
        }
        let error = Map::from_json(&json!({ "error": "s1 was given no map" }), "view/map").unwrap_err().to_string();
        assert_eq!(error, "map view/map: missing field `name`");
    }

    #[test]
    fn the_json_of_a_map_contains_everything_with_its_position() {
        for name in SHIPPED {
            let map = shipped(name).unwrap();
            let json = serde_json::to_value(map.to_view()).unwrap();
            let of = |list: &str| json[list].as_array().unwrap().clone();
            assert_eq!(of("places").len(), map.places().len(), "{name}");
            assert_eq!(of("lanes").len(), map.lanes().len(), "{name}");
            assert_eq!(of("doors").len(), map.doors().len(), "{name}");
            assert_eq!(of("lifts").len(), map.lifts().len(), "{name}");
            assert_eq!(of("walls").len(), map.walls().len(), "{name}");
            let placed = |place: &serde_json::Value| place["x_m"].is_f64() && place["y_m"].is_f64();
            assert!(of("places").iter().all(placed), "{name}");
            assert!(of("doors").iter().all(|door| !door["posts"].as_array().unwrap().is_empty()), "{name}");
            let named = of("places").iter().all(|place| map.level_named(place["level"].as_str().unwrap()).is_some());
            assert!(named, "{name}");
        }
    }
}
