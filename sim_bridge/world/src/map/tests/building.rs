//! Tests of levels, doors and lifts: valid files, and every error of invalid files.

use super::{diagnostics, place};
use crate::map::*;
use consort_protocol::units::{MetresPerSecond, Seconds};

const CLINIC: &str = "
name: clinic
levels:
  - { name: ground }
  - { name: first, elevation_m: 4, walls: [[[0, 5], [9, 5]]] }
walls: [[[0, 0], [9, 0]], [[0, 3], [9, 3]]]
places:
  - { name: Hall, kind: corridor, x_m: 0, y_m: 1 }
  - { name: Ward, kind: room, x_m: 8, y_m: 1 }
  - { name: Lift 0, kind: other, x_m: 0, y_m: 2 }
  - { name: Lift 1, kind: other, x_m: 0, y_m: 2, level: first }
  - { name: Station, kind: charger, x_m: 4, y_m: 2, level: first }
lanes:
  - { between: [Hall, Ward], speed_limit_mps: 0.5, facing: backward }
  - { between: [Hall, Lift 0] }
  - { between: [Lift 1, Station] }
doors:
  - { name: Near, on: [[Ward, Hall]], opening_s: 2.5, span: [[2, 0], [2, 2]] }
  - { name: Middle, on: [[Hall, Ward]] }
lifts:
  - { name: Lift A, stops: [Lift 0, Lift 1], capacity: 2, opening_s: 3, speed_mps: 0.5 }
";

fn clinic() -> Map {
    read(CLINIC, "clinic.yaml").unwrap()
}

fn seconds(value: f64) -> Seconds {
    Seconds::new(value).unwrap()
}

#[test]
fn places_and_walls_are_on_their_level_or_on_the_first() {
    let map = clinic();
    let level = |name| map.level_named(name).unwrap();
    assert_eq!(map.levels()[1], MapLevel { name: "first".into(), elevation_m: 4.0 });
    assert_eq!(map.level_indices().collect::<Vec<_>>(), [level("ground"), level("first")]);
    assert_eq!(map.level_of(&place("Hall")), Some(level("ground")));
    assert_eq!(map.level_of(&place("Station")), Some(level("first")));
    assert_eq!(map.place(&place("Station")).unwrap().kind, PlaceKind::Charger);
    assert_eq!(map.walls_on(level("ground")).count(), 2);
    assert_eq!(map.walls_on(level("first")).collect::<Vec<_>>(), [[(0.0, 5.0), (9.0, 5.0)]]);
    assert_eq!(map.walls().len(), 3);
    assert_eq!(map.lanes_on(level("first")).map(|lane| lane.to.as_str()).collect::<Vec<_>>(), ["Station"]);
}

#[test]
fn a_map_without_levels_has_a_ground_level() {
    let map = shipped("hospital").unwrap();
    assert_eq!(map.levels(), [MapLevel { name: DEFAULT_LEVEL.into(), elevation_m: 0.0 }]);
    assert_eq!(map.walls_on(LevelIndex::default()).count(), map.walls().len());
}

#[test]
fn doors_are_listed_in_driving_order() {
    let map = clinic();
    let doors_on_lane = |from, to| -> Vec<(String, f64)> {
        let doors = map.doors_on(&place(from), &place(to));
        doors.iter().map(|doors_on_lane| (doors_on_lane.door.name.clone(), doors_on_lane.at)).collect()
    };
    assert_eq!(doors_on_lane("Hall", "Ward"), [("Near".to_owned(), 0.25), ("Middle".to_owned(), 0.5)]);
    assert_eq!(doors_on_lane("Ward", "Hall"), [("Middle".to_owned(), 0.5), ("Near".to_owned(), 0.75)]);
    assert_eq!(doors_on_lane("Hall", "Lift 0"), []);
    assert_eq!(doors_on_lane("Hall", "Station"), []);
    let near = map.door("Near").unwrap();
    assert_eq!((near.opening, &near.lanes), (seconds(2.5), &vec![(place("Hall"), place("Ward"))]));
    assert_eq!(map.door("Middle").unwrap().opening, seconds(3.0));
}

#[test]
fn a_lane_named_from_both_ends_has_its_door_once() {
    let text = CLINIC.replace("on: [[Hall, Ward]]", "on: [[Hall, Ward], [Ward, Hall]]");
    let map = read(&text, "clinic.yaml").unwrap();
    assert_eq!(map.door("Middle").unwrap().lanes, [(place("Hall"), place("Ward"))]);
    assert_eq!(map.doors_on(&place("Hall"), &place("Ward")).len(), 2);
}

#[test]
fn a_ride_takes_two_door_times_and_the_travel_time() {
    let map = clinic();
    let (low, high) = (place("Lift 0"), place("Lift 1"));
    let ride = map.ride(&high, &low).unwrap();
    assert_eq!((ride.lift.name.as_str(), ride.time, ride.lift.capacity), ("Lift A", seconds(14.0), 2));
    assert_eq!(map.ride(&low, &low), None);
    assert_eq!(map.ride(&low, &place("Hall")), None);
    assert_eq!(map.lift_at(&low), map.lift("Lift A"));
    assert_eq!(map.lift_at(&place("Hall")), None);
}

#[test]
fn a_lane_keeps_its_speed_limit_and_heading() {
    let map = clinic();
    let lane = map.lane(&place("Ward"), &place("Hall")).unwrap();
    assert_eq!((lane.speed_limit, lane.facing), (MetresPerSecond::new(0.5).ok(), Some(Facing::Backward)));
    assert_eq!(lane.facing.map(Facing::reversed), Some(Facing::Forward));
}

#[test]
fn a_written_map_is_read_back_unchanged() {
    let written: MapFile = serde_saphyr::from_str(CLINIC).unwrap();
    let yaml = serde_saphyr::to_string(&written).unwrap();
    assert_eq!(read(&yaml, "again.yaml").unwrap(), clinic());
}

#[test]
fn a_level_without_its_lift_is_disconnected() {
    let without = CLINIC.split("lifts:").next().unwrap();
    assert_eq!(
        diagnostics(without),
        [
            "map bad.yaml: place \"Lift 1\" is not connected with the rest of the map",
            "map bad.yaml: place \"Station\" is not connected with the rest of the map",
        ]
    );
}

#[test]
fn every_error_in_levels_doors_and_lifts_is_reported() {
    let text = CLINIC
        .replace("  - { name: first,", "  - { name: ground }\n  - { name: first,")
        .replace("level: first }\nlanes", "level: firs }\nlanes")
        .replace("speed_limit_mps: 0.5", "speed_limit_mps: 0")
        .replace("[Lift 1, Station]", "[Hall, Lift 1]");
    let text = text.split("doors:").next().unwrap().to_owned()
        + "
doors:
  - { name: ' x', on: [[Hall, Lift 0]] }
  - { name: None, on: [] }
  - { name: Slow, on: [[Hall, Lift 0]], opening_s: -1 }
  - { name: Slow, on: [[Hall, Lift 0]] }
  - { name: Lost, on: [[Hall, Wart]] }
  - { name: Astray, on: [[Lift 0, Ward]] }
  - { name: Beside, on: [[Hall, Lift 0]], span: [[3, 0], [3, 2]] }
lifts:
  - { name: Low, stops: [Hall, Ward] }
  - { name: Lost, stops: [Lift 0, Lift 9] }
  - { name: Nobody, stops: [Lift 0, Lift 1], capacity: 0 }
  - { name: Good, stops: [Lift 0, Lift 1] }
  - { name: Taken, stops: [Lift 0, Lift 1] }
  - { name: Still, stops: [Hall, Lift 1], speed_mps: 0 }
";
    assert_eq!(
        diagnostics(&text),
        [
            "level \"ground\" occurs more than once",
            "place \"Station\": there is no level \"firs\"; did you mean \"first\"?",
            "lane between \"Hall\" and \"Ward\": speed limit is 0 m/s, allowed: a number above 0",
            "lane between \"Hall\" and \"Lift 1\": its ends are on levels \"ground\" and \"first\"; only lifts connect levels",
            "\" x\" is not a name for a door: allowed are 1 to 64 characters, no control characters, no space at either end",
            "door \"None\" has no lanes: add the lanes through it",
            "door \"Slow\": opening_s is -1, allowed: a number from 0 to 3600",
            "door \"Slow\" occurs more than once",
            "door \"Lost\": there is no lane between \"Hall\" and \"Wart\"; there is no place \"Wart\"; did you mean \"Ward\"?",
            "door \"Astray\": there is no lane between \"Lift 0\" and \"Ward\"; lanes from \"Lift 0\" lead to \"Hall\"",
            "door \"Beside\": lane between \"Hall\" and \"Lift 0\" does not pass between its posts",
            "lift \"Low\" has stops on 1 level(s), needed: 2 or more",
            "lift \"Lost\": there is no place \"Lift 9\"; did you mean \"Lift 0\"?",
            "lift \"Nobody\": capacity is 0, allowed: a number of robots from 1",
            "lift \"Taken\": place \"Lift 0\" is a stop of lift \"Good\" already",
            "lift \"Taken\": place \"Lift 1\" is a stop of lift \"Good\" already",
            "lift \"Still\": speed_mps is 0, allowed: a number from 0.01 to 100",
            "lift \"Still\": place \"Lift 1\" is a stop of lift \"Good\" already",
        ]
        .map(|error| format!("map bad.yaml: {error}"))
    );
}
