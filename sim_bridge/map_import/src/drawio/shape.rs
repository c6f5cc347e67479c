//! Positions of shapes on a page, and the lines of walls.

use super::xml::{Cell, Page};
use std::collections::BTreeMap;

/// Default thickness of a wall, in units.
const THICKNESS: f64 = 10.0;
/// Greatest thickness, in units, of a plain shape without type and label that counts as a wall.
const THIN: f64 = 15.0;
/// Greatest depth of nested groups; deeper groups are taken for a mistake and ignored.
const NESTING: usize = 64;

pub(super) type Point = (f64, f64);

/// The cells of a page by id.
pub(super) type Index<'a> = BTreeMap<&'a str, &'a Cell>;

pub(super) fn index(page: &Page) -> Index<'_> {
    // Of two cells with the same id the first; the second is reported.
    page.cells.iter().rev().map(|cell| (cell.id.as_str(), cell)).collect()
}

/// Returns the origin of a cell's coordinates: groups have coordinates of their own.
pub(super) fn origin(cell: &Cell, cells: &Index) -> Point {
    let mut at = (0.0, 0.0);
    let mut parent = cell.parent.as_deref();
    for _ in 0..NESTING {
        let Some(group) = parent.and_then(|id| cells.get(id)) else { break };
        if let Some(geometry) = group.geometry.as_ref().filter(|geometry| !group.is_line && !geometry.relative) {
            at = (at.0 + geometry.at.0, at.1 + geometry.at.1);
        }
        parent = group.parent.as_deref();
    }
    at
}

/// The outline of a shape on its page: a rectangle, possibly rotated and flipped about its centre.
#[derive(Debug, Clone, Copy)]
pub(super) struct Outline {
    pub(super) centre: Point,
    /// Width and height before `rotation`.
    pub(super) size: (f64, f64),
    /// Clockwise quarter turns of the content.
    quarters: u8,
    flip: (bool, bool),
    /// Clockwise rotation in degrees.
    rotation: f64,
}

impl Outline {
    /// Returns the outline of a shape; `None` for a line or a cell without geometry.
    pub(super) fn of(cell: &Cell, cells: &Index) -> Option<Outline> {
        let geometry = cell.geometry.as_ref().filter(|_| !cell.is_line)?;
        let (x0, y0) = origin(cell, cells);
        let (w, h) = geometry.size;
        let (x, y) = match cell.parent.as_deref().and_then(|id| cells.get(id)).and_then(|group| group.geometry.as_ref())
        {
            Some(group) if geometry.relative => (geometry.at.0 * group.size.0, geometry.at.1 * group.size.1),
            _ => geometry.at,
        };
        let on = |key: &str| cell.style.get(key).is_some_and(|value| value == "1");
        let quarters = match cell.style.get("direction").map(String::as_str) {
            Some("south") => 1,
            Some("west") => 2,
            Some("north") => 3,
            _ => 0,
        };
        let rotation =
            cell.style.get("rotation").and_then(|text| text.parse().ok()).filter(|turn: &f64| turn.is_finite());
        Some(Outline {
            centre: (x0 + x + w / 2.0, y0 + y + h / 2.0),
            size: (w.abs(), h.abs()),
            quarters,
            flip: (on("flipH"), on("flipV")),
            rotation: rotation.unwrap_or(0.0) % 360.0,
        })
    }

    /// Returns the direction of the shape's right side, clockwise from east in degrees.
    pub(super) fn heading(&self) -> f64 {
        self.rotation + 90.0 * f64::from(self.quarters)
    }

    /// Returns width and height before the quarter turns.
    fn own_size(&self) -> (f64, f64) {
        let (w, h) = self.size;
        if self.quarters.is_multiple_of(2) { (w, h) } else { (h, w) }
    }

    /// Returns the position of a point of the shape on the page; shape coordinates start at its
    /// upper left corner.
    fn on_page(&self, (u, v): Point) -> Point {
        let (w, h) = self.own_size();
        let (mut x, mut y) = (u - w / 2.0, v - h / 2.0);
        for _ in 0..self.quarters {
            (x, y) = (-y, x);
        }
        if self.flip.0 {
            x = -x;
        }
        if self.flip.1 {
            y = -y;
        }
        let (sin, cos) = self.rotation.to_radians().sin_cos();
        (self.centre.0 + x * cos - y * sin, self.centre.1 + x * sin + y * cos)
    }

    /// Returns the centre line along the longer side.
    pub(super) fn middle_line(&self) -> [Point; 2] {
        let (w, h) = self.own_size();
        let ends = if w >= h { [(0.0, h / 2.0), (w, h / 2.0)] } else { [(w / 2.0, 0.0), (w / 2.0, h)] };
        ends.map(|end| self.on_page(end))
    }
}

/// Returns the centre lines of a wall; `None` if the cell is not a wall.
pub(super) fn wall(cell: &Cell, cells: &Index) -> Option<Vec<Point>> {
    let outline = Outline::of(cell, cells)?;
    let (w, h) = outline.own_size();
    let thickness =
        cell.style.get("wallThickness").and_then(|text| text.parse().ok()).filter(|value: &f64| *value >= 0.0);
    let half = thickness.unwrap_or(THICKNESS).min(w).min(h) / 2.0;
    let corners = match cell.style.get("shape").map_or("", String::as_str) {
        "mxgraph.floorplan.wall" => return Some(outline.middle_line().to_vec()),
        "mxgraph.floorplan.wallU" => vec![(half, h), (half, half), (w - half, half), (w - half, h)],
        "mxgraph.floorplan.wallCorner" => vec![(half, h), (half, half), (w, half)],
        "mxgraph.floorplan.room" => {
            vec![(half, half), (w - half, half), (w - half, h - half), (half, h - half), (half, half)]
        }
        "" if is_plain_and_thin(cell, outline.size) => return Some(outline.middle_line().to_vec()),
        _ => return None,
    };
    Some(corners.into_iter().map(|corner| outline.on_page(corner)).collect())
}

fn is_plain_and_thin(cell: &Cell, (w, h): (f64, f64)) -> bool {
    let other = ["ellipse", "text", "group", "swimlane", "line", "image", "rhombus", "triangle", "edgeLabel"];
    let plain = other.iter().all(|word| !cell.style.contains_key(*word));
    plain && cell.label.is_empty() && w.min(h) > 0.0 && w.min(h) <= THIN && w.max(h) >= 2.0 * w.min(h)
}

/// The points of a line on the page; an end at a cell has no point.
pub(super) struct Line {
    pub(super) source: Option<Point>,
    pub(super) between: Vec<Point>,
    pub(super) target: Option<Point>,
}

/// Returns the points of a line; `None` if the cell is not a line.
pub(super) fn line(cell: &Cell, cells: &Index) -> Option<Line> {
    let geometry = cell.geometry.as_ref().filter(|_| cell.is_line)?;
    let (x0, y0) = origin(cell, cells);
    let on_page = |(x, y): Point| (x0 + x, y0 + y);
    Some(Line {
        source: geometry.source.map(on_page),
        between: geometry.points.iter().copied().map(on_page).collect(),
        target: geometry.target.map(on_page),
    })
}
