//! Tests of map files: valid files, and every error of invalid files.

mod building;

use super::*;
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_protocol::units::Metres;

const WARD: &str = "
name: ward
places:
  - { name: A, kind: corridor, x_m: 0, y_m: 0 }
  - { name: B, kind: room, x_m: 3, y_m: 4, yaw_rad: 1.5 }
lanes:
  - { between: [A, B] }
";

fn place(name: &str) -> PlaceId {
    PlaceId::new(name).unwrap()
}

fn diagnostics(text: &str) -> Vec<String> {
    read(text, "bad.yaml").unwrap_err().to_string().lines().map(str::to_owned).collect()
}

#[test]
fn a_lane_is_two_way_and_straight_by_default() {
    let map = read(WARD, "ward.yaml").unwrap();
    let length = Metres::new(5.0).unwrap();
    let lane = Lane {
        from: place("A"),
        to: place("B"),
        length,
        two_way: true,
        speed_limit: None,
        facing: None,
        graphs: Default::default(),
    };
    assert_eq!(map.lanes(), std::slice::from_ref(&lane));
    assert_eq!(map.lane(&place("B"), &place("A")), Some(&lane));
    assert_eq!(map.place(&place("B")).unwrap().pose, Pose::new(3.0, 4.0, 1.5));
    assert_eq!(map.bounds(), ((0.0, 0.0), (3.0, 4.0)));
}

#[test]
fn a_json_file_gives_the_same_map() {
    let written: MapFile = serde_saphyr::from_str(WARD).unwrap();
    let json = serde_json::to_string(&written).unwrap();
    assert_eq!(read(&json, "ward.json").unwrap(), read(WARD, "ward.yaml").unwrap());
}

#[test]
fn the_shipped_hospital_has_its_rooms_and_bounds() {
    let map = shipped("hospital").unwrap();
    let of = |kind| map.places().iter().filter(|place| place.kind == kind).count();
    assert_eq!([PlaceKind::Room, PlaceKind::Lab, PlaceKind::Dock].map(of), [14, 1, 1]);
    let rooms = (1..=6).map(|n| format!("IC Room {n}")).chain((1..=8).map(|n| format!("PC Room {n}")));
    for room in rooms.chain(["Laboratory".to_owned(), "Dock".to_owned()]) {
        assert!(map.place(&place(&room)).is_some(), "{room}");
    }
    assert_eq!(map.bounds(), ((0.0, 0.0), (36.0, 35.0)));
    assert!(shipped("castle").unwrap_err().to_string().ends_with("there are: hospital, clinic"));
}

#[test]
fn no_lane_of_the_shipped_hospital_runs_through_a_wall() {
    let map = shipped("hospital").unwrap();
    let side = |(ax, ay): (f64, f64), (bx, by): (f64, f64), (x, y): (f64, f64)| {
        ((bx - ax) * (y - ay) - (by - ay) * (x - ax)).signum()
    };
    for lane in map.lanes() {
        let [a, b] = [&lane.from, &lane.to].map(|end| map.place(end).unwrap().pose).map(|pose| (pose.x, pose.y));
        for (c, d) in map.walls().iter().flat_map(|wall| wall.iter().copied().zip(wall.iter().copied().skip(1))) {
            let cross = side(a, b, c) != side(a, b, d) && side(c, d, a) != side(c, d, b);
            assert!(!cross, "{} to {} crosses the wall {c:?} to {d:?}", lane.from, lane.to);
        }
    }
}

#[test]
fn every_error_is_reported_with_file_and_position() {
    let text = "
name: bad map
walls: [[[0, 0], [.nan, 1]]]
places:
  - { name: Room 1, kind: room, x_m: 0, y_m: 0 }
  - { name: Room 1, kind: room, x_m: 1, y_m: 0 }
  - { name: Room 2, kind: room, x_m: .inf, y_m: 0 }
  - { name: ' x', kind: room, x_m: 3, y_m: 0 }
  - { name: Hall, kind: corridor, x_m: 0, y_m: 6 }
  - { name: Hatch, kind: other, x_m: 0, y_m: 6 }
lanes:
  - { between: [Room 1, Hal] }
  - { between: [Room 1, Room 1] }
  - { between: [Room 1, Hall], length_m: -3 }
  - { between: [Room 1, Hall], length_m: 5 }
  - { between: [Hall, Hatch] }
  - { between: [Hall, Room 1] }
  - { between: [Room 1, Hall] }
";
    assert_eq!(
        diagnostics(text),
        [
            "map bad.yaml: \"bad map\" is not a name for a map: allowed are 1 to 64 characters of A-Z, a-z, 0-9, `_`, `.` and `-`",
            "map bad.yaml: wall 1: a corner is at (NaN, 1), allowed: numbers from -100000 to 100000",
            "map bad.yaml: place \"Room 1\" occurs more than once",
            "map bad.yaml: place \"Room 2\": x_m is inf, allowed: a number from -100000 to 100000",
            "map bad.yaml: \" x\" cannot name a place: it begins or ends with space; allowed are 1 to 64 characters except control characters, without space at either end",
            "map bad.yaml: lane between \"Room 1\" and \"Hal\": there is no place \"Hal\"; did you mean \"Hall\"?",
            "map bad.yaml: lane between \"Room 1\" and \"Room 1\": both ends are the same place",
            "map bad.yaml: lane between \"Room 1\" and \"Hall\": length is -3 m, allowed: a number above 0 and up to 100000",
            "map bad.yaml: lane between \"Room 1\" and \"Hall\": 5 m are less than the straight line of 6.000 m",
            "map bad.yaml: lane between \"Hall\" and \"Hatch\": length is 0 m, allowed: a number above 0 and up to 100000",
            "map bad.yaml: lane between \"Room 1\" and \"Hall\" occurs more than once",
        ]
    );
}

#[test]
fn a_place_without_a_route_there_or_back_is_reported() {
    let text = "
name: islands
places:
  - { name: Alone, kind: other, x_m: 9, y_m: 9 }
  - { name: A, kind: other, x_m: 0, y_m: 0 }
  - { name: B, kind: other, x_m: 1, y_m: 0 }
  - { name: Trap, kind: other, x_m: 2, y_m: 0 }
  - { name: Source, kind: other, x_m: 3, y_m: 0 }
lanes:
  - { between: [A, B] }
  - { between: [B, Trap], one_way: true }
  - { between: [Source, B], one_way: true }
";
    assert_eq!(
        diagnostics(text),
        [
            "map bad.yaml: place \"Alone\" is not connected with the rest of the map",
            "map bad.yaml: place \"Trap\" cannot be left for the rest of the map",
            "map bad.yaml: place \"Source\" cannot be reached from the rest of the map",
        ]
    );
}

#[test]
fn unknown_fields_and_kinds_are_rejected() {
    let error = read(&WARD.replace("kind: room", "kind: cellar"), "w.yaml").unwrap_err().to_string();
    assert!(error.starts_with("map w.yaml: ") && error.contains("cellar") && error.contains("dock"), "{error}");
    let error = read(&WARD.replace("y_m: 4", "y_m: 4, floor: 2"), "w.yaml").unwrap_err().to_string();
    assert!(error.contains("floor"), "{error}");
    assert_eq!(diagnostics("{name: none, places: []}"), ["map bad.yaml: the map has no places"]);
}

#[test]
fn a_file_that_is_too_large_is_rejected() {
    let text = "#".repeat(limits::FILE_BYTES + 1);
    assert!(matches!(read(&text, "big.yaml"), Err(MapError::TooLarge { .. })));
}
