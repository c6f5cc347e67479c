//! Pictures of the paths driven.

use super::*;
use consort_protocol::pose::Pose;
use consort_skills::actions::FollowWaypoints;
use std::collections::BTreeMap;

#[test]
fn the_picture_shows_the_paths_driven() {
    let file = TempFile::named("paths.svg");
    let mut world = hall();
    record(&world, &RecordingOutputs { mcap: None, svg: Some(file.0.clone()) });
    run_one_minute(&mut world);
    let said = world.end_recording();
    assert!(said[0].as_ref().unwrap().ends_with(": 20 m driven by 1 robot"), "{said:?}");
    let svg = fs::read_to_string(&file.0).unwrap();
    let document = roxmltree::Document::parse(&svg).unwrap();
    let of_class = |class: &str| {
        let class = class.to_owned();
        document.descendants().filter(move |node| node.attribute("class") == Some(&class))
    };
    // Positions of places and corners in the picture, in tenths of a pixel.
    let pixel = |text: &str| (text.parse::<f64>().unwrap() * 10.0).round() as i64;
    let places: BTreeMap<&str, (i64, i64)> = of_class("place")
        .map(|dot| {
            let title = dot.parent().unwrap().children().find(|node| node.has_tag_name("title")).unwrap();
            let at = ["cx", "cy"].map(|name| pixel(dot.attribute(name).unwrap()));
            (title.text().unwrap().trim(), (at[0], at[1]))
        })
        .collect();
    let driven: Vec<Vec<(i64, i64)>> = of_class("trail-line")
        .map(|line| {
            let corners = line.attribute("points").unwrap().split(' ').filter_map(|point| point.split_once(','));
            corners.map(|(x, y)| (pixel(x), pixel(y))).collect()
        })
        .collect();
    assert_eq!(driven.len(), 1, "Bob stood still");
    let visited: Vec<&str> = driven[0]
        .iter()
        .filter_map(|corner| places.iter().find(|(_, at)| *at == corner).map(|(name, _)| *name))
        .collect();
    assert_eq!(visited, ["A", "B", "C", "B"]);
    // Straight parts have few points: corners at turns, at the door, and few others.
    assert!(driven[0].len() <= 12, "{:?}", driven[0]);
    let bodies = of_class("item").count();
    assert_eq!((of_class("trail-start").count(), bodies), (1, 3), "a ring where Ada began; Ada, Bob and Nia");
}

#[test]
fn a_curve_is_drawn_where_it_was_driven() {
    let file = TempFile::named("curve.svg");
    let mut world = hall();
    record(&world, &RecordingOutputs { mcap: None, svg: Some(file.0.clone()) });
    // A circle with a radius of two metres around (2, 0), from Ada's position and back.
    let point = |step: u32| {
        let angle = std::f64::consts::PI + std::f64::consts::TAU * f64::from(step) / 400.0;
        Waypoint { pose: Pose::new(2.0 + 2.0 * angle.cos(), 2.0 * angle.sin(), 0.0), place: None }
    };
    let waypoints = (1..=400).map(point).collect();
    world.start(&robot("ada"), GoalId(1), Goal::from(FollowWaypoints { waypoints }));
    world.advance(at(30.0));
    world.end_recording();
    let svg = fs::read_to_string(&file.0).unwrap();
    let document = roxmltree::Document::parse(&svg).unwrap();
    let attribute = |class: &str, name: &str| {
        let node = document.descendants().find(|node| node.attribute("class") == Some(class)).unwrap();
        node.attribute(name).unwrap().to_owned()
    };
    // A and B are 10 m apart.
    let dots: Vec<f64> = document
        .descendants()
        .filter(|node| node.attribute("class") == Some("place"))
        .map(|dot| dot.attribute("cx").unwrap().parse().unwrap())
        .collect();
    let scale = (dots[1] - dots[0]) / 10.0;
    let corners: Vec<(f64, f64)> = attribute("trail-line", "points")
        .split(' ')
        .map(|point| point.split_once(',').unwrap())
        .map(|(x, y)| (x.parse::<f64>().unwrap(), y.parse::<f64>().unwrap()))
        .collect();
    let middle = (corners[0].0 + 2.0 * scale, corners[0].1);
    let off = |(x, y): (f64, f64)| ((x - middle.0).hypot(y - middle.1) / scale - 2.0).abs();
    let halfway = |pair: &[(f64, f64)]| (f64::midpoint(pair[0].0, pair[1].0), f64::midpoint(pair[0].1, pair[1].1));
    assert!(corners.iter().all(|corner| off(*corner) < 0.005), "the corners are on the circle");
    assert!(corners.windows(2).all(|pair| off(halfway(pair)) < 0.03), "the lines between them stay close to it");
    assert!((20..100).contains(&corners.len()), "{} corners for a sample every 5 cm", corners.len());
}
