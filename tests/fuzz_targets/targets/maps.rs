//! Maps in all formats.

use super::frames::text;
use consort_map_import::{ImportOptions, parse};
use consort_nodes::map_loader;
use consort_world::map::{self, Map, MapFile, render};

/// An accepted map is valid, can be encoded and drawn, and reads back as the same map.
fn check_map(file: &MapFile, name: &str) -> bool {
    let check_map = match file.clone().check(name) {
        Ok(check_map) => check_map,
        Err(problem) => {
            named(&problem, name);
            return false;
        }
    };
    let json = serde_json::to_string(file).expect("numbers that a sound map has");
    let again = map::read(&json, "again.json").expect("what was written can be read");
    assert_eq!(again, check_map, "it reads back as something else");
    Map::from_view(check_map.to_view(), "view/map").expect("an encoded map can be read");
    check_map.topology();
    if check_map.places().len() <= 100 {
        render::svg(&check_map, &[]);
    }
    true
}

fn named(problem: &dyn std::error::Error, name: &str) {
    assert!(problem.to_string().contains(name), "the error does not name the file: {problem}");
}

fn read(bytes: &[u8], name: &str) -> bool {
    let Some(text) = text(bytes) else { return false };
    match parse(text, name, &ImportOptions::default()) {
        Ok(drawing) => check_map(&drawing.map, name),
        Err(problem) => {
            named(&problem, name);
            false
        }
    }
}

pub(super) fn yaml(bytes: &[u8]) -> bool {
    read(bytes, "a.yaml")
}

pub(super) fn json(bytes: &[u8]) -> bool {
    let read = read(bytes, "a.json");
    let Some(text) = text(bytes).filter(|text| map_loader::is_published_format(text)) else { return read };
    match map_loader::parse(text, "published.json") {
        Ok(floor) => {
            floor.to_view();
            true
        }
        Err(problems) => {
            assert!(!problems.0.is_empty());
            read
        }
    }
}

pub(super) fn drawing(bytes: &[u8]) -> bool {
    read(bytes, "a.drawio")
}

pub(super) fn building(bytes: &[u8]) -> bool {
    read(bytes, "a.building.yaml")
}

pub(super) fn layout(bytes: &[u8]) -> bool {
    read(bytes, "a.lif")
}
