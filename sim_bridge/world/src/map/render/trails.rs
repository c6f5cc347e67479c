//! Paths driven by robots, drawn on a level.

use super::colours;
use super::content::Trail;
use super::elements::{Point, arrow_head, px};
use super::labels::{Labels, Weight};
use super::page::Panel;
use crate::map::model::LevelIndex;
use svg::node::element::{Circle, Group, Polygon, Polyline, Title};

/// Distance of two trails on the same lane, in pixels: drawn next to each other, all of them are
/// visible.
const APART: f64 = 3.0;
/// Number of different offsets; further trails reuse them.
const LANES: usize = 7;
/// Least length of a straight segment with an arrow, in pixels.
const LONG: f64 = 70.0;

/// Returns the offset of a trail, by its index: alternately to either side.
fn offset_of(index: usize) -> f64 {
    let step = (index % LANES).div_ceil(2) as f64;
    if index.is_multiple_of(2) { -step * APART } else { step * APART }
}

/// Draws the parts of the trails on a level, and marks their lines as occupied.
pub(super) fn draw(trails: &[Trail], level: LevelIndex, panel: &Panel, labels: &mut Labels) -> Vec<Group> {
    let draw = |(index, trail): (usize, &Trail)| {
        let (colour, shift) = (colours::robot_colour(index), offset_of(index));
        let mut group = Group::new()
            .set("class", "trail")
            .set("data-robot", trail.name.as_str())
            // The offset is diagonal, so that it is visible on lanes of either direction.
            .set("transform", format!("translate({shift} {shift})"))
            .add(Title::new(format!("{}, {:.1} m", trail.name, trail.length_m)));
        for (_, segment) in trail.segments.iter().filter(|(at, _)| *at == level) {
            let points: Vec<Point> = segment.iter().map(|point| panel.at(*point)).collect();
            group = group.add(polyline(&points, colour));
            for leg in points.windows(2) {
                labels.line(leg[0], leg[1], Weight::Lane);
                if let Some(arrow) = arrow(leg[0], leg[1]) {
                    group = group.add(arrow.set("class", "trail-arrow").set("fill", colour));
                }
            }
        }
        if let Some((at, segment)) = trail.segments.first()
            && *at == level
            && let Some(start) = segment.first()
        {
            group = group.add(ring(panel.at(*start), colour));
        }
        group
    };
    trails.iter().enumerate().map(draw).collect()
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
    long.then(|| arrow_head(a, b))
}
