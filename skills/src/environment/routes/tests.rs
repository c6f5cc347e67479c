//! Routes, compared with hand-drawn maps and with a slow search.

use super::*;
use crate::environment::{Edge, Passage};
use proptest::prelude::*;

fn place(name: &str) -> PlaceId {
    PlaceId::new(name).unwrap()
}

fn map(places: &[(&str, f64, f64)], edges: &[(&str, &str, f64, bool)]) -> Routes {
    let places = places.iter().map(|(name, x, y)| (place(name), Pose::new(*x, *y, 0.0))).collect();
    let edge = |(a, b, length_m, one_way): &(&str, &str, f64, bool)| Edge {
        a: place(a),
        b: place(b),
        length_m: *length_m,
        one_way: *one_way,
    };
    Routes::new(&TopologicalMap { places, edges: edges.iter().map(edge).collect() }).unwrap()
}

/// A corridor W – M – E with a dead end S below M, an island I, and a one-way door from E to W.
fn corridor() -> Routes {
    let places = [("W", 0.0, 0.0), ("M", 10.0, 0.0), ("E", 20.0, 0.0), ("S", 10.0, -10.0), ("I", 50.0, 50.0)];
    map(&places, &[("W", "M", 10.0, false), ("M", "E", 10.0, false), ("M", "S", 10.0, false), ("E", "W", 5.0, true)])
}

fn names(places: &[PlaceId]) -> Vec<&str> {
    places.iter().map(PlaceId::as_str).collect()
}

#[test]
fn the_shortest_route_wins_over_fewer_hops() {
    let routes = map(
        &[("A", 0.0, 0.0), ("B", 0.0, 1.0), ("C", 0.0, 2.0)],
        &[("A", "C", 10.0, false), ("A", "B", 2.0, false), ("B", "C", 3.0, false)],
    );
    let route = routes.route(&place("A"), &place("C")).unwrap();
    assert_eq!((names(&route.places), route.length), (vec!["A", "B", "C"], Metres::new(5.0).unwrap()));
}

#[test]
fn of_equally_short_routes_the_first_by_name_is_taken() {
    let square = [("A", 0.0, 0.0), ("Z", 0.0, 1.0), ("B", 1.0, 0.0), ("D", 1.0, 1.0)];
    let routes =
        map(&square, &[("A", "Z", 1.0, false), ("Z", "D", 1.0, false), ("A", "B", 1.0, false), ("B", "D", 1.0, false)]);
    assert_eq!(names(&routes.route(&place("A"), &place("D")).unwrap().places), ["A", "B", "D"]);
    assert_eq!(names(&routes.route(&place("D"), &place("A")).unwrap().places), ["D", "B", "A"]);
}

#[test]
fn a_one_way_edge_is_driven_one_way() {
    let routes = corridor();
    assert_eq!(names(&routes.route(&place("E"), &place("W")).unwrap().places), ["E", "W"]);
    assert_eq!(names(&routes.route(&place("W"), &place("E")).unwrap().places), ["W", "M", "E"]);
}

#[test]
fn a_missing_route_is_an_error_with_both_ends() {
    let routes = corridor();
    let unreachable = routes.distance(&place("W"), &place("I")).unwrap_err();
    assert_eq!(unreachable.to_string(), "no route from W to I: the map has no way between them");
    assert_eq!(routes.route(&place("W"), &place("I")).unwrap_err(), unreachable);
    let unknown = routes.distance(&place("W"), &place("X")).unwrap_err();
    assert_eq!(unknown.to_string(), "no route from W to X: X is not on the map");
    assert_eq!(
        routes.distance(&place("X"), &place("X")).unwrap_err().to_string(),
        "no route from X to X: X is not on the map"
    );
}

#[test]
fn the_distance_to_the_same_place_is_zero() {
    let routes = corridor();
    assert_eq!(
        routes.route(&place("I"), &place("I")).unwrap(),
        Route { places: vec![place("I")], length: Metres::ZERO }
    );
}

#[test]
fn no_drive_is_faster_than_on_the_shortest_routes() {
    let edge = |a, b, length_m| Edge { a: place(a), b: place(b), length_m, one_way: false };
    let map = TopologicalMap {
        places: ["Ground", "Lift", "Ramp", "Top"].map(|name| (place(name), Pose::default())).into(),
        edges: vec![
            edge("Ground", "Lift", 4.0),
            edge("Lift", "Top", 50.0),
            edge("Ground", "Ramp", 20.0),
            edge("Ramp", "Top", 20.0),
        ],
    };
    let length = |passages: &Passages| {
        let routes = Routes::shortest(&map, passages).unwrap();
        routes.distance(&place("Ground"), &place("Top")).unwrap().get()
    };
    let ride = Passage::Lift(Seconds::new(1.0).unwrap());
    assert_eq!(length(&Passages::default()), 40.0);
    assert!(length(&Passages::default().with(place("Lift"), place("Top"), ride)) < 4.1);
}

#[test]
fn a_robot_between_places_may_pass_a_neighbour_next() {
    let routes = corridor();
    let ahead = |passed: &str, x| {
        let places: BTreeSet<&PlaceId> =
            routes.places_ahead(&place(passed), Pose::new(x, 0.0, 0.0)).into_iter().collect();
        places.into_iter().map(PlaceId::as_str).collect::<Vec<_>>()
    };
    assert_eq!(ahead("M", 10.2), [""; 0], "it stands at the place");
    assert_eq!(ahead("M", 11.0), ["E", "S", "W"]);
    assert_eq!(ahead("W", 1.0), ["M"], "the door leads from E only");
    assert_eq!(ahead("X", 0.0), [""; 0]);
}

#[test]
fn a_robot_far_from_every_lane_is_on_no_way() {
    let routes = corridor();
    let ways = |x, y| routes.ways_at(&place("W"), Pose::new(x, y, 0.0), 1.0);
    assert_eq!(ways(1.0, 0.9), [&place("M")]);
    assert!(ways(1.0, 1.1).is_empty() && ways(-1.1, 0.0).is_empty());
    assert!(ways(0.1, 0.0).is_empty(), "it stands at the place");
}

#[test]
fn a_robot_on_a_leg_takes_the_shorter_of_both_directions() {
    let routes = corridor();
    let legs = |passed: &str, x: f64, y: f64, to: &str| {
        routes
            .legs(&place(passed), Pose::new(x, y, 0.0), &place(to))
            .map(|legs| legs.iter().map(|l| l.to_string()).collect::<Vec<_>>())
    };
    assert_eq!(legs("W", 0.0, 0.1, "E").unwrap(), ["M", "E"], "at the place");
    assert_eq!(legs("W", 4.0, 0.0, "E").unwrap(), ["M", "E"], "on the leg to M");
    assert_eq!(legs("W", 4.0, 0.0, "W").unwrap(), ["W"], "turns back");
    assert_eq!(legs("M", 10.0, -8.0, "E").unwrap(), ["M", "E"], "out of the dead end");
    assert_eq!(legs("E", 15.0, 0.0, "W").unwrap(), ["E", "W"], "back, and through the one-way door");
    assert_eq!(legs("W", 3.0, 7.0, "E").unwrap(), ["W", "M", "E"], "off every leg");
    assert_eq!(legs("E", 20.0, 0.0, "E").unwrap(), Vec::<String>::new(), "there");
    assert!(legs("W", 4.0, 0.0, "I").is_err());
    assert!(legs("W", 0.0, 0.0, "I").is_err());
}

#[test]
fn on_a_one_way_leg_it_cannot_turn_back() {
    let routes = map(
        &[("A", 0.0, 0.0), ("B", 10.0, 0.0), ("C", 10.0, 10.0)],
        &[("A", "B", 10.0, true), ("B", "C", 10.0, true), ("C", "A", 15.0, true)],
    );
    let legs = routes.legs(&place("A"), Pose::new(2.0, 0.0, 0.0), &place("A")).unwrap();
    assert_eq!(names(&legs), ["B", "C", "A"]);
}

#[test]
fn a_thousand_queries_of_a_destination_search_once() {
    let routes = corridor();
    for _ in 0..1000 {
        routes.distance(&place("W"), &place("E")).unwrap();
    }
    assert_eq!(routes.costs.iter().filter(|costs| costs.get().is_some()).count(), 1);
}

/// Bellman–Ford in its simplest form.
fn slow_distance(count: usize, edges: &[(usize, usize, f64)], from: usize, to: usize) -> f64 {
    let mut best = vec![f64::INFINITY; count];
    best[from] = 0.0;
    for _ in 0..count {
        for (a, b, length) in edges {
            best[*b] = best[*b].min(best[*a] + length);
        }
    }
    best[to]
}

proptest! {
    #[test]
    fn routes_agree_with_a_slow_search(
        drawn in proptest::collection::vec((0usize..8, 0usize..8, 1u32..100), 0..24),
        from in 0usize..8,
        to in 0usize..8,
    ) {
        let mut seen = BTreeSet::new();
        let edges: Vec<(usize, usize, f64)> = drawn
            .into_iter()
            .filter(|(a, b, _)| a != b && seen.insert((*a, *b)))
            .map(|(a, b, length)| (a, b, f64::from(length) / 7.0))
            .collect();
        let name = |node: usize| place(&format!("P{node}"));
        let routes = Routes::new(&TopologicalMap {
            places: (0..8).map(|node| (name(node), Pose::default())).collect(),
            edges: edges.iter().map(|(a, b, length_m)| Edge { a: name(*a), b: name(*b), length_m: *length_m, one_way: true }).collect(),
        }).unwrap();
        let slow = slow_distance(8, &edges, from, to);
        match routes.route(&name(from), &name(to)) {
            Err(_) => prop_assert!(slow.is_infinite()),
            Ok(route) => {
                prop_assert!((route.length.get() - slow).abs() < 1e-9, "{} {}", route.length, slow);
                let mut length = 0.0;
                for pair in route.places.windows(2) {
                    let leg = edges.iter().find(|(a, b, _)| name(*a) == pair[0] && name(*b) == pair[1]);
                    length += leg.expect("each leg is an edge").2;
                }
                prop_assert!((length - slow).abs() < 1e-9);
            }
        }
    }
}

#[test]
fn no_route_enters_a_closed_place_and_routes_from_it_lead_out() {
    let ring = map(
        &[("A", 0.0, 0.0), ("B", 10.0, 0.0), ("C", 10.0, 10.0), ("D", 0.0, 10.0)],
        &[("A", "B", 10.0, false), ("B", "C", 10.0, false), ("C", "D", 20.0, false), ("D", "A", 20.0, false)],
    );
    let closed = [(place("B"), place("B"))];
    let routes = ring.without_closed(&closed);
    assert_eq!(names(&routes.route(&place("A"), &place("C")).unwrap().places), ["A", "D", "C"]);
    assert_eq!(names(&routes.route(&place("B"), &place("C")).unwrap().places), ["B", "C"]);
    assert_eq!(routes.distance(&place("B"), &place("B")), Ok(Metres::ZERO));
    let to_closed = RouteError::Closed { from: place("A"), to: place("B") };
    assert_eq!(routes.distance(&place("A"), &place("B")), Err(to_closed));
    let midway = Pose::new(5.0, 0.0, 0.0);
    assert_eq!(names(&routes.legs(&place("A"), midway, &place("C")).unwrap()), ["A", "D", "C"], "it turns back");
    assert_eq!(names(&routes.legs(&place("B"), midway, &place("A")).unwrap()), ["A"], "it leaves");
}

#[test]
fn the_way_out_of_closed_places_leads_through_them() {
    let line = map(
        &[("A", 0.0, 0.0), ("B", 10.0, 0.0), ("C", 20.0, 0.0)],
        &[("A", "B", 10.0, false), ("B", "C", 10.0, false)],
    );
    let closed = [(place("A"), place("A")), (place("B"), place("B"))];
    let routes = line.without_closed(&closed);
    assert_eq!(names(&routes.route(&place("A"), &place("C")).unwrap().places), ["A", "B", "C"]);
    let speed = MetresPerSecond::new(0.5).unwrap();
    let time = routes.time_left(&place("A"), Pose::new(0.0, 0.0, 0.0), &place("C"), speed, &Passages::default());
    assert_eq!(time.map(Seconds::get), Ok(40.0));
    assert!(routes.route(&place("A"), &place("B")).is_err(), "it is closed");
    assert!(routes.route(&place("C"), &place("A")).is_err());
    let enters = |from, to| Routes::enters_closed(&closed, &place(from), &place(to));
    assert!(enters("C", "B") && !enters("A", "B") && !enters("B", "C") && !enters("A", "A"));
    let lane = [(place("B"), place("C"))];
    let enters = |from, to| Routes::enters_closed(&lane, &place(from), &place(to));
    assert!(enters("C", "B") && enters("B", "C") && !enters("A", "B"));
}

#[test]
fn a_slow_lane_is_avoided_if_another_way_is_faster() {
    let ring = map(
        &[("A", 0.0, 0.0), ("B", 10.0, 0.0), ("C", 20.0, 0.0), ("E", 10.0, 10.0)],
        &[("A", "B", 10.0, false), ("B", "C", 10.0, false), ("A", "E", 15.0, false), ("E", "C", 15.0, false)],
    );
    let speed = |speed| MetresPerSecond::new(speed).unwrap();
    let limits = |limit| -> SpeedLimits { [((place("C"), place("B")), speed(limit))].into_iter().collect() };
    let route = |limit, own| ring.limited(&limits(limit), speed(own), None).route(&place("A"), &place("C")).unwrap();
    let places = |limit, own| -> Vec<String> { route(limit, own).places.iter().map(PlaceId::to_string).collect() };
    assert_eq!(places(0.6, 1.0), ["A", "B", "C"], "26.7 s, not 30 s");
    assert_eq!((places(0.4, 1.0), route(0.4, 1.0).length.get()), (["A", "E", "C"].map(str::to_owned).into(), 30.0));
    assert_eq!(places(0.4, 0.4), ["A", "B", "C"], "the robot is as slow everywhere");
    assert_eq!(route(0.6, 1.0).length.get(), 20.0, "the length is that of the lanes");
    let slow = limits(0.1);
    let slowed = ring.limited(&slow, speed(1.0), None);
    let legs = |x| slowed.legs(&place("B"), Pose::new(x, 0.0, 0.0), &place("C")).unwrap();
    assert_eq!(names(&legs(11.0)), ["B", "A", "E", "C"], "10 + 40 s, not 90 s");
    assert_eq!(names(&legs(16.0)), ["C"], "40 s, not 60 + 40 s");
    let passages = Passages::default().with_limits(slow.clone());
    let time = slowed.time_left(&place("B"), Pose::new(16.0, 0.0, 0.0), &place("C"), speed(1.0), &passages);
    assert_eq!(time.map(Seconds::get), Ok(40.0));
    // On a lane that is slow by the map, only a lower limit of people changes the route.
    let drive = Passage::Drive { speed_limit: Some(speed(0.3)), expected_wait: Seconds::ZERO };
    let of_map = Passages::default().with(place("B"), place("C"), drive).with(place("C"), place("B"), drive);
    let route = |limit| ring.limited(&limits(limit), speed(1.0), Some(&of_map)).route(&place("A"), &place("C"));
    assert_eq!(names(&route(0.4).unwrap().places), ["A", "B", "C"]);
    assert_eq!(names(&route(0.1).unwrap().places), ["A", "E", "C"]);
}
