//! Tests of drawn maps: their content.

use super::*;
use crate::map::{read, shipped};
use roxmltree::{Document, Node};
use std::collections::BTreeSet;

/// Returns the drawing of a shipped map.
fn drawing_of(name: &str) -> String {
    svg(&shipped(name).unwrap(), &[])
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
fn everything_on_a_map_is_drawn() {
    let map = shipped("hospital").unwrap();
    let svg = svg(&map, &[]);
    let expected = [map.places().len(), map.lanes().len(), map.walls().len(), 1, 1];
    assert_eq!(counts(&svg, &["place", "lane", "wall", "level", "scale"]), expected);
    let texts = texts(&svg);
    for name in ["hospital", "IC Room 1", "PC Room 8", "Laboratory", "Dock", "room", "lab", "2 m"] {
        assert!(texts.contains(name), "{name}: {texts:?}");
    }
}

#[test]
fn everything_is_within_the_image() {
    for svg in ["clinic", "hospital"].map(drawing_of) {
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

#[test]
fn names_do_not_cover_each_other() {
    let svg = drawing_of("hospital");
    let document = Document::parse(&svg).unwrap();
    let names = document.descendants().filter(|node| node.has_tag_name("text") && node.has_attribute("paint-order"));
    let boxes: Vec<(f64, f64, f64, f64, String)> = names
        .map(|node| {
            let number = |name| node.attribute(name).unwrap().parse::<f64>().unwrap();
            let text = node.text().unwrap().trim().to_owned();
            let size = number("font-size");
            (
                number("x"),
                number("y") - 0.8 * size,
                number("x") + labels::width(&text, size),
                number("y") + 0.25 * size,
                text,
            )
        })
        .collect();
    assert!(boxes.len() >= 16, "at least the rooms, the laboratory and the dock: {boxes:?}");
    for (index, a) in boxes.iter().enumerate() {
        for b in &boxes[index + 1..] {
            let shared = a.0.max(b.0) < a.2.min(b.2) - 0.2 && a.1.max(b.1) < a.3.min(b.3) - 0.2;
            assert!(!shared, "{a:?} {b:?}");
        }
    }
}

#[test]
fn names_with_markup_are_escaped() {
    let text = "{name: odd, places: [{name: '<a & \"b\">', kind: room, x_m: 0, y_m: 0}]}";
    let svg = svg(&read(text, "odd.yaml").unwrap(), &[]);
    assert!(texts(&svg).contains("<a & \"b\">"), "{svg}");
}

#[test]
fn a_map_with_a_single_place_can_be_drawn() {
    let text = "{name: one, places: [{name: A, kind: room, x_m: 5, y_m: 5}]}";
    assert!(texts(&svg(&read(text, "one.yaml").unwrap(), &[])).contains("A"));
}
