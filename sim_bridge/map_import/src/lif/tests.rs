//! Tests of layouts: the resulting map, and every error.

use crate::{ImportOptions, parse, read};
use consort_protocol::ids::PlaceId;
use consort_world::map::{Facing, Map, PlaceKind};
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
