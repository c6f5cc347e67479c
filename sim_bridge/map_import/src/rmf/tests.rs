//! Tests of Open-RMF buildings: the resulting maps, and every error.

use crate::{Drawing, ImportError, ImportOptions, parse, read};
use consort_protocol::ids::PlaceId;
use consort_world::map::{Facing, Map, MapError, PlaceKind};
use proptest::prelude::*;
use std::collections::BTreeSet;

const OFFICE: &str = include_str!("../../maps/office.building.yaml");

fn drawn(text: &str, options: &ImportOptions) -> Drawing {
    parse(text, "x/office.building.yaml", options).unwrap()
}

fn office() -> Map {
    read(OFFICE, "office.building.yaml").unwrap()
}

fn id(name: &str) -> PlaceId {
    PlaceId::new(name).unwrap()
}

fn at(map: &Map, name: &str) -> (f64, f64) {
    let pose = map.place(&id(name)).unwrap_or_else(|| panic!("no {name}: {:?}", map.places())).pose;
    (pose.x, pose.y)
}

fn diagnostics(text: &str) -> Vec<String> {
    read(text, "bad.building.yaml").unwrap_err().to_string().lines().map(str::to_owned).collect()
}

/// Returns a building with a single level in metres and these entries.
fn one_level(entries: &str) -> String {
    format!("name: b\ncoordinate_system: cartesian_meters\nlevels:\n  L1:\n{entries}")
}

const PAIR: &str = "    vertices: [[0, 0, 0, a], [3, 4, 0, b]]\n    lanes: [[0, 1, {bidirectional: [4, true]}]]\n";

#[test]
fn the_sample_is_a_valid_map_with_two_levels() {
    let map = office();
    assert_eq!(map.name(), "office");
    let levels: Vec<_> = map.levels().iter().map(|level| (level.name.as_str(), level.elevation_m)).collect();
    assert_eq!(levels, [("L1", 0.0), ("L2", 4.5)]);
    let names: Vec<&str> = map.places().iter().map(|place| place.id.as_str()).collect();
    let lower = ["reception", "L1 vertex 5", "lobby (L1)", "L1 vertex 7", "pantry", "base", "crane_a", "crane_b"];
    let upper = ["desks", "meeting", "lobby (L2)", "L2 vertex 7"];
    assert_eq!(names, [&lower[..], &upper[..]].concat(), "only vertices at lanes are places");
    assert_eq!(map.place(&id("base")).unwrap().kind, PlaceKind::Charger);
    assert_eq!(map.place(&id("L1 vertex 5")).unwrap().kind, PlaceKind::Corridor);
}

#[test]
fn pixels_are_flipped_and_scaled_by_the_measurements() {
    let map = office();
    assert_eq!(at(&map, "reception"), (7.5, -15.0));
    let twice =
        OFFICE.replace("{ distance: [3, 10] }]", "{ distance: [3, 10] }]\n      - [0, 1, { distance: [3, 90] }]");
    let map = read(&twice, "office.building.yaml").unwrap();
    assert_eq!(at(&map, "reception"), (15.0, -30.0), "the mean of 0.05 and 0.15 m per pixel");
    let scaled = drawn(&twice, &ImportOptions { scale_m: Some(0.02), graph: None });
    assert_eq!((scaled.map.places[0].x_m, scaled.map.places[0].y_m), (3.0, -6.0));
}

#[test]
fn other_levels_are_aligned_by_shared_fiducials() {
    let map = office();
    for (upper, lower) in [("desks", "reception"), ("meeting", "pantry"), ("lobby (L2)", "lobby (L1)")] {
        assert_eq!(at(&map, upper), at(&map, lower), "{upper}");
    }
    let [lower, upper] = ["L1", "L2"].map(|name| map.walls_on(map.level_named(name).unwrap()).next().unwrap());
    assert_eq!(lower, upper, "the outer walls have the same position");
    assert_eq!(
        lower,
        [(5.0, -5.0), (35.0, -5.0), (35.0, -25.0), (5.0, -25.0), (5.0, -5.0)],
        "and form a single polyline"
    );
}

#[test]
fn lanes_keep_their_directions_limits_and_headings() {
    let map = office();
    let lane = |from: &str, to: &str| map.lane(&id(from), &id(to)).cloned();
    let limited = lane("L1 vertex 5", "lobby (L1)").unwrap();
    assert_eq!(
        (limited.speed_limit.map(|limit| limit.get()), limited.two_way, limited.facing),
        (Some(0.5), true, None)
    );
    let unlimited = lane("L1 vertex 5", "pantry").unwrap();
    assert_eq!((unlimited.speed_limit, unlimited.length.get()), (None, 7.5));
    assert_eq!(lane("desks", "meeting").unwrap().facing, Some(Facing::Forward));
    assert_eq!(lane("meeting", "desks"), None, "one way");
    assert_eq!(lane("meeting", "lobby (L2)").unwrap().facing, Some(Facing::Backward));
}

#[test]
fn doors_are_on_crossing_lanes_and_lifts_stop_at_places_in_the_cabin() {
    let map = office();
    let [door, window] = map.doors() else { panic!("{:?}", map.doors()) };
    assert_eq!((window.name.as_str(), window.lanes.len()), ("window", 0), "kept for drawing");
    assert_eq!((door.name.as_str(), door.lanes.as_slice()), ("pantry_door", &[(id("L1 vertex 5"), id("pantry"))][..]));
    assert_eq!(door.span, Some(((18.5, -19.0), (21.5, -19.0))));
    let [lift] = map.lifts() else { panic!("{:?}", map.lifts()) };
    assert_eq!((lift.name.as_str(), lift.stops.as_slice()), ("lift_1", &[id("L1 vertex 7"), id("L2 vertex 7")][..]));
    let notes = drawn(OFFICE, &ImportOptions::default()).notes.join("\n");
    for errors in ["\"window\"", "\"goods\"", "the lanes belong to graphs 0, 1"] {
        assert!(notes.contains(errors), "{errors}: {notes}");
    }
}

#[test]
fn a_rotated_cabin_contains_the_places_within_its_walls() {
    let stops = |yaw: f64| {
        let lift = OFFICE.replacen(
            "yaw: 0\n    width: 3\n    depth: 2.5",
            &format!("yaw: {yaw}\n    width: 12\n    depth: 2.5"),
            1,
        );
        parse(&lift, "o.building.yaml", &ImportOptions::default()).unwrap().map.lifts[0].stops.len()
    };
    assert_eq!((stops(0.0), stops(std::f64::consts::FRAC_PI_2)), (2, 4), "rotated, it reaches the lobbies");
}

#[test]
fn a_vertex_may_name_its_lift_and_a_level_needs_lift_doors() {
    let named = OFFICE.replace("[235, 300, 0, meeting]", "[235, 300, 0, meeting, { lift_cabin: [1, lift_1] }]");
    let stops = |text: &str| drawn(text, &ImportOptions::default()).map.lifts[0].stops.clone();
    assert_eq!(stops(&named), ["L1 vertex 7", "meeting", "L2 vertex 7"]);
    assert_eq!(stops(&OFFICE.replace("L2: [front]", "L2: []")), ["L1 vertex 7"]);
    let error = diagnostics(&OFFICE.replace("L2: [front]", "L2: []"));
    assert_eq!(error, ["map bad.building.yaml: lift \"lift_1\" has stops on 1 level(s), needed: 2 or more"]);
    let invalid = diagnostics(&named.replace("[1, lift_1]", "[1, lift_2]"));
    let errors = "level \"L2\", vertex 5: lift_cabin: there is no lift \"lift_2\"; did you mean \"lift_1\"?";
    assert_eq!(invalid, [format!("map bad.building.yaml: {errors}")]);
}

#[test]
fn all_graphs_are_read_and_robots_drive_on_their_own() {
    let map = office();
    assert_eq!(map.graphs(), BTreeSet::from(["0", "1"]));
    let crane = map.lane(&id("crane_a"), &id("crane_b")).unwrap();
    assert_eq!((crane.is_in(Some("0")), crane.is_in(Some("1")), crane.is_in(None)), (false, true, true));
    let edges = |graph| map.topology_of(graph).edges.len();
    assert_eq!((edges(Some("0")), edges(Some("1")), edges(None)), (10, 2, 11), "with the ride by lift");
    let cut = OFFICE.replace("[14, 15, { bidirectional: [4, true]", "[14, 15, { bidirectional: [4, false]");
    assert_eq!(
        diagnostics(&cut),
        ["map bad.building.yaml: place \"crane_b\" cannot be left for the rest of graph \"1\""]
    );
}

#[test]
fn a_lane_of_two_graphs_is_a_lane_of_both() {
    let both = OFFICE.replace(
        "      - [14, 15, {",
        "      - [4, 5, { graph_idx: [2, 1] }]\n      - [5, 4, { graph_idx: [2, 1] }]\n      - [14, 15, {",
    );
    let both = both.replace(
        "      - [14, 15, {",
        "      - [14, 4, { bidirectional: [4, true], graph_idx: [2, 1] }]\n      - [14, 15, {",
    );
    let map = read(&both, "office.building.yaml").unwrap();
    let lane = map.lane(&id("reception"), &id("L1 vertex 5")).unwrap();
    assert!(lane.two_way && lane.graphs == BTreeSet::from(["0", "1"].map(str::to_owned)), "{lane:?}");
    let robot = &drawn(OFFICE, &ImportOptions::default()).robots[0];
    assert_eq!(robot.item.attributes["graph"], "0");
    let dock = OFFICE.replace("{ is_charger: [4, true],", "{ is_charger: [4, true], dock_name: [1, bay-3],");
    let map = read(&dock, "office.building.yaml").unwrap();
    let base = map.place(&id("base")).unwrap();
    assert_eq!((base.kind, base.dock.as_deref()), (PlaceKind::Charger, Some("bay-3")));
}

#[test]
fn graphs_are_read_separately() {
    let other = drawn(OFFICE, &ImportOptions { graph: Some(1), scale_m: None });
    assert_eq!(other.map.places.iter().map(|place| place.name.as_str()).collect::<Vec<_>>(), ["crane_a", "crane_b"]);
    let error =
        parse(OFFICE, "o.building.yaml", &ImportOptions { graph: Some(7), scale_m: None }).unwrap_err().to_string();
    assert_eq!(error, "map o.building.yaml: building: graph 7 has no lanes; graphs with lanes: 0, 1");
}

#[test]
fn robots_stand_at_their_spawn_vertex() {
    let drawing = drawn(OFFICE, &ImportOptions::default());
    let [robot] = drawing.robots.as_slice() else { panic!("{:?}", drawing.robots) };
    assert_eq!((robot.item.name.as_str(), robot.item.place.as_deref()), ("tiny1", Some("base")));
    assert_eq!((robot.item.x_m, robot.item.y_m), (7.5, -22.5));
    assert!((robot.item.yaw_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-3, "along its lane, north");
    assert_eq!(robot.item.attributes["robot_type"], "TinyRobot");
}

#[test]
fn metres_are_not_converted() {
    let map = read(&one_level(PAIR), "b.building.yaml").unwrap();
    assert_eq!((at(&map, "b"), map.lanes()[0].length.get()), ((3.0, 4.0), 5.0));
    assert_eq!(map.levels().len(), 1);
}

#[test]
fn degrees_become_metres_around_the_origin() {
    // At 60 degrees north a degree of longitude is 55.8 km, and a degree of latitude 111.4 km.
    let text = |parameters: &str| {
        let vertices = "[[10.0, 60.0, 0, a], [10.001, 60.0, 0, b], [10.001, 60.001, 0, c]]";
        format!(
            "name: b\ncoordinate_system: wgs84\nparameters: {parameters}\nlevels:\n  L1:\n    vertices: {vertices}\n    \
             lanes: [[0, 1, {{bidirectional: [4, true]}}], [1, 2, {{bidirectional: [4, true]}}]]\n"
        )
    };
    let map = read(&text("{}"), "b.building.yaml").unwrap();
    let near = |(x, y): (f64, f64), (a, b): (f64, f64)| (x - a).abs() < 0.05 && (y - b).abs() < 0.05;
    assert!(near(at(&map, "a"), (0.0, 0.0)) && near(at(&map, "b"), (55.8, 0.0)), "{:?}", at(&map, "b"));
    assert!(near(at(&map, "c"), (55.8, 111.41)), "{:?}", at(&map, "c"));
    let map = read(&text("{generate_origin_vertex: [1, c]}"), "b.building.yaml").unwrap();
    assert!(near(at(&map, "c"), (0.0, 0.0)) && near(at(&map, "a"), (-55.8, -111.41)), "{:?}", at(&map, "a"));
}

#[test]
fn every_error_of_an_entry_is_reported_with_level_and_number() {
    let text = one_level(
        "    vertices: [[0, 0, 0, a], [x, 0, 0, b], [1, 0], [5, 5, 0, a], [6, 6, 0, c, {is_charger: [4, 1]}], [7, 7, 0, d, {odd: 1}]]
    lanes:
      - [0, 17, {}]
      - [0, -1, {}]
      - [0, one, {}]
      - [0, 3, {bidirectional: [4, sure]}]
      - [3, 4, {orientation: [1, sideways]}]
      - [3, 4, {speed_limit: fast}]
      - [4, 0, {graph_idx: [2, zero]}]
      - [4, 0, {graph_idx: [2, 0]}]
    doors: [[0, 3, {type: [1, hinged]}]]
    walls: [[0, 99, {}]]
    fiducials: [[1, 2]]
",
    );
    let at = |place: &str| format!("map bad.building.yaml: level \"L1\", {place}: ");
    let type_value = "[type, value] with type 1 for text, 2 for a whole number, 3 for a number, 4 for true or false";
    assert_eq!(
        diagnostics(&text),
        [
            at("vertex 1") + "x is \"x\", allowed: a number",
            at("vertex 2") + "this is [1,0], allowed: [x, y, z, name, {parameters}]",
            at("vertex 5") + "parameter odd is 1, allowed: " + type_value,
            at("lane 0") + "there is no vertex 17; allowed are 0 to 5",
            at("lane 1") + "there is no vertex -1; allowed are 0 to 5",
            at("lane 2") + "this is [0,\"one\",{}], allowed: [vertex, vertex, {parameters}]",
            at("lane 5") + "parameter speed_limit is \"fast\", allowed: " + type_value,
            at("wall 0") + "there is no vertex 99; allowed are 0 to 5",
            at("fiducial 0") + "this is [1,2], allowed: [x, y, name]",
            at("lane 6") + "parameter graph_idx is \"zero\", allowed: a whole number",
            at("vertex 3") + "its name \"a\" is already the name of vertex 0",
            at("vertex 4") + "parameter is_charger is 1, allowed: [4, true] or [4, false]",
            at("lane 3") + "parameter bidirectional is \"sure\", allowed: [4, true] or [4, false]",
            at("lane 4") + "parameter orientation is \"sideways\", allowed: forward or backward",
            at("door 0") + "parameter name is missing",
        ]
    );
}

#[test]
fn errors_of_the_whole_building_are_reported() {
    let errors = |text: &str| diagnostics(text).join("\n").replace("map bad.building.yaml: ", "");
    assert_eq!(errors("levels: {}"), "building: the building has no levels");
    assert_eq!(errors(&one_level("    vertices: []\n")), "building: the building has no lanes");
    assert_eq!(
        errors(&one_level(PAIR).replace("cartesian_meters", "web_mercator")),
        "building: coordinate_system is \"web_mercator\", allowed: reference_image, cartesian_meters or wgs84"
    );
    assert_eq!(
        errors(&OFFICE.replace("reference_level_name: L1", "reference_level_name: L3")),
        "building: reference_level_name: there is no level \"L3\"; did you mean \"L1\"?"
    );
    assert_eq!(
        errors(&OFFICE.replace("- [12, 13, { distance: [3, 10] }]", "[]")),
        "level \"L1\": it has no measurements, so the scale is unknown: add a measurement, or give a scale"
    );
    assert_eq!(
        errors(&OFFICE.replace("[12, 13, {", "[12, 12, {")),
        "level \"L1\", measurement 0: both ends are the same point: measure between two points"
    );
    assert_eq!(
        errors(&OFFICE.replace("{ distance: [3, 10] }", "{}")),
        "level \"L1\", measurement 0: parameter distance is missing"
    );
    assert_eq!(
        errors(&OFFICE.replace("[260, 150, south_east]", "[260, 150, elsewhere]")),
        "level \"L2\": it has 1 fiducial(s) in common with the reference level \"L1\"; needed: 2 at different points"
    );
    assert_eq!(
        errors(&OFFICE.replace("      L2: [front]", "      L4: [front]")),
        "lift \"lift_1\": level_doors: there is no level \"L4\"; did you mean \"L1\"?"
    );
    assert_eq!(
        errors(&OFFICE.replace("    width: 3\n", "    width: 0\n")),
        "lift \"lift_1\": width is 0, allowed: a number of metres above 0"
    );
}

#[test]
fn disconnected_places_and_lanes_without_length_are_reported() {
    let disconnected = PAIR
        .replace("3, 4, 0, b]", "3, 4, 0, b], [9, 9, 0, c], [9, 8, 0, d]")
        .replace("]]\n    lanes: [", "]]\n    lanes: [[2, 3, {}], ");
    let errors = diagnostics(&one_level(&disconnected));
    assert_eq!(
        errors,
        ["c", "d"]
            .map(|name| format!("map bad.building.yaml: place {name:?} is not connected with the rest of the map"))
    );
    let errors = diagnostics(&one_level(&PAIR.replace("3, 4", "0, 0")));
    assert_eq!(
        errors,
        [
            "map bad.building.yaml: lane between \"a\" and \"b\": length is 0 m, allowed: a number above 0 and up to 100000"
        ]
    );
    let errors = diagnostics(&one_level(&PAIR.replace("[0, 1, {", "[1, 1, {")));
    assert_eq!(errors, ["map bad.building.yaml: lane between \"b\" and \"b\": both ends are the same place"]);
}

#[test]
fn a_level_without_lanes_that_cannot_be_aligned_is_ignored() {
    let text = OFFICE.replace("lifts:\n", "  roof:\n    elevation: 9\n    vertices: [[0, 0, 0, x]]\nlifts:\n");
    let drawing = drawn(&text, &ImportOptions::default());
    assert_eq!(drawing.map.levels.len(), 2);
    assert!(drawing.notes.iter().any(|note| note.starts_with("level \"roof\" is ignored")), "{:?}", drawing.notes);
}

#[test]
fn a_file_of_another_form_is_rejected_with_line_and_column() {
    let error = parse("levels: {L1: {vertices: 3}}", "x.building.yaml", &ImportOptions::default()).unwrap_err();
    let ImportError::Map(MapError::Syntax { message, .. }) = error else { panic!("{error:?}") };
    assert!(message.contains("line 1") && message.contains("sequence"), "{message}");
}

#[test]
fn a_building_survives_a_round_trip_through_yaml() {
    let yaml = serde_saphyr::to_string(&drawn(OFFICE, &ImportOptions::default()).map).unwrap();
    assert_eq!(read(&yaml, "office.yaml").unwrap(), office());
}

proptest! {
    #[test]
    fn a_mutated_building_is_read_or_rejected(
        edits in prop::collection::vec((any::<prop::sample::Index>(), 0_usize..30, "[ -~\n]{0,5}"), 1..6),
    ) {
        let mut text = OFFICE.to_owned();
        for (at, cut, put) in edits {
            let at = at.index(text.len());
            let end = (at + cut).min(text.len());
            if text.is_char_boundary(at) && text.is_char_boundary(end) {
                text.replace_range(at..end, &put);
            }
        }
        let _ = read(&text, "mutated.building.yaml");
    }

    #[test]
    fn a_building_with_other_numbers_is_read_or_rejected(
        numbers in prop::collection::vec(
            prop_oneof!["-?[0-9]{1,9}", Just("1e308".to_owned()), Just(".nan".to_owned()), Just("-.inf".to_owned())], 1..8),
        from in 0_usize..300,
    ) {
        let mut parts: Vec<String> = OFFICE.split(", ").map(str::to_owned).collect();
        let count = parts.len();
        for (index, number) in numbers.iter().enumerate() {
            let part = &mut parts[(from + index) % count];
            if part.parse::<f64>().is_ok() {
                part.clone_from(number);
            }
        }
        let _ = read(&parts.join(", "), "numbers.building.yaml");
    }
}
