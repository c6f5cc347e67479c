//! Tests of layouts: the resulting map, and every error.

use crate::{ImportOptions, parse, read};
use consort_protocol::ids::PlaceId;
use consort_world::map::{Facing, Map, PlaceKind};
use proptest::prelude::*;
use std::collections::BTreeSet;

const DEPOT: &str = include_str!("../../maps/depot.lif");

fn depot() -> Map {
    read(DEPOT, "depot.lif").unwrap()
}

fn id(name: &str) -> PlaceId {
    PlaceId::new(name).unwrap()
}

fn diagnostics(text: &str) -> Vec<String> {
    let error = read(text, "bad.lif").unwrap_err().to_string();
    error.lines().map(|line| line.replace("map bad.lif: ", "")).collect()
}

#[test]
fn nodes_are_places_and_layouts_are_levels() {
    let map = depot();
    assert_eq!(map.name(), "depot");
    let levels: Vec<&str> = map.levels().iter().map(|level| level.name.as_str()).collect();
    assert_eq!(levels, ["ground", "upper"]);
    let places: Vec<_> = map.places().iter().map(|place| (place.id.as_str(), place.kind)).collect();
    let (corridor, other, charger) = (PlaceKind::Corridor, PlaceKind::Other, PlaceKind::Charger);
    assert_eq!(
        places,
        [
            ("Gate", corridor),
            ("n2", corridor),
            ("Rack", other),
            ("Charger", charger),
            ("n5", corridor),
            ("n6", corridor),
            ("Store", corridor),
        ],
        "a name that two nodes have is replaced by the id"
    );
    assert_eq!(map.place(&id("Gate")).unwrap().pose.yaw, 1.57);
    assert_eq!(map.place(&id("Charger")).unwrap().dock.as_deref(), Some("n4"));
    let [lift] = map.lifts() else { panic!("{:?}", map.lifts()) };
    assert_eq!(lift.stops, [id("n5"), id("n6")]);
}

#[test]
fn edges_are_lanes_of_the_graphs_of_their_vehicles() {
    let map = depot();
    assert_eq!(map.graphs(), BTreeSet::from(["fork", "tugger"]));
    let lane = |from: &str, to: &str| map.lane(&id(from), &id(to)).unwrap().clone();
    let gate = lane("n2", "Gate");
    assert_eq!((gate.two_way, gate.facing, gate.length.get()), (true, Some(Facing::Forward), 10.0));
    assert_eq!(gate.speed_limit.map(|limit| limit.get()), Some(1.5));
    let rack = (lane("n2", "Rack"), lane("Rack", "n2"));
    assert_eq!((rack.0.two_way, rack.0.speed_limit.is_some(), rack.1.speed_limit), (false, true, None));
    assert_eq!(rack.0.graphs, BTreeSet::from(["fork".to_owned()]));
    let curve = lane("n2", "Charger");
    assert!(!curve.two_way && (curve.length.get() - 50_f64.sqrt() * 2.0).abs() < 1e-9, "{curve:?}");
    let notes = parse(DEPOT, "depot.lif.json", &ImportOptions::default()).unwrap().notes;
    assert!(notes.contains(&"restrictions of loads of 1 edge(s) are ignored".to_owned()), "{notes:?}");
    assert!(notes.iter().any(|note| note.ends_with("vehicles of all types ride in both directions")), "{notes:?}");
}

#[test]
fn every_error_names_the_element() {
    let wrong = DEPOT.replace("\"startNodeId\": \"n4\"", "\"startNodeId\": \"n44\"");
    let wrong = wrong.replace("\"nodeId\": \"n7\"", "\"nodeId\": \"n6\"").replace("\"1.0.0\"", "\"2.0.0\"");
    let wrong = wrong.replace("\"interactionNodeIds\": [\"n3\"]", "\"interactionNodeIds\": [\"x\"]");
    assert_eq!(
        diagnostics(&wrong),
        [
            "metaInformation: lifVersion is \"2.0.0\", allowed: 1.0 and later versions 1.x",
            "node \"n6\": its nodeId is already the id of another node",
            "layout \"hall\": interactionNodeIds: there is no node \"x\"",
            "edge \"e6\": startNodeId: there is no node \"n44\"; did you mean \"n4\"?",
            "edge \"e11\": endNodeId: there is no node \"n7\"; did you mean \"n1\"?",
            "edge \"e12\": startNodeId: there is no node \"n7\"; did you mean \"n1\"?",
        ]
    );
    let unreachable = DEPOT
        .replace("\"startNodeId\": \"n7\", \"endNodeId\": \"n6\"", "\"startNodeId\": \"n6\", \"endNodeId\": \"n7\"");
    assert_eq!(diagnostics(&unreachable), ["place \"Store\" cannot be left for the rest of graph \"tugger\""]);
    let syntax = diagnostics("{\"metaInformation\": {\"lifVersion\": \"1.0.0\"}}").join(" ");
    assert!(syntax.contains("missing field `layouts`"), "{syntax}");
}

#[test]
fn a_file_of_another_version_is_named_as_such() {
    let later = "{\"metaInformation\": {\"lifVersion\": \"2.0.0\"}, \"maps\": []}";
    let expected = ["metaInformation: lifVersion is \"2.0.0\", allowed: 1.0 and later versions 1.x"];
    assert_eq!(diagnostics(later), expected);
}

#[test]
fn only_the_first_errors_suggest_a_node() {
    let edge =
        |number: usize| format!("{{ \"edgeId\": \"x{number}\", \"startNodeId\": \"n44\", \"endNodeId\": \"n1\" }},");
    let edges: String = (0..30).map(edge).collect();
    let wrong = DEPOT.replacen("\"edges\": [", &format!("\"edges\": [{edges}"), 1);
    let unknown: Vec<String> =
        diagnostics(&wrong).into_iter().filter(|line| line.contains("there is no node")).collect();
    let suggested = unknown.iter().filter(|line| line.contains("did you mean")).count();
    assert_eq!((unknown.len(), suggested), (30, 10), "each edge has no types of vehicles, too");
}

proptest! {
    #[test]
    fn numbers_of_any_size_are_read_or_reported(
        numbers in proptest::collection::vec(
            prop_oneof!["-?[0-9]{1,9}", Just("1e308".to_owned()), Just("-1e308".to_owned()), Just("1e-320".to_owned())], 1..8),
        from in 0_usize..300,
    ) {
        let mut parts: Vec<String> = DEPOT.split(' ').map(str::to_owned).collect();
        let count = parts.len();
        for (index, number) in numbers.iter().enumerate() {
            let part = &mut parts[(from + index) % count];
            if part.trim_end_matches(',').parse::<f64>().is_ok() {
                *part = if part.ends_with(',') { format!("{number},") } else { number.clone() };
            }
        }
        let _ = read(&parts.join(" "), "numbers.lif");
    }
}
