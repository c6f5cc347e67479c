//! Placement of names: they cover little of the map, and do not cover each other.

use super::elements::Point;
use std::collections::BTreeMap;

/// Edge of a cell of the index, in pixels.
const CELL: f64 = 48.0;
/// Distance of the boxes that represent a line, in pixels.
const STEP: f64 = 8.0;
/// Distance of a name from its point, in pixels.
const GAP: f64 = 4.0;

/// Kind of drawn content that a name may cover, with its cost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Weight {
    Lane,
    Wall,
    Dot,
    Name,
}

impl Weight {
    fn cost(self) -> f64 {
        match self {
            Weight::Lane => 1.0,
            Weight::Wall => 2.0,
            Weight::Dot => 4.0,
            Weight::Name => 20.0,
        }
    }
}

/// The occupied areas of a panel.
#[derive(Debug, Default)]
pub(super) struct Labels {
    cells: BTreeMap<(i64, i64), Vec<(Area, Weight)>>,
}

#[derive(Debug, Clone, Copy)]
struct Area {
    low: Point,
    high: Point,
}

impl Area {
    fn around((x, y): Point, half: f64) -> Area {
        Area { low: (x - half, y - half), high: (x + half, y + half) }
    }

    /// Returns the common area, in square pixels.
    fn shared(&self, other: &Area) -> f64 {
        let side = |low: f64, high: f64| (high - low).max(0.0);
        side(self.low.0.max(other.low.0), self.high.0.min(other.high.0))
            * side(self.low.1.max(other.low.1), self.high.1.min(other.high.1))
    }

    fn cells(&self) -> impl Iterator<Item = (i64, i64)> + use<> {
        let cell = |value: f64| (value / CELL).floor() as i64;
        let (x0, y0, x1, y1) = (cell(self.low.0), cell(self.low.1), cell(self.high.0), cell(self.high.1));
        (x0..=x1).flat_map(move |x| (y0..=y1).map(move |y| (x, y)))
    }
}

/// Returns the width of a text in pixels: all letters of the font have the same width.
pub(super) fn width(text: &str, size: f64) -> f64 {
    text.chars().count() as f64 * size * 0.602
}

impl Labels {
    pub(super) fn dot(&mut self, at: Point, radius: f64) {
        self.add(Area::around(at, radius), Weight::Dot);
    }

    pub(super) fn line(&mut self, a: Point, b: Point, weight: Weight) {
        let steps = ((b.0 - a.0).hypot(b.1 - a.1) / STEP).ceil().max(1.0);
        for step in 0..=steps as u32 {
            let share = f64::from(step) / steps;
            let at = (a.0 + share * (b.0 - a.0), a.1 + share * (b.1 - a.1));
            self.add(Area::around(at, STEP / 2.0), weight);
        }
    }

    /// Returns the lower left corner for a text near a point; `None` for an optional text that
    /// would cover another text.
    pub(super) fn find(&mut self, text: &str, at: Point, size: f64, needed: bool) -> Option<Point> {
        let (wide, high) = (width(text, size), size);
        let (right, left, middle) = (at.0 + GAP + 5.0, at.0 - GAP - 5.0 - wide, at.0 - wide / 2.0);
        let (above, below, level) = (at.1 - GAP - 5.0, at.1 + GAP + 5.0 + high * 0.75, at.1 + high * 0.35);
        let corners = [
            (right, level),
            (middle, above),
            (middle, below),
            (left, level),
            (right, above),
            (right, below),
            (left, above),
            (left, below),
        ];
        let costs = corners.map(|corner| (self.cost(&area(corner, wide, high)), corner));
        // Of equal costs the first.
        let best = costs.into_iter().min_by(|a, b| a.0.0.total_cmp(&b.0.0))?;
        let ((_, covers_name), corner) = best;
        if covers_name && !needed {
            return None;
        }
        self.add(area(corner, wide, high), Weight::Name);
        Some(corner)
    }

    fn cost(&self, area: &Area) -> (f64, bool) {
        let mut cost = 0.0;
        let mut covers_name = false;
        for (other, weight) in area.cells().filter_map(|cell| self.cells.get(&cell)).flatten() {
            let shared = area.shared(other);
            cost += shared * weight.cost();
            covers_name |= shared > 0.0 && *weight == Weight::Name;
        }
        (cost, covers_name)
    }

    fn add(&mut self, area: Area, weight: Weight) {
        for cell in area.cells() {
            self.cells.entry(cell).or_default().push((area, weight));
        }
    }
}

/// Returns the area of a text; the given point is its lower left corner, on the baseline.
fn area((x, foot): Point, wide: f64, high: f64) -> Area {
    Area { low: (x, foot - high * 0.8), high: (x + wide, foot + high * 0.25) }
}
