//! Elements of a drawing, with positions in pixels.

use svg::node::element::{Line, Polygon, Text};

/// Font sizes of names and notes, in pixels.
pub(super) const NAME_PX: f64 = 13.0;
pub(super) const NOTE_PX: f64 = 10.0;

pub(super) type Point = (f64, f64);

/// Returns a small triangle in the middle of a line, pointing to its end.
pub(super) fn arrow_head(a: Point, b: Point) -> Polygon {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let length = dx.hypot(dy).max(1e-9);
    let (dx, dy) = (dx / length, dy / length);
    let middle = (f64::midpoint(a.0, b.0), f64::midpoint(a.1, b.1));
    let corner = |along: f64, across: f64| {
        format!("{},{}", px(middle.0 + along * dx - across * dy), px(middle.1 + along * dy + across * dx))
    };
    Polygon::new().set("points", [corner(8.0, 0.0), corner(-5.0, 5.5), corner(-5.0, -5.5)].join(" "))
}

pub(super) fn line(a: Point, b: Point) -> Line {
    let line = Line::new().set("x1", px(a.0)).set("y1", px(a.1)).set("x2", px(b.0)).set("y2", px(b.1));
    line.set("stroke-linecap", "round")
}

pub(super) fn text(content: &str, (x, y): Point, size: f64, colour: &str) -> Text {
    Text::new(content).set("x", px(x)).set("y", px(y)).set("font-size", size).set("fill", colour)
}

/// Rounds to 0.1 pixels.
pub(super) fn px(value: f64) -> f64 {
    (value * 10.0).round() / 10.0 + 0.0
}
