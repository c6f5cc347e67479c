//! The whole drawing: title, a panel for each level, list of trails, and legend.

use super::colours::{self, DOOR, INK, ITEM, LIFT, ROBOT};
use super::content::{DrawnItem, Trail, trail_of};
use super::elements::{NOTE_PX, line, px, text};
use super::labels;
use super::level::{LevelDrawing, dot};
use super::page::DrawingPage;
use crate::map::model::{Map, PlaceKind};
use std::collections::BTreeSet;
use svg::node::element::{Circle, Group, Rectangle, Title};

/// Draws a map, and the items on it, as SVG.
pub fn svg(map: &Map, items: &[&DrawnItem]) -> String {
    document(map, items, &[], &DrawingPage::of(map, items, &[])).to_string()
}

/// Draws a map, the items on it and the paths of robots as SVG: a ring at the start of each path,
/// an arrow on each long straight segment, and the robot (the item with the name of the trail) at
/// the end. `caption` states the time of the drawing.
pub(crate) fn svg_with_trails(map: &Map, items: &[&DrawnItem], trails: &[Trail], caption: &str) -> String {
    let page = DrawingPage::of(map, items, trails);
    let (x, y) = page.title_at();
    let beside = (x + labels::width(map.name(), 18.0) + 16.0, y);
    let document = document(map, items, trails, &page).add(text(caption, beside, NOTE_PX, INK));
    document.add(key(trails, &page)).to_string()
}

fn document(map: &Map, items: &[&DrawnItem], trails: &[Trail], page: &DrawingPage) -> svg::Document {
    let mut document = svg::Document::new()
        .set("viewBox", (0, 0, page.width, page.height))
        .set("width", page.width)
        .set("height", page.height)
        .set("font-family", "Hack, DejaVu Sans Mono, monospace")
        .add(Title::new(map.name()))
        .add(Rectangle::new().set("width", page.width).set("height", page.height).set("fill", "#ffffff"))
        .add(text(map.name(), page.title_at(), 18.0, INK).set("font-weight", "bold"));
    for (level, panel) in map.level_indices().zip(&page.panels) {
        document = document.add(LevelDrawing::new(map, level, panel).draw(items, trails));
    }
    document.add(legend(map, items, trails, page))
}

/// Draws the list of trails with the robot and length of each.
fn key(trails: &[Trail], page: &DrawingPage) -> Group {
    let mut group = Group::new().set("class", "trails");
    for (index, trail) in trails.iter().enumerate() {
        let (x, y) = page.trail_at(index);
        let stroke = line((x, y), (x + 22.0, y)).set("stroke", colours::robot_colour(index)).set("stroke-width", 4);
        let label = format!("{}, {:.0} m", trail.name, trail.length_m);
        group = group.add(stroke).add(text(&label, (x + 30.0, y + 4.0), NOTE_PX, INK));
    }
    group
}

/// Draws the legend of the colours in use, and a scale bar.
fn legend(map: &Map, items: &[&DrawnItem], trails: &[Trail], page: &DrawingPage) -> Group {
    let mut group = Group::new().set("class", "legend");
    let (mut x, y) = page.legend_at();
    let (metres, bar) = page.bar();
    group = group
        .add(line((x, y), (x + bar, y)).set("class", "scale").set("stroke", INK).set("stroke-width", 3))
        .add(text(&format!("{metres} m"), (x + bar + 6.0, y + 4.0), NOTE_PX, INK));
    x += bar + 70.0;
    let kinds: BTreeSet<PlaceKind> = map.places().iter().map(|place| place.kind).collect();
    let mut entries: Vec<(&str, &str)> = kinds.into_iter().map(|kind| (kind.as_str(), dot(kind).0)).collect();
    let is_present = |kind: fn(&DrawnItem) -> bool| items.iter().any(|item| kind(item));
    let others = [
        ("door", DOOR, !map.doors().is_empty()),
        ("lift", LIFT, !map.lifts().is_empty()),
        ("robot", ROBOT, items.iter().any(|item| item.kind == "robot" && trail_of(item, trails).is_none())),
        ("thing", ITEM, is_present(|item| item.kind != "robot")),
    ];
    entries.extend(others.into_iter().filter(|(.., is_present)| *is_present).map(|(name, colour, _)| (name, colour)));
    for (name, colour) in entries {
        let swatch = Circle::new().set("cx", px(x)).set("cy", px(y)).set("r", 5).set("fill", colour);
        group = group.add(swatch).add(text(name, (x + 9.0, y + 4.0), NOTE_PX, INK));
        x += 30.0 + labels::width(name, NOTE_PX);
    }
    group
}
