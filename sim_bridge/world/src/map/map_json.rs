//! Maps as JSON: written for programs that draw a map, and read back from such JSON.

use super::file::{DoorEntry, LaneEntry, LevelEntry, LiftEntry, MapFile, PlaceEntry};
use super::model::{Lane, LevelIndex, Map};
use super::read::MapError;
use serde::Deserialize;
use serde_json::{Value, json};

/// The JSON of [`Map::to_json`]. Additional fields are ignored.
#[derive(Deserialize)]
struct MapJson {
    name: String,
    levels: Vec<LevelEntry>,
    places: Vec<PlaceEntry>,
    lanes: Vec<LaneEntry>,
    doors: Vec<DoorJson>,
    lifts: Vec<LiftEntry>,
    walls: Vec<WallJson>,
}

#[derive(Deserialize)]
struct DoorJson {
    name: String,
    on: Vec<(String, String)>,
    opening_s: f64,
    posts: Vec<((f64, f64), (f64, f64))>,
}

#[derive(Deserialize)]
struct WallJson {
    level: String,
    line: Vec<(f64, f64)>,
}

impl Map {
    /// Builds a map from the JSON of [`to_json`](Self::to_json); `from` names the source in errors.
    /// The JSON does not contain the required headings on lanes, so the map has none.
    ///
    /// # Errors
    /// [`MapError`] if the JSON has another form or describes an invalid map.
    pub fn from_json(json: &Value, from: &str) -> Result<Map, MapError> {
        let syntax = |error: serde_json::Error| MapError::Syntax { file: from.to_owned(), message: error.to_string() };
        let MapJson { name, mut levels, places, lanes, doors, lifts, walls } =
            MapJson::deserialize(json).map_err(syntax)?;
        for WallJson { level, line } in walls {
            if let Some(level) = levels.iter_mut().find(|known| known.name == level) {
                level.walls.push(line);
            }
        }
        let door = |DoorJson { name, on, opening_s, posts }: DoorJson| {
            // A door at several positions has no posts of its own.
            let span = posts.first().copied().filter(|_| posts.len() == 1);
            DoorEntry { name, on, opening_s, span }
        };
        let doors = doors.into_iter().map(door).collect();
        MapFile { name, levels, walls: vec![], places, lanes, doors, lifts }.check(from)
    }

    /// Returns the whole map as JSON: levels, places, lanes, doors (with their posts), lifts and
    /// walls, under the names used in map files. Positions are in metres, x to the east and y to
    /// the north.
    pub fn to_json(&self) -> Value {
        let name = |level: LevelIndex| &self.level(level).name;
        let levels = self.levels().iter().map(|level| json!({ "name": level.name, "elevation_m": level.elevation_m }));
        let places = self.places().iter().map(|place| {
            json!({
                "name": place.id,
                "kind": place.kind,
                "x_m": place.pose.x,
                "y_m": place.pose.y,
                "yaw_rad": place.pose.yaw,
                "level": name(place.level),
            })
        });
        let lane = |lane: &Lane| {
            json!({
                "between": [lane.from, lane.to],
                "length_m": lane.length.get(),
                "one_way": !lane.two_way,
                "speed_limit_mps": lane.speed_limit.map(|limit| limit.get()),
            })
        };
        let doors = self.doors().iter().map(|door| {
            json!({
                "name": door.name,
                "on": door.lanes,
                "posts": self.door_posts(door),
                "opening_s": door.opening.get(),
                "level": door.lanes.first().and_then(|(from, _)| self.level_of(from)).map(name),
            })
        });
        let lifts = self.lifts().iter().map(|lift| {
            json!({
                "name": lift.name,
                "stops": lift.stops,
                "capacity": lift.capacity,
                "opening_s": lift.opening.get(),
                "speed_mps": lift.speed.get(),
            })
        });
        let walls = self.level_indices().flat_map(|level| {
            self.walls_on(level).map(move |line| json!({ "level": name(level), "line": line })).collect::<Vec<_>>()
        });
        let ((west, south), (east, north)) = self.bounds();
        json!({
            "name": self.name(),
            "bounds_m": { "west": west, "south": south, "east": east, "north": north },
            "levels": levels.collect::<Vec<_>>(),
            "places": places.collect::<Vec<_>>(),
            "lanes": self.lanes().iter().map(lane).collect::<Vec<_>>(),
            "doors": doors.collect::<Vec<_>>(),
            "lifts": lifts.collect::<Vec<_>>(),
            "walls": walls.collect::<Vec<_>>(),
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::map::{Map, SHIPPED, shipped};
    use serde_json::json;

    #[test]
    fn a_map_read_back_from_its_json_is_equal() {
        for name in SHIPPED {
            let mut json = shipped(name).unwrap().to_json();
            let read_back = Map::from_json(&json, "view/map").unwrap();
            assert_eq!(read_back.to_json(), json, "{name}");
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
            let json = map.to_json();
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
