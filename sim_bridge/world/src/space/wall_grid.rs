//! Spatial index of walls.

use super::rays::{Ray, Segment};
use nalgebra::Vector2;

/// The walls of a level in a grid of square cells. A wall is stored in every cell that its bounding
/// box touches.
#[derive(Debug, Clone, Default)]
pub struct WallGrid {
    segments: Vec<Segment>,
    /// Cells, row by row.
    cells: Vec<Vec<u32>>,
    origin: Vector2<f64>,
    cell_m: f64,
    columns: usize,
    rows: usize,
}

/// Greatest number of cells of a grid. Large levels have larger cells.
const CELLS_MAX: f64 = 65_536.0;
/// Default width of a cell, in metres: about a corridor.
const CELL_M: f64 = 2.0;

impl WallGrid {
    /// Creates the index from polylines of (x, y) in metres.
    ///
    /// # Panics
    /// Panics if a coordinate is not finite.
    pub fn new<'a>(polylines: impl IntoIterator<Item = &'a [(f64, f64)]>) -> WallGrid {
        let corner = |(x, y): (f64, f64)| Vector2::new(x, y);
        let pieces = polylines.into_iter().flat_map(|line| line.windows(2));
        let segments: Vec<Segment> = pieces.map(|ends| Segment { a: corner(ends[0]), b: corner(ends[1]) }).collect();
        let Some(first) = segments.first() else { return WallGrid::default() };
        let (mut low, mut high) = (first.a, first.a);
        for corner in segments.iter().flat_map(|wall| [wall.a, wall.b]) {
            assert!(corner.iter().all(|part| part.is_finite()), "the coordinates of a wall are finite: {corner}");
            (low, high) = (low.inf(&corner), high.sup(&corner));
        }
        let size = high - low;
        let cell_m = CELL_M.max((size.x * size.y / CELLS_MAX).sqrt() * 2.0).max((size.x + size.y) / CELLS_MAX * 2.0);
        let (columns, rows) = ((size.x / cell_m) as usize + 1, (size.y / cell_m) as usize + 1);
        let mut walls = WallGrid { segments, cells: vec![vec![]; columns * rows], origin: low, cell_m, columns, rows };
        for name in 0..walls.segments.len() {
            let Segment { a, b } = walls.segments[name];
            let ((left, bottom), (right, top)) = (walls.cell(a.inf(&b)), walls.cell(a.sup(&b)));
            for row in bottom..=top {
                for cell in &mut walls.cells[row * columns + left..=row * columns + right] {
                    cell.push(u32::try_from(name).expect("a floor has fewer walls than that"));
                }
            }
        }
        walls
    }

    /// Checks whether there are no walls.
    pub fn is_empty(&self) -> bool {
        self.segments.is_empty()
    }

    fn cell(&self, at: Vector2<f64>) -> (usize, usize) {
        let part = (at - self.origin) / self.cell_m;
        ((part.x as usize).min(self.columns - 1), (part.y as usize).min(self.rows - 1))
    }

    /// Returns the distance from a point to the nearest wall in metres, if it is at most `reach_m`.
    pub(crate) fn nearest_distance(&self, at: Vector2<f64>, reach_m: f64) -> Option<f64> {
        if self.is_empty() {
            return None;
        }
        let reach = Vector2::repeat(reach_m);
        let ((left, bottom), (right, top)) = (self.cell(at - reach), self.cell(at + reach));
        let rows = (bottom..=top).map(|row| &self.cells[row * self.columns + left..=row * self.columns + right]);
        let names = rows.flatten().flatten();
        let distance = |name: &u32| (self.segments[*name as usize].closest_point(at) - at).norm();
        names.map(distance).filter(|distance| *distance <= reach_m).min_by(f64::total_cmp)
    }

    /// Returns the distance along a ray to the first wall in metres, if it is at most `reach_m`.
    pub(crate) fn first_hit(&self, ray: &Ray, reach_m: f64) -> Option<f64> {
        if self.is_empty() {
            return None;
        }
        // Section by section, each no longer than a cell is wide: the first section with a hit
        // contains the first hit.
        let mut from_m = 0.0;
        let mut best: Option<f64> = None;
        while from_m < reach_m && best.is_none() {
            let to_m = (from_m + self.cell_m).min(reach_m);
            let (a, b) = (ray.at(from_m), ray.at(to_m));
            let ((left, bottom), (right, top)) = (self.cell(a.inf(&b)), self.cell(a.sup(&b)));
            for row in bottom..=top {
                for name in self.cells[row * self.columns + left..=row * self.columns + right].iter().flatten() {
                    let hit = ray.intersect_wall(&self.segments[*name as usize]).filter(|hit| *hit <= to_m);
                    best = hit.into_iter().chain(best).min_by(f64::total_cmp);
                }
            }
            from_m = to_m;
        }
        best
    }

    /// Checks whether no wall stands between two points.
    pub fn is_clear(&self, a: Vector2<f64>, b: Vector2<f64>) -> bool {
        Ray::towards(a, b).is_none_or(|(ray, length)| self.first_hit(&ray, length).is_none())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_room_is_visible_inside_and_closed_to_the_outside() {
        let room = [(0.0, 0.0), (10.0, 0.0), (10.0, 6.0), (0.0, 6.0), (0.0, 0.0)];
        let walls = WallGrid::new([room.as_slice()]);
        let middle = Vector2::new(5.0, 3.0);
        assert_eq!(walls.first_hit(&Ray::at_angle(middle, 0.0), 30.0), Some(5.0));
        assert_eq!(walls.first_hit(&Ray::at_angle(middle, 0.0), 4.0), None);
        assert_eq!(walls.nearest_distance(middle, 10.0), Some(3.0));
        assert_eq!(walls.nearest_distance(middle, 2.0), None);
        assert!(walls.is_clear(middle, Vector2::new(9.0, 5.0)));
        assert!(!walls.is_clear(middle, Vector2::new(11.0, 5.0)));
        assert!(WallGrid::new([]).is_clear(middle, Vector2::zeros()));
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn a_query_agrees_with_an_exhaustive_search_of_walls(
            lines in prop::collection::vec(((-20.0..20.0, -20.0..20.0), (-20.0..20.0, -20.0..20.0)), 0..30),
            (x, y, angle, reach) in (-25.0..25.0, -25.0..25.0, -3.2..3.2, 0.0..40.0),
        ) {
            let lines: Vec<[(f64, f64); 2]> = lines.into_iter().map(|(a, b)| [a, b]).collect();
            let walls = WallGrid::new(lines.iter().map(|line| line.as_slice()));
            let (at, ray) = (Vector2::new(x, y), Ray::at_angle(Vector2::new(x, y), angle));
            let hits = walls.segments.iter().filter_map(|wall| ray.intersect_wall(wall)).filter(|hit| *hit <= reach);
            prop_assert_eq!(walls.first_hit(&ray, reach), hits.min_by(f64::total_cmp));
            let distances = walls.segments.iter().map(|wall| (wall.closest_point(at) - at).norm());
            let nearest = distances.filter(|distance| *distance <= reach).min_by(f64::total_cmp);
            prop_assert_eq!(walls.nearest_distance(at, reach), nearest);
        }
    }
}
