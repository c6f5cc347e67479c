//! Drawings of imported maps: their levels, doors, lifts and robots.

use consort_map_import::{ImportOptions, parse};
use consort_world::map::render::svg;
use roxmltree::{Document, Node};
use std::collections::BTreeSet;

const CLINIC: &str = include_str!("../maps/clinic.drawio");
const OFFICE: &str = include_str!("../maps/office.building.yaml");

fn drawing_of(text: &str, file: &str) -> String {
    let drawing = parse(text, file, &ImportOptions::default()).unwrap();
    svg(&drawing.map.check(file).unwrap(), &drawing.items().collect::<Vec<_>>())
}

fn of_class<'a>(document: &'a Document<'a>, class: &'a str) -> impl Iterator<Item = Node<'a, 'a>> {
    document.descendants().filter(move |node| node.attribute("class") == Some(class))
}

/// Returns the number of elements of each class.
fn counts(svg: &str, classes: &[&str]) -> Vec<usize> {
    let document = Document::parse(svg).unwrap();
    classes.iter().map(|class| of_class(&document, class).count()).collect()
}

fn texts(svg: &str) -> BTreeSet<String> {
    let document = Document::parse(svg).unwrap();
    let texts = document.descendants().filter(|node| node.has_tag_name("text") || node.has_tag_name("title"));
    texts.filter_map(|node| node.text().map(|text| text.trim().to_owned())).collect()
}

#[test]
fn levels_doors_lifts_limits_and_robots_are_drawn() {
    let svg = drawing_of(OFFICE, "office.building.yaml");
    assert_eq!(counts(&svg, &["level", "door", "lift", "one-way", "item", "place"]), [2, 2, 2, 2, 1, 12]);
    let texts = texts(&svg);
    for name in ["L2 (4.5 m)", "pantry_door", "lift_1", "0.5 m/s", "tiny1", "reception", "charger"] {
        assert!(texts.contains(name), "{name}: {texts:?}");
    }
    assert!(texts.contains("meeting – lobby (L2), 14.58 m, one way, graph 0, facing backward"), "{texts:?}");
}

#[test]
fn all_panels_have_the_same_origin_and_scale() {
    let svg = drawing_of(OFFICE, "office.building.yaml");
    let document = Document::parse(&svg).unwrap();
    let first_wall = |level: Node| {
        let wall = level.descendants().find(|node| node.attribute("class") == Some("wall")).unwrap();
        let points = wall.attribute("points").unwrap().split([' ', ',']);
        let points: Vec<f64> = points.map(|number| number.parse().unwrap()).collect();
        points.chunks(2).map(|at| (at[0] - points[0], at[1] - points[1])).collect::<Vec<_>>()
    };
    let walls: Vec<_> = of_class(&document, "level").map(first_wall).collect();
    assert_eq!(walls[0].len(), walls[1].len());
    for (a, b) in walls[0].iter().zip(&walls[1]) {
        assert!((a.0 - b.0).abs() < 0.25 && (a.1 - b.1).abs() < 0.25, "{a:?} {b:?}");
    }
}

#[test]
fn everything_is_within_the_image() {
    for svg in [drawing_of(CLINIC, "clinic.drawio"), drawing_of(OFFICE, "office.building.yaml")] {
        let document = Document::parse(&svg).unwrap();
        let number = |node: Node, name| node.attribute(name).unwrap().parse::<f64>().unwrap();
        let (width, height) = (number(document.root_element(), "width"), number(document.root_element(), "height"));
        assert!(width <= 1700.0 && height <= 1800.0, "{width} x {height}");
        for dot in document.descendants().filter(|node| node.has_tag_name("circle")) {
            let (x, y) = (number(dot, "cx"), number(dot, "cy"));
            assert!((0.0..=width).contains(&x) && (0.0..=height).contains(&y), "{x} {y}");
        }
    }
}
