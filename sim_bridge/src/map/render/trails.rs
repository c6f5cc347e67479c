//! Where robots have driven, over the map.

use super::colours::{self, INK};
use super::labels::Weight;
use super::page::DrawingPage;
use super::{Floor, NOTE_PX, Point, document, px, text};
use crate::map::{DrawnItem, LevelIndex, Map};
use svg::node::element::{Circle, Group, Polygon, Polyline, Title};

/// How far apart two trails lie that lead the same way, in pixels: side by side they can all be seen.
const APART: f64 = 3.0;
/// More than so many lie upon one another again.
const LANES: usize = 7;
/// A straight stretch this long shows which way it was driven, in pixels.
const LONG: f64 = 70.0;

/// Where one robot has driven.
#[derive(Debug, Clone, PartialEq)]
pub struct Trail {
    /// The robot's name.
    pub name: String,
    /// On which level, and there from where to where as (x, y) in metres, one stretch after the other.
    pub segments: Vec<(LevelIndex, Vec<(f64, f64)>)>,
    /// How far it has driven, in metres; more than the stretches' length if they were cut short.
    pub length_m: f64,
}

impl Trail {
    pub(super) fn points(&self) -> impl Iterator<Item = Point> {
        self.segments.iter().flat_map(|(_, points)| points.iter().copied())
    }
}

/// Draws a map, what stands on it, and where robots have driven, as SVG: a ring where each began, an arrow on each long
/// straight, the robot itself (one of the `bodies` that bears the trail's name) where it ended. `caption` says of when it is.
pub fn svg_with_trails(map: &Map, bodies: &[&DrawnItem], trails: &[Trail], caption: &str) -> String {
    let page = DrawingPage::of(map, bodies, trails);
    let (x, y) = page.title_at();
    let beside = (x + super::labels::width(map.name(), 18.0) + 16.0, y);
    let document = document(map, bodies, trails, &page).add(text(caption, beside, NOTE_PX, INK));
    document.add(key(trails, &page)).to_string()
}

/// Whose trail is whose, and how long it is.
fn key(trails: &[Trail], page: &DrawingPage) -> Group {
    let mut group = Group::new().set("class", "trails");
    for (place, trail) in trails.iter().enumerate() {
        let (x, y) = page.trail_at(place);
        let stroke =
            super::line((x, y), (x + 22.0, y)).set("stroke", colours::robot_colour(place)).set("stroke-width", 4);
        let said = format!("{}, {:.0} m", trail.name, trail.length_m);
        group = group.add(stroke).add(text(&said, (x + 30.0, y + 4.0), NOTE_PX, INK));
    }
    group
}

/// How far a trail is moved aside, by its place among all: every other one to the other side.
fn aside(place: usize) -> f64 {
    let step = (place % LANES).div_ceil(2) as f64;
    if place.is_multiple_of(2) { -step * APART } else { step * APART }
}

impl Floor<'_> {
    pub(super) fn trails(&mut self, trails: &[Trail]) {
        for (place, trail) in trails.iter().enumerate() {
            let (colour, shift) = (colours::robot_colour(place), aside(place));
            let mut group = Group::new()
                .set("class", "trail")
                .set("data-robot", trail.name.as_str())
                // Aside both ways, so that it shows on lanes of either direction.
                .set("transform", format!("translate({shift} {shift})"))
                .add(Title::new(format!("{}, {:.1} m", trail.name, trail.length_m)));
            for (_, stretch) in trail.segments.iter().filter(|(level, _)| *level == self.level) {
                let points: Vec<Point> = stretch.iter().map(|point| self.panel.at(*point)).collect();
                group = group.add(polyline(&points, colour));
                for leg in points.windows(2) {
                    self.labels.line(leg[0], leg[1], Weight::Lane);
                    if let Some(arrow) = arrow(leg[0], leg[1]) {
                        group = group.add(arrow.set("class", "driven-way").set("fill", colour));
                    }
                }
            }
            if let Some((level, stretch)) = trail.segments.first()
                && *level == self.level
                && let Some(start) = stretch.first()
            {
                group = group.add(ring(self.panel.at(*start), colour));
            }
            self.add(group);
        }
    }
}

fn polyline(points: &[Point], colour: &str) -> Polyline {
    let points = points.iter().map(|(x, y)| format!("{},{}", px(*x), px(*y))).collect::<Vec<_>>().join(" ");
    let line = Polyline::new().set("class", "driven").set("points", points).set("fill", "none").set("stroke", colour);
    line.set("stroke-width", 2.5).set("stroke-linejoin", "round").set("stroke-linecap", "round")
}

/// Where it began.
fn ring((x, y): Point, colour: &str) -> Circle {
    let ring = Circle::new().set("class", "began").set("cx", px(x)).set("cy", px(y)).set("r", 8);
    ring.set("fill", "none").set("stroke", colour).set("stroke-width", 2)
}

/// Which way a long straight was driven: an arrow at its middle.
fn arrow(a: Point, b: Point) -> Option<Polygon> {
    let long = (b.0 - a.0).hypot(b.1 - a.1) >= LONG;
    long.then(|| super::arrow_head(a, b))
}
