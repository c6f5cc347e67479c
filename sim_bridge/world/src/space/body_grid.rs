//! Spatial index of bodies.

use nalgebra::Vector3;

/// Space that a body occupies: a disc seen from above, a ball in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Disc {
    /// Centre: x, y, and height above the floor of its level, in metres.
    pub at: Vector3<f64>,
    /// Distance from the centre to the outermost part, in metres.
    pub radius_m: f64,
    /// Level of the body. Bodies on different levels are never near each other.
    pub level: usize,
}

/// Bodies in a grid of square cells; the bodies of a cell are stored together. A body's index is
/// its position in the list given to [`rebuild`](BodyGrid::rebuild).
#[derive(Debug, Default)]
pub(crate) struct BodyGrid {
    discs: Vec<Disc>,
    /// The discs ordered by cell, with their indices.
    sorted: Vec<(Disc, usize)>,
    /// Start of each cell in `sorted`, with an extra entry at the end.
    begins: Vec<u32>,
    origin: (f64, f64),
    cell_m: f64,
    columns: usize,
    rows: usize,
    largest_m: f64,
    /// Scratch space for sorting, reused between rebuilds.
    cells: Vec<u32>,
}

/// Greatest number of cells per body. If bodies are scattered, the cells grow instead.
const CELLS_PER_BODY: f64 = 4.0;

impl BodyGrid {
    /// Replaces the content with `discs`, in cells of at least `cell_m` metres. The best cell size
    /// is about the usual query distance.
    ///
    /// # Panics
    /// Panics if a position is not finite, or the cell size is not above 0.
    pub(crate) fn rebuild(&mut self, discs: impl IntoIterator<Item = Disc>, cell_m: f64) {
        assert!(cell_m > 0.0, "cells have a size, not {cell_m}");
        self.discs.clear();
        self.discs.extend(discs);
        let (mut low, mut high) = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
        self.largest_m = 0.0;
        for disc in &self.discs {
            assert!(disc.at.iter().all(|part| part.is_finite()), "the position of a body is finite: {:?}", disc.at);
            low = (low.0.min(disc.at.x), low.1.min(disc.at.y));
            high = (high.0.max(disc.at.x), high.1.max(disc.at.y));
            self.largest_m = self.largest_m.max(disc.radius_m);
        }
        if self.discs.is_empty() {
            (low, high) = ((0.0, 0.0), (0.0, 0.0));
        }
        let (width, height) = (high.0 - low.0, high.1 - low.1);
        let most = CELLS_PER_BODY * self.discs.len().max(16) as f64;
        // Both a long row of cells and a square field of cells must stay below the limit.
        let cell_m = cell_m.max((width * height / most).sqrt() * 2.0).max((width + height) / most * 2.0);
        (self.origin, self.cell_m) = (low, cell_m);
        (self.columns, self.rows) = ((width / cell_m) as usize + 1, (height / cell_m) as usize + 1);
        self.sort();
    }

    /// Counting sort: bodies of a cell keep their order.
    fn sort(&mut self) {
        self.begins.clear();
        self.begins.resize(self.columns * self.rows + 1, 0);
        self.cells.clear();
        for disc in &self.discs {
            let (column, row) = self.cell(disc.at.x, disc.at.y);
            let cell = row * self.columns + column;
            self.begins[cell + 1] += 1;
            self.cells.push(u32::try_from(cell).expect("there are few cells for each body"));
        }
        for cell in 1..self.begins.len() {
            self.begins[cell] += self.begins[cell - 1];
        }
        let nowhere = (Disc { at: Vector3::zeros(), radius_m: 0.0, level: 0 }, 0);
        self.sorted.clear();
        self.sorted.resize(self.discs.len(), nowhere);
        // From the last to the first, each to the end of the rest of its cell.
        for (name, disc) in self.discs.iter().enumerate().rev() {
            let end = &mut self.begins[self.cells[name] as usize + 1];
            *end -= 1;
            self.sorted[*end as usize] = (*disc, name);
        }
        // The end stored at `cell + 1` is now the start of `cell`.
        self.begins.rotate_left(1);
        if let Some(last) = self.begins.last_mut() {
            *last = u32::try_from(self.discs.len()).expect("fewer bodies than cells are numbered for");
        }
    }

    fn cell(&self, x: f64, y: f64) -> (usize, usize) {
        // A cast of a negative or too large number saturates at the edge of the grid.
        let column = ((x - self.origin.0) / self.cell_m) as usize;
        let row = ((y - self.origin.1) / self.cell_m) as usize;
        (column.min(self.columns - 1), row.min(self.rows - 1))
    }

    /// Returns a body by its index.
    pub(crate) fn disc(&self, name: usize) -> &Disc {
        &self.discs[name]
    }

    /// Largest radius of all bodies, in metres.
    pub(crate) fn max_radius_m(&self) -> f64 {
        self.largest_m
    }

    /// Calls `show` for every body whose centre is at most `reach_m` metres from a point of its
    /// level, in a fixed order. Returns the number of bodies examined.
    pub(crate) fn for_each_near(
        &self,
        at: &Vector3<f64>,
        level: usize,
        reach_m: f64,
        mut show: impl FnMut(usize, &Disc),
    ) -> usize {
        if self.discs.is_empty() {
            return 0;
        }
        let (left, bottom) = self.cell(at.x - reach_m, at.y - reach_m);
        let (right, top) = self.cell(at.x + reach_m, at.y + reach_m);
        let (reach_2, mut looked_at) = (reach_m * reach_m, 0);
        for row in bottom..=top {
            let first = self.begins[row * self.columns + left] as usize;
            let end = self.begins[row * self.columns + right + 1] as usize;
            looked_at += end - first;
            for (disc, name) in &self.sorted[first..end] {
                if disc.level == level && (disc.at - at).norm_squared() <= reach_2 {
                    show(*name, disc);
                }
            }
        }
        looked_at
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn disc(x: f64, y: f64) -> Disc {
        Disc { at: Vector3::new(x, y, 0.0), radius_m: 0.25, level: 0 }
    }

    fn laid_out(discs: Vec<Disc>, cell_m: f64) -> BodyGrid {
        let mut bodies = BodyGrid::default();
        bodies.rebuild(discs, cell_m);
        bodies
    }

    fn near(bodies: &BodyGrid, x: f64, y: f64, reach_m: f64) -> Vec<usize> {
        let mut found = Vec::new();
        bodies.for_each_near(&Vector3::new(x, y, 0.0), 0, reach_m, |name, _| found.push(name));
        found.sort_unstable();
        found
    }

    /// Calls `show` for each pair of touching bodies, the smaller index first. Returns the number
    /// of pairs examined.
    fn touching(bodies: &BodyGrid, mut show: impl FnMut(usize, usize)) -> usize {
        let mut looked_at = 0;
        for (name, disc) in bodies.discs.iter().enumerate() {
            looked_at +=
                bodies.for_each_near(&disc.at, disc.level, disc.radius_m + bodies.largest_m, |other, found| {
                    let touch_m = disc.radius_m + found.radius_m;
                    if other > name && (found.at - disc.at).norm_squared() < touch_m * touch_m {
                        show(name, other);
                    }
                });
        }
        looked_at
    }

    #[test]
    fn bodies_on_another_level_are_not_near() {
        let bodies = laid_out(vec![disc(0.0, 0.0), Disc { level: 1, ..disc(0.1, 0.0) }, disc(0.2, 0.0)], 1.0);
        assert_eq!(near(&bodies, 0.0, 0.0, 5.0), [0, 2]);
        let mut pairs = Vec::new();
        touching(&bodies, |a, b| pairs.push((a, b)));
        assert_eq!(pairs, [(0, 2)]);
        assert_eq!(near(&laid_out(vec![], 1.0), 0.0, 0.0, 5.0), [0_usize; 0]);
    }

    #[test]
    fn work_grows_with_the_number_of_bodies_and_not_with_its_square() {
        let field = |side: usize| {
            let spots = (0..side * side).map(|n| disc((n % side) as f64 * 2.0, (n / side) as f64 * 2.0));
            touching(&laid_out(spots.collect(), 1.0), |_, _| panic!("they stand apart"))
        };
        let (quarter, ten_thousand) = (field(50), field(100));
        let times = ten_thousand as f64 / quarter as f64;
        assert!((3.6..4.4).contains(&times), "{quarter} pairs for 2500 bodies, {ten_thousand} for 10000");
        assert!(ten_thousand < 60_000, "{ten_thousand} pairs for 10000 bodies, of 49995000 that there are");
    }

    #[test]
    fn a_distant_body_costs_no_memory() {
        let bodies = laid_out(vec![disc(0.0, 0.0), disc(0.3, 0.0), disc(1e9, 1e9)], 0.5);
        assert!(bodies.begins.len() < 200, "{} cells", bodies.begins.len());
        assert_eq!(near(&bodies, 0.0, 0.0, 1.0), [0, 1]);
        let bodies = laid_out(vec![disc(0.0, 0.0), disc(1e9, 0.0)], 0.5);
        assert!(bodies.begins.len() < 200, "{} cells", bodies.begins.len());
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn a_query_agrees_with_an_exhaustive_search(
            spots in prop::collection::vec((-20.0..20.0, -20.0..20.0, 0.05..1.5), 0..60),
            (x, y, reach, cell) in (-25.0..25.0, -25.0..25.0, 0.0..10.0, 0.2..5.0),
        ) {
            let discs: Vec<Disc> = spots.iter().map(|(x, y, r)| Disc { radius_m: *r, ..disc(*x, *y) }).collect();
            let bodies = laid_out(discs.clone(), cell);
            let at = Vector3::new(x, y, 0.0);
            let all: Vec<usize> = (0..discs.len()).filter(|n| (discs[*n].at - at).norm() <= reach).collect();
            prop_assert_eq!(near(&bodies, x, y, reach), all);
            let mut pairs = Vec::new();
            touching(&bodies, |a, b| pairs.push((a, b)));
            pairs.sort_unstable();
            let touch = |a: usize, b: usize| (discs[a].at - discs[b].at).norm() < discs[a].radius_m + discs[b].radius_m;
            let all: Vec<_> = (0..discs.len()).flat_map(|a| (a + 1..discs.len()).map(move |b| (a, b))).filter(|(a, b)| touch(*a, *b)).collect();
            prop_assert_eq!(pairs, all);
        }
    }
}
