//! A map in JSON, for programs that draw it; and such a map taken up again, by one who was told of it.

use super::{DoorEntry, Lane, LaneEntry, LevelEntry, LevelIndex, LiftEntry, Map, MapError, MapFile, PlaceEntry};
use serde::Deserialize;
use serde_json::{Value, json};

/// What [`Map::show`] says, with what else may stand beside it.
#[derive(Deserialize)]
struct Shown {
    name: String,
    levels: Vec<LevelEntry>,
    places: Vec<PlaceEntry>,
    lanes: Vec<LaneEntry>,
    doors: Vec<ShownDoor>,
    lifts: Vec<LiftEntry>,
    walls: Vec<ShownWall>,
}

#[derive(Deserialize)]
struct ShownDoor {
    name: String,
    on: Vec<(String, String)>,
    opening_s: f64,
    posts: Vec<((f64, f64), (f64, f64))>,
}

#[derive(Deserialize)]
struct ShownWall {
    level: String,
    line: Vec<(f64, f64)>,
}

impl Map {
    /// The map of which [`show`](Self::show) was told; `from` names it in errors. Which way robots must face on lanes is not
    /// told.
    ///
    /// # Errors
    /// [`MapError`] if it is none, or of no sound map.
    pub fn from_json(shown: &Value, from: &str) -> Result<Map, MapError> {
        let syntax =
            |problem: serde_json::Error| MapError::Syntax { file: from.to_owned(), message: problem.to_string() };
        let Shown { name, mut levels, places, lanes, doors, lifts, walls } =
            Shown::deserialize(shown).map_err(syntax)?;
        for ShownWall { level, line } in walls {
            if let Some(level) = levels.iter_mut().find(|known| known.name == level) {
                level.walls.push(line);
            }
        }
        let door = |ShownDoor { name, on, opening_s, posts }: ShownDoor| {
            // One that stands in several places has no posts of its own.
            let span = posts.first().copied().filter(|_| posts.len() == 1);
            DoorEntry { name, on, opening_s, span }
        };
        let doors = doors.into_iter().map(door).collect();
        MapFile { name, levels, walls: vec![], places, lanes, doors, lifts }.check(from)
    }

    /// All that is on it: levels, places, lanes, doors (with the posts between which they stand), lifts and walls, under the
    /// names that a map file has for them; metres, x to the east and y to the north.
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
    fn a_map_that_was_shown_can_be_taken_up_again() {
        for name in SHIPPED {
            let mut shown = shipped(name).unwrap().to_json();
            let told = Map::from_json(&shown, "view/map").unwrap();
            assert_eq!(told.to_json(), shown, "{name}");
            // As any node marks it.
            shown["seen_by"] = json!("station-1");
            assert_eq!(Map::from_json(&shown, "view/map").unwrap(), told, "{name}");
        }
        let problem = Map::from_json(&json!({ "error": "s1 was given no map" }), "view/map").unwrap_err().to_string();
        assert_eq!(problem, "map view/map: missing field `name`");
    }

    #[test]
    fn everything_on_a_map_is_shown_with_its_place() {
        for name in SHIPPED {
            let map = shipped(name).unwrap();
            let shown = map.to_json();
            let of = |list: &str| shown[list].as_array().unwrap().clone();
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
