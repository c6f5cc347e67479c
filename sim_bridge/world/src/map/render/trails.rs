//! Paths driven by robots, drawn on the map.

use super::colours::{self, INK};
use super::labels::Weight;
use super::page::DrawingPage;
use super::{LevelDrawing, NOTE_PX, Point, document, px, text};
use crate::map::{DrawnItem, LevelIndex, Map};
use svg::node::element::{Circle, Group, Polygon, Polyline, Title};

/// Distance of two trails on the same lane, in pixels: drawn next to each other, all of them are
/// visible.
const APART: f64 = 3.0;
/// Number of different offsets; further trails reuse them.
const LANES: usize = 7;
/// Least length of a straight segment with an arrow, in pixels.
const LONG: f64 = 70.0;

/// The path driven by a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Trail {
    /// Name of the robot.
    pub name: String,
    /// The segments in driving order, each with its level and its points as (x, y) in metres.
    pub segments: Vec<(LevelIndex, Vec<(f64, f64)>)>,
    /// Driven distance in metres; greater than the length of the segments if they were cut.
    pub length_m: f64,
}

impl Trail {
    pub(super) fn points(&self) -> impl Iterator<Item = Point> {
        self.segments.iter().flat_map(|(_, points)| points.iter().copied())
    }
}

/// Draws a map, the items on it and the paths of robots as SVG: a ring at the start of each path,
/// an arrow on each long straight segment, and the robot (the item with the name of the trail) at
/// the end. `caption` states the time of the drawing.
pub fn svg_with_trails(map: &Map, items: &[&DrawnItem], trails: &[Trail], caption: &str) -> String {
    let page = DrawingPage::of(map, items, trails);
    let (x, y) = page.title_at();
    let beside = (x + super::labels::width(map.name(), 18.0) + 16.0, y);
    let document = document(map, items, trails, &page).add(text(caption, beside, NOTE_PX, INK));
    document.add(key(trails, &page)).to_string()
}

/// Draws the list of trails with the robot and length of each.
fn key(trails: &[Trail], page: &DrawingPage) -> Group {
    let mut group = Group::new().set("class", "trails");
    for (index, trail) in trails.iter().enumerate() {
        let (x, y) = page.trail_at(index);
        let stroke =
            super::line((x, y), (x + 22.0, y)).set("stroke", colours::robot_colour(index)).set("stroke-width", 4);
        let label = format!("{}, {:.0} m", trail.name, trail.length_m);
        group = group.add(stroke).add(text(&label, (x + 30.0, y + 4.0), NOTE_PX, INK));
    }
    group
}

/// Returns the offset of a trail, by its index: alternately to either side.
fn offset_of(index: usize) -> f64 {
    let step = (index % LANES).div_ceil(2) as f64;
    if index.is_multiple_of(2) { -step * APART } else { step * APART }
}

impl LevelDrawing<'_> {
    pub(super) fn trails(&mut self, trails: &[Trail]) {
        for (index, trail) in trails.iter().enumerate() {
            let (colour, shift) = (colours::robot_colour(index), offset_of(index));
            let mut group = Group::new()
                .set("class", "trail")
                .set("data-robot", trail.name.as_str())
                // The offset is diagonal, so that it is visible on lanes of either direction.
                .set("transform", format!("translate({shift} {shift})"))
                .add(Title::new(format!("{}, {:.1} m", trail.name, trail.length_m)));
            for (_, segment) in trail.segments.iter().filter(|(level, _)| *level == self.level) {
                let points: Vec<Point> = segment.iter().map(|point| self.panel.at(*point)).collect();
                group = group.add(polyline(&points, colour));
                for leg in points.windows(2) {
                    self.labels.line(leg[0], leg[1], Weight::Lane);
                    if let Some(arrow) = arrow(leg[0], leg[1]) {
                        group = group.add(arrow.set("class", "trail-arrow").set("fill", colour));
                    }
                }
            }
            if let Some((level, segment)) = trail.segments.first()
                && *level == self.level
                && let Some(start) = segment.first()
            {
                group = group.add(ring(self.panel.at(*start), colour));
            }
            self.add(group);
        }
    }
}

fn polyline(points: &[Point], colour: &str) -> Polyline {
    let points = points.iter().map(|(x, y)| format!("{},{}", px(*x), px(*y))).collect::<Vec<_>>().join(" ");
    let line =
        Polyline::new().set("class", "trail-line").set("points", points).set("fill", "none").set("stroke", colour);
    line.set("stroke-width", 2.5).set("stroke-linejoin", "round").set("stroke-linecap", "round")
}

/// Returns the ring at the start of a trail.
fn ring((x, y): Point, colour: &str) -> Circle {
    let ring = Circle::new().set("class", "trail-start").set("cx", px(x)).set("cy", px(y)).set("r", 8);
    ring.set("fill", "none").set("stroke", colour).set("stroke-width", 2)
}

/// Returns the arrow in the middle of a long straight segment, in driving direction.
fn arrow(a: Point, b: Point) -> Option<Polygon> {
    let long = (b.0 - a.0).hypot(b.1 - a.1) >= LONG;
    long.then(|| super::arrow_head(a, b))
}
