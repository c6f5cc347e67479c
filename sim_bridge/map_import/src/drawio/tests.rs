//! Tests of drawings: the meaning of their cells, plain and compressed, and every error.

use crate::{Drawing, ImportError, ImportOptions, parse, read};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use consort_world::map::{Facing, Map, MapError, MapFile, PlaceKind, limits};
use flate2::Compression;
use flate2::write::DeflateEncoder;
use percent_encoding::{NON_ALPHANUMERIC, utf8_percent_encode};
use proptest::prelude::*;
use std::io::Write;

const CLINIC: &str = include_str!("../../maps/clinic.drawio");

fn drawn(text: &str) -> Drawing {
    parse(text, "some/clinic.drawio", &ImportOptions::default()).unwrap()
}

fn map(text: &str) -> Map {
    read(text, "clinic.drawio").unwrap()
}

/// Returns a page with a single layer and these cells.
fn page(cells: &str) -> String {
    format!(
        "<mxGraphModel pageHeight=\"600\"><root><mxCell id=\"0\"/><mxCell id=\"1\" parent=\"0\"/>{cells}</root></mxGraphModel>"
    )
}

fn file(cells: &str) -> String {
    format!("<mxfile><diagram name=\"here\">{}</diagram></mxfile>", page(cells))
}

/// Compresses a page in the way of diagrams.net.
fn deflated(page: &str) -> String {
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(utf8_percent_encode(page, NON_ALPHANUMERIC).to_string().as_bytes()).unwrap();
    STANDARD.encode(encoder.finish().unwrap())
}

fn poi(id: &str, tag: &str, x: f64, y: f64) -> String {
    let (x, y) = (x - 5.0, y - 5.0);
    format!(
        "<object id={id:?} tag={tag:?} type=\"POI\"><mxCell vertex=\"1\" parent=\"1\">\
         <mxGeometry x=\"{x}\" y=\"{y}\" width=\"10\" height=\"10\" as=\"geometry\"/></mxCell></object>"
    )
}

fn path(id: &str, more: &str, points: &[(f64, f64)]) -> String {
    let point = |(x, y): &(f64, f64), role: &str| format!("<mxPoint x=\"{x}\" y=\"{y}\"{role}/>");
    let (first, last) = (points.first().unwrap(), points.last().unwrap());
    let between: String = points[1..points.len() - 1].iter().map(|at| point(at, "")).collect();
    format!(
        "<object id={id:?} type=\"map-path\" {more}><mxCell edge=\"1\" parent=\"1\"><mxGeometry relative=\"1\" as=\"geometry\">\
         {}<Array as=\"points\">{between}</Array>{}</mxGeometry></mxCell></object>",
        point(first, " as=\"sourcePoint\""),
        point(last, " as=\"targetPoint\""),
    )
}

fn shape(id: &str, style: &str, (x, y, w, h): (f64, f64, f64, f64)) -> String {
    format!(
        "<mxCell id={id:?} style={style:?} vertex=\"1\" parent=\"1\">\
         <mxGeometry x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\" as=\"geometry\"/></mxCell>"
    )
}

fn lanes(map: &MapFile) -> Vec<(&str, &str)> {
    map.lanes.iter().map(|lane| (lane.between.0.as_str(), lane.between.1.as_str())).collect()
}

fn diagnostics(text: &str) -> Vec<String> {
    read(text, "bad.drawio").unwrap_err().to_string().lines().map(str::to_owned).collect()
}

#[test]
fn the_sample_is_a_valid_map() {
    let drawing = drawn(CLINIC);
    assert_eq!(drawing.notes, Vec::<String>::new());
    let map = map(CLINIC);
    assert_eq!(map.name(), "clinic");
    let place = |name: &str| map.places().iter().find(|place| place.id.as_str() == name).unwrap();
    assert_eq!((place("Ward 1").pose.x, place("Ward 1").pose.y), (3.6, 9.4));
    assert_eq!(place("Ward 1").kind, PlaceKind::Room);
    assert!((place("Ward 1").pose.yaw - std::f64::consts::FRAC_PI_2).abs() < 1e-3);
    assert_eq!(place("Robot Home").kind, PlaceKind::Charger);
    let door = map.door("Ward 2 Door").unwrap();
    assert_eq!((door.opening.get(), door.lanes.len()), (2.5, 1));
    assert_eq!(map.walls().len(), 9);
}

#[test]
fn robots_objects_and_people_are_read() {
    let drawing = drawn(CLINIC);
    let [ada] = drawing.robots.as_slice() else { panic!("{:?}", drawing.robots) };
    assert_eq!((ada.item.name.as_str(), ada.item.place.as_deref()), ("Ada", Some("Robot Home")));
    assert_eq!((ada.item.x_m, ada.item.y_m, ada.item.size_m), (2.0, 4.4, (0.6, 0.6)));
    assert!(
        (ada.item.yaw_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-3,
        "a rotation of -90 degrees clockwise from east is north"
    );
    assert_eq!(ada.item.attributes["robot_type"], "carrier");
    assert_eq!(ada.components["Claw"], serde_json::json!([80, 1]));
    assert_eq!(ada.components["Velocity"], serde_json::json!({"x": 0, "y": 0}));
    assert_eq!(ada.path, [(2.2, 5.4), (3.6, 9.4)]);
    let [sample] = drawing.objects.as_slice() else { panic!("{:?}", drawing.objects) };
    assert_eq!((sample.item.name.as_str(), sample.weight_kg), ("sample", 0.2));
    let [bea] = drawing.people.as_slice() else { panic!("{:?}", drawing.people) };
    assert_eq!(
        (bea.item.name.as_str(), bea.role.as_str(), bea.item.place.as_deref()),
        ("Bea", "nurse", Some("Ward 2"))
    );
}

#[test]
fn a_compressed_page_equals_the_plain_page() {
    let model = CLINIC.find("<mxGraphModel").unwrap()..CLINIC.find("</diagram>").unwrap();
    let packed = CLINIC.replace(&CLINIC[model.clone()], &deflated(&CLINIC[model]));
    assert!(!packed.contains("mxGraphModel"));
    assert_eq!(drawn(&packed), drawn(CLINIC));
    assert_eq!(parse(&packed, "clinic.xml", &ImportOptions::default()).unwrap(), drawn(CLINIC));
}

#[test]
fn points_in_the_same_grid_cell_are_merged_at_its_centre() {
    let cells = [path("a", "", &[(101.0, 119.0), (301.0, 301.0)]), path("b", "", &[(118.0, 100.0), (105.0, 500.0)])];
    let drawing = drawn(&file(&cells.concat()));
    let names: Vec<&str> = drawing.map.places.iter().map(|place| place.name.as_str()).collect();
    assert_eq!(names, ["Point 110 110", "Point 310 310", "Point 110 510"]);
    assert_eq!((drawing.map.places[0].x_m, drawing.map.places[0].y_m), (2.2, 9.8));
    assert_eq!(lanes(&drawing.map), [("Point 110 110", "Point 310 310"), ("Point 110 110", "Point 110 510")]);
}

#[test]
fn a_path_runs_through_the_points_that_it_passes() {
    let cells = [path("a", "", &[(10.0, 10.0), (410.0, 10.0)]), path("b", "", &[(210.0, 10.0), (210.0, 210.0)])];
    let drawing = drawn(&file(&cells.concat()));
    let expected =
        [("Point 10 10", "Point 210 10"), ("Point 410 10", "Point 210 10"), ("Point 210 10", "Point 210 210")];
    assert_eq!(lanes(&drawing.map), expected);
    map(&file(&cells.concat()));
}

#[test]
fn a_path_ends_at_the_centre_of_its_source_and_target() {
    let attached =
        path("a", "", &[(300.0, 300.0), (400.0, 300.0)]).replace("edge=\"1\"", "edge=\"1\" source=\"p\" target=\"s\"");
    let cells = [poi("p", "Here", 33.0, 47.0), shape("s", "ellipse", (200.0, 200.0, 100.0, 60.0)), attached];
    let drawing = drawn(&file(&cells.concat()));
    assert_eq!(lanes(&drawing.map), [("Here", "Point 250 230")]);
    assert_eq!(
        (drawing.map.places[0].x_m, drawing.map.places[0].y_m),
        (0.66, 11.06),
        "a place keeps its drawn position"
    );
}

#[test]
fn a_place_without_a_path_is_connected_around_walls() {
    let wall = shape("w", "shape=mxgraph.floorplan.wall", (60.0, 60.0, 100.0, 10.0));
    let way = path("a", "", &[(10.0, 110.0), (210.0, 110.0)]);
    let free = drawn(&file(&[poi("p", "Room", 150.0, 30.0), way.clone()].concat()));
    assert_eq!(lanes(&free.map)[2], ("Room", "Point 150 110"), "straight down to the path");
    let walled = drawn(&file(&[poi("p", "Room", 150.0, 30.0), way, wall].concat()));
    assert_eq!(lanes(&walled.map)[1], ("Room", "Point 210 110"), "a point that the wall does not hide");
}

#[test]
fn places_on_both_sides_of_a_path_share_a_point_of_it() {
    let cells = [
        poi("p", "North", 150.0, 60.0),
        poi("q", "South", 153.0, 160.0),
        poi("r", "West", 13.0, 60.0),
        path("a", "", &[(10.0, 110.0), (410.0, 110.0)]),
    ];
    let drawing = drawn(&file(&cells.concat()));
    let joined = [("North", "Point 150 110"), ("South", "Point 150 110"), ("West", "Point 10 110")];
    assert!(joined.iter().all(|lane| lanes(&drawing.map).contains(lane)), "{:?}", drawing.map.lanes);
    assert_eq!(map(&file(&cells.concat())).places().len(), 6);
}

#[test]
fn one_way_paths_and_speed_limits_are_kept() {
    let cells = [
        path("a", "one_way=\"true\" speed_limit_mps=\"0.5\"", &[(10.0, 10.0), (410.0, 10.0)]),
        path("b", "one_way=\"true\"", &[(410.0, 10.0), (410.0, 210.0), (10.0, 10.0)]),
    ];
    let drawing = drawn(&file(&cells.concat()));
    let found: Vec<_> = drawing
        .map
        .lanes
        .iter()
        .map(|lane| (&*lane.between.0, &*lane.between.1, lane.one_way, lane.speed_limit_mps))
        .collect();
    let expected = [
        ("Point 10 10", "Point 410 10", true, Some(0.5)),
        ("Point 410 210", "Point 10 10", true, None),
        ("Point 410 10", "Point 410 210", true, None),
    ];
    assert_eq!(found, expected);
    assert!(drawing.map.lanes.iter().all(|lane| lane.facing != Some(Facing::Backward)));
    map(&file(&cells.concat()));
}

#[test]
fn walls_are_the_centre_lines_of_their_shapes() {
    let at = (100.0, 100.0, 80.0, 40.0);
    let of = |style: &str| {
        let style = format!("shape=mxgraph.floorplan.{style}");
        let text = file(&[shape("w", &style, at), poi("p", "P", 0.0, 0.0)].concat());
        let options = ImportOptions { scale_m: Some(1.0), ..ImportOptions::default() };
        let drawing = parse(&text, "x.drawio", &options).unwrap();
        // Converted back to units with y down, to compare with the drawing.
        let walls = drawing.map.walls.iter().flatten().map(|(x, y)| (x.round() as i64, (600.0 - y).round() as i64));
        walls.collect::<Vec<_>>()
    };
    assert_eq!(of("wall"), [(100, 120), (180, 120)]);
    assert_eq!(of("wall;direction=south"), [(180, 120), (100, 120)], "along the longer side, for every direction");
    assert_eq!(of("room"), [(105, 105), (175, 105), (175, 135), (105, 135), (105, 105)]);
    assert_eq!(of("wallU"), [(105, 140), (105, 105), (175, 105), (175, 140)]);
    assert_eq!(of("wallU;wallThickness=20"), [(110, 140), (110, 110), (170, 110), (170, 140)]);
    assert_eq!(of("wallU;direction=south"), [(100, 105), (175, 105), (175, 135), (100, 135)], "open to the west");
    assert_eq!(of("wallU;direction=north"), [(180, 135), (105, 135), (105, 105), (180, 105)]);
    assert_eq!(of("wallCorner"), [(105, 140), (105, 105), (180, 105)]);
    assert_eq!(of("wallCorner;direction=south"), [(100, 105), (175, 105), (175, 140)]);
    assert_eq!(of("wallCorner;direction=west"), [(175, 100), (175, 135), (100, 135)]);
    assert_eq!(of("wallCorner;flipH=1"), [(175, 140), (175, 105), (100, 105)]);
    assert_eq!(of("wall;rotation=90"), [(140, 80), (140, 160)], "rotated about the centre");
    assert_eq!(of("stairs"), []);
}

#[test]
fn positions_in_a_group_are_relative_to_the_group() {
    let group = shape("g", "group", (100.0, 200.0, 300.0, 300.0));
    let inside = poi("p", "In", 10.0, 20.0).replace("parent=\"1\"", "parent=\"g\"");
    let drawing =
        parse(&file(&[group, inside].concat()), "g.drawio", &ImportOptions { scale_m: Some(1.0), graph: None })
            .unwrap();
    assert_eq!((drawing.map.places[0].x_m, drawing.map.places[0].y_m), (110.0, 380.0));
}

#[test]
fn pages_are_levels_connected_by_lifts() {
    let level = |name: &str| {
        let lift = poi("l", "Lift A", 210.0, 110.0).replace("\"POI\"", "\"lift\" capacity=\"2\" speed_mps=\"0.5\"");
        let cells = [lift, poi("p", name, 10.0, 110.0), path("w", "", &[(10.0, 110.0), (210.0, 110.0)])];
        format!("<diagram name=\"{name} floor\">{}</diagram>", page(&cells.concat()))
    };
    let empty = format!("<diagram name=\"notes\">{}</diagram>", page(""));
    let text = format!("<mxfile>{}{}{empty}</mxfile>", level("lower"), level("upper"));
    let map = map(&text);
    assert_eq!(
        map.levels().iter().map(|level| level.name.as_str()).collect::<Vec<_>>(),
        ["lower floor", "upper floor"]
    );
    let lift = map.lift("Lift A").unwrap();
    assert_eq!(
        lift.stops.iter().map(|stop| stop.as_str()).collect::<Vec<_>>(),
        ["Lift A (lower floor)", "Lift A (upper floor)"]
    );
    assert_eq!((lift.capacity, lift.speed.get()), (2, 0.5));
    let notes = drawn(&text).notes;
    assert!(notes[0].contains("\"notes\"") && notes[0].contains("ignored"), "{notes:?}");
}

#[test]
fn the_scale_is_that_of_the_options_the_drawing_or_the_default() {
    let text = file(&poi("p", "P", 100.0, 600.0));
    let x = |text: &str, scale_m| {
        parse(text, "x.drawio", &ImportOptions { scale_m, graph: None }).unwrap().map.places[0].x_m
    };
    assert_eq!(x(&text, None), 2.0);
    assert!(drawn(&text).notes[0].contains("0.02 m"));
    let scaled = text.replace("<mxCell id=\"0\"/>", "<object id=\"0\" metres_per_unit=\"0.1\"><mxCell/></object>");
    assert_eq!((x(&scaled, None), x(&scaled, Some(0.5))), (10.0, 50.0));
    let invalid = scaled.replace("0.1", "-1");
    let found = "map bad.drawio: page \"here\", cell \"0\": metres_per_unit is \"-1\", allowed: a number above 0";
    assert_eq!(diagnostics(&invalid), [found]);
}

#[test]
fn every_error_is_reported_with_page_and_cell() {
    let component = "<object id=\"r\" type=\"robot\" component_Claw=\"[80\"><mxCell vertex=\"1\" parent=\"1\">\
                     <mxGeometry width=\"10\" height=\"10\" as=\"geometry\"/></mxCell></object>";
    let cells = [
        poi("a", "A", 10.0, 10.0),
        poi("a", "Again", 410.0, 10.0),
        poi("kind", "K", 10.0, 15.0).replace("type", "kind=\"lap\" type"),
        poi("x", "X", 10.0, 10.0).replace("x=\"5\"", "x=\"5px\""),
        "<object id=\"no\" tag=\"N\" type=\"POI\"><mxCell vertex=\"1\" parent=\"1\"/></object>".to_owned(),
        path("short", "", &[(1.0, 1.0), (19.0, 19.0)]),
        path("loose", "", &[(1.0, 1.0), (99.0, 99.0)]).replace("edge=\"1\"", "edge=\"1\" source=\"zz\""),
        path("fast", "speed_limit_mps=\"0\"", &[(1.0, 1.0), (401.0, 1.0)]),
        path("open", "", &[(1.0, 1.0), (401.0, 1.0)]).replace(" as=\"targetPoint\"", ""),
        shape("flat", "", (0.0, 0.0, 10.0, 10.0))
            .replace("<mxCell id=\"flat\"", "<object id=\"flat\" type=\"map-path\"><mxCell")
            .replace("</mxCell>", "</mxCell></object>"),
        component.to_owned(),
        component.replace("\"r\"", "\"o\"").replace("\"robot\"", "\"pickable\" weight=\"-2\""),
        poi("far", "Far", 900.0, 900.0),
    ];
    let at = |cell: &str| format!("map bad.drawio: page \"here\", cell {cell:?}: ");
    assert_eq!(
        diagnostics(&file(&cells.concat())),
        [
            at("a") + "this id occurs more than once",
            at("x") + "x is \"5px\", allowed: a number from -10000000 to 10000000",
            at("kind")
                + "kind is \"lap\", allowed are room, lab, corridor, dock, charger, other; did you mean \"lab\"?",
            at("no") + "this POI has no position on the page: it must be a shape with a position and a size",
            at("short") + "this path has no length: all its points are in the same cell of the grid of 20 units",
            at("loose") + "its source is cell \"zz\", which is not on this page",
            at("fast") + "speed_limit_mps is \"0\", allowed: a number above 0",
            at("open") + "this path has no target: it must begin and end at a point or a cell",
            at("flat") + "this map-path must be a line from one point to another",
            at("far")
                + "place \"Far\" is too far from all paths: draw a path to it, or within 100 units of it without a wall in between",
            at("r") + "component_Claw is not JSON: EOF while parsing a list at line 1 column 3",
            at("o") + "weight is \"-2\", allowed: a number of kilograms from 0",
            at("o") + "this pickable has no name",
        ]
    );
}

#[test]
fn places_that_no_path_connects_are_reported() {
    let cells = [
        path("a", "", &[(10.0, 10.0), (210.0, 10.0)]),
        path("b", "", &[(10.0, 400.0), (210.0, 400.0), (210.0, 500.0)]),
    ];
    assert_eq!(
        diagnostics(&file(&cells.concat())),
        [
            "map bad.drawio: place \"Point 10 10\" is not connected with the rest of the map",
            "map bad.drawio: place \"Point 210 10\" is not connected with the rest of the map",
        ]
    );
}

#[test]
fn a_misspelt_type_is_kept_with_a_note() {
    let drawing = drawn(&file(&poi("p", "P", 10.0, 10.0).replace("\"POI\"", "\"robt\"")));
    assert_eq!(drawing.others.len(), 1);
    assert!(drawing.notes.iter().any(|note| note.ends_with("did you mean \"robot\"?")), "{:?}", drawing.notes);
    assert_eq!(diagnostics("<mxGraphModel/>"), ["map bad.drawio: the map has no places"]);
}

#[test]
fn a_file_that_is_not_a_drawing_is_rejected_with_the_reason() {
    let reason = |text: &str| match parse(text, "x.drawio", &ImportOptions::default()) {
        Err(ImportError::Map(MapError::Syntax { message, .. })) => message,
        other => panic!("{other:?}"),
    };
    assert!(reason("<mxfile><diagram></mxfile>").contains("1:18"), "{}", reason("<mxfile><diagram></mxfile>"));
    assert!(reason("<svg/>").contains("allowed are <mxfile> and <mxGraphModel>"));
    assert!(reason("<mxfile/>").contains("no pages"));
    assert!(
        reason("<mxfile><diagram name=\"a\">?</diagram></mxfile>")
            .starts_with("page \"a\": its compressed text is not base64")
    );
    assert!(reason("<mxfile><diagram>YWJj</diagram></mxfile>").contains("cannot be inflated"));
    let other = format!("<mxfile><diagram>{}</diagram></mxfile>", deflated("<svg/>"));
    assert!(reason(&other).contains("<svg>, allowed: <mxGraphModel>"));
    let bomb =
        format!("<mxfile><diagram>{}</diagram></mxfile>", deflated(&" ".repeat(super::xml::INFLATED_BYTES / 3 + 1)));
    assert!(bomb.len() < limits::FILE_BYTES / 10 && reason(&bomb).contains("more than the 33554432 bytes allowed"));
}

#[test]
fn a_drawn_map_survives_a_round_trip_through_yaml() {
    let drawing = drawn(CLINIC);
    let yaml = serde_saphyr::to_string(&drawing.map).unwrap();
    assert_eq!(read(&yaml, "clinic.yaml").unwrap(), map(CLINIC));
}

#[test]
fn deeply_nested_groups_and_elements_do_not_overflow() {
    let nested = format!("{}{}", "<object>".repeat(20_000), "</object>".repeat(20_000));
    let _ = parse(&file(&nested), "x.drawio", &ImportOptions::default());
    let ring = shape("a", "", (0.0, 0.0, 5.0, 5.0)).replace("parent=\"1\"", "parent=\"b\"")
        + &shape("b", "", (0.0, 0.0, 5.0, 5.0)).replace("parent=\"1\"", "parent=\"a\"")
        + &poi("p", "P", 0.0, 0.0).replace("parent=\"1\"", "parent=\"a\"");
    assert_eq!(drawn(&file(&ring)).map.places.len(), 1);
}

proptest! {
    /// Bytes are changed, cut out and doubled: reading returns a result and never panics.
    #[test]
    fn a_mutated_drawing_is_read_or_rejected(
        edits in prop::collection::vec((any::<prop::sample::Index>(), 0_usize..40, "[ -~]{0,6}"), 1..8),
        packed: bool,
    ) {
        let mut text = CLINIC.to_owned();
        for (at, cut, put) in edits {
            let at = at.index(text.len());
            let end = (at + cut).min(text.len());
            if text.is_char_boundary(at) && text.is_char_boundary(end) {
                text.replace_range(at..end, &put);
            }
        }
        if packed {
            text = format!("<mxfile><diagram name=\"p\">{}</diagram></mxfile>", deflated(&text));
        }
        let _ = read(&text, "mutated.drawio");
    }

    /// Numbers of all kinds in place of the original numbers.
    #[test]
    fn a_drawing_with_other_numbers_is_read_or_rejected(
        numbers in prop::collection::vec(prop_oneof!["-?[0-9]{1,9}(\\.[0-9]{1,3})?", Just("1e308".to_owned()), Just("NaN".to_owned()), Just("-0".to_owned())], 1..6),
        from in 0_usize..60,
    ) {
        let mut parts: Vec<String> = CLINIC.split(" y=\"").map(str::to_owned).collect();
        let count = parts.len();
        for (index, number) in numbers.iter().enumerate() {
            let part = &mut parts[1 + (from + index) % (count - 1)];
            if let Some(end) = part.find('"') {
                part.replace_range(..end, number);
            }
        }
        let _ = read(&parts.join(" y=\""), "numbers.drawio");
    }
}
