//! Spatial index of bodies.

use nalgebra::{Vector2, Vector3};

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

impl Disc {
    /// Level of a body that is near no other, for example in a lift.
    pub(crate) const NO_LEVEL: usize = usize::MAX;
}

/// Bodies in a grid of square cells; the bodies of a cell are stored together. A body's number is
/// its position in the order in which the bodies were added.
///
/// Bodies that move a little keep their places in the grid, and queries examine as many more cells.
/// They are sorted again when one of them has strayed by a quarter of a cell.
#[derive(Debug)]
pub(crate) struct BodyGrid {
    discs: Vec<Disc>,
    /// The discs, ordered by the cells in which they were when they were sorted, with their numbers.
    sorted: Vec<(Disc, u32)>,
    /// Position of each body in `sorted`.
    slots: Vec<u32>,
    /// Where each body was when they were sorted.
    sorted_at: Vec<Vector2<f64>>,
    /// Greatest distance along an axis of a body from there, in metres.
    strayed_m: f64,
    /// Start of each cell in `sorted`, with an extra entry at the end.
    begins: Vec<u32>,
    /// Cells by which the bodies are sorted.
    cells: Cells,
    /// Cells that fit the bodies where they are now.
    cells_now: Cells,
    /// Least width of a cell, in metres.
    cell_min_m: f64,
    largest_m: f64,
    /// Scratch space for sorting, reused.
    cell_numbers: Vec<u32>,
}

/// A rectangle of square cells.
#[derive(Debug, Clone, Copy, Default)]
struct Cells {
    origin: Vector2<f64>,
    cell_m: f64,
    columns: usize,
    rows: usize,
}

/// Greatest number of cells per body. If bodies are scattered, the cells grow instead.
const CELLS_PER_BODY: f64 = 4.0;
/// Share of a cell's width by which bodies may stray before they are sorted again. More makes
/// queries slower, less makes sorting more frequent.
const STRAY_SHARE: f64 = 0.25;

impl Cells {
    /// Returns the cells that cover a rectangle with a number of bodies, of at least `cell_min_m`
    /// metres.
    fn covering(low: Vector2<f64>, high: Vector2<f64>, bodies: usize, cell_min_m: f64) -> Cells {
        let (width, height) = (high.x - low.x, high.y - low.y);
        let most = CELLS_PER_BODY * bodies.max(16) as f64;
        // Both a long row of cells and a square field of cells must stay below the limit.
        let cell_m = cell_min_m.max((width * height / most).sqrt() * 2.0).max((width + height) / most * 2.0);
        let (columns, rows) = ((width / cell_m) as usize + 1, (height / cell_m) as usize + 1);
        Cells { origin: low, cell_m, columns, rows }
    }

    /// Returns the column and the row of the nearest cell to a point.
    fn at(&self, x: f64, y: f64) -> (usize, usize) {
        // A cast of a negative or too large number saturates at the edge of the grid.
        let column = ((x - self.origin.x) / self.cell_m) as usize;
        let row = ((y - self.origin.y) / self.cell_m) as usize;
        (column.min(self.columns - 1), row.min(self.rows - 1))
    }

    /// Returns the number of the nearest cell to a point. Cells are numbered row by row.
    fn number_at(&self, at: &Vector3<f64>) -> u32 {
        let (column, row) = self.at(at.x, at.y);
        u32::try_from(row * self.columns + column).expect("there are few cells for each body")
    }
}

impl BodyGrid {
    /// Creates a grid without bodies, in cells of at least `cell_m` metres. The best cell size is
    /// about the usual query distance.
    ///
    /// # Panics
    /// Panics if the cell size is not above 0.
    pub(crate) fn new(cell_m: f64) -> BodyGrid {
        assert!(cell_m > 0.0, "cells have a size, not {cell_m}");
        BodyGrid {
            discs: Vec::new(),
            sorted: Vec::new(),
            slots: Vec::new(),
            sorted_at: Vec::new(),
            strayed_m: 0.0,
            begins: Vec::new(),
            cells: Cells::default(),
            cells_now: Cells::default(),
            cell_min_m: cell_m,
            largest_m: 0.0,
            cell_numbers: Vec::new(),
        }
    }

    /// Adds a body. Queries find it after the next [`refresh`](Self::refresh).
    pub(crate) fn add(&mut self, disc: Disc) {
        self.discs.push(disc);
        self.strayed_m = f64::INFINITY;
    }

    /// Moves a body.
    ///
    /// # Panics
    /// Panics if the position is not finite, or if there is no such body.
    pub(crate) fn place(&mut self, number: usize, at: Vector3<f64>, level: usize) {
        assert!(at.iter().all(|part| part.is_finite()), "the position of a body is finite: {at:?}");
        let disc = &mut self.discs[number];
        (disc.at, disc.level) = (at, level);
        if let Some(slot) = self.slots.get(number) {
            self.sorted[*slot as usize].0 = *disc;
            let strayed = at.xy() - self.sorted_at[number];
            self.strayed_m = self.strayed_m.max(strayed.x.abs()).max(strayed.y.abs());
        }
    }

    /// Completes a change of any number of bodies.
    pub(crate) fn refresh(&mut self) {
        let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
        let mut bodies = 0;
        self.largest_m = 0.0;
        for disc in self.discs.iter().filter(|disc| disc.level != Disc::NO_LEVEL) {
            low = Vector2::new(low.x.min(disc.at.x), low.y.min(disc.at.y));
            high = Vector2::new(high.x.max(disc.at.x), high.y.max(disc.at.y));
            self.largest_m = self.largest_m.max(disc.radius_m);
            bodies += 1;
        }
        if bodies == 0 {
            (low, high) = (Vector2::zeros(), Vector2::zeros());
        }
        self.cells_now = Cells::covering(low, high, bodies, self.cell_min_m);
        if self.strayed_m > STRAY_SHARE * self.cells.cell_m {
            self.sort();
        }
    }

    /// Counting sort: bodies of a cell keep their order.
    fn sort(&mut self) {
        (self.cells, self.strayed_m) = (self.cells_now, 0.0);
        self.begins.clear();
        self.begins.resize(self.cells.columns * self.cells.rows + 1, 0);
        self.cell_numbers.clear();
        self.sorted_at.clear();
        for disc in &self.discs {
            let cell = self.cells.number_at(&disc.at);
            self.begins[cell as usize + 1] += 1;
            self.cell_numbers.push(cell);
            self.sorted_at.push(disc.at.xy());
        }
        for cell in 1..self.begins.len() {
            self.begins[cell] += self.begins[cell - 1];
        }
        let nowhere = (Disc { at: Vector3::zeros(), radius_m: 0.0, level: Disc::NO_LEVEL }, 0);
        self.sorted.clear();
        self.sorted.resize(self.discs.len(), nowhere);
        self.slots.clear();
        self.slots.resize(self.discs.len(), 0);
        // From the last to the first, each to the end of the rest of its cell.
        for (number, disc) in self.discs.iter().enumerate().rev() {
            let end = &mut self.begins[self.cell_numbers[number] as usize + 1];
            *end -= 1;
            self.slots[number] = *end;
            self.sorted[*end as usize] = (*disc, body_number(number));
        }
        // The end stored at `cell + 1` is now the start of `cell`.
        self.begins.rotate_left(1);
        if let Some(last) = self.begins.last_mut() {
            *last = body_number(self.discs.len());
        }
    }

    /// Returns a body by its number.
    pub(crate) fn disc(&self, number: usize) -> &Disc {
        &self.discs[number]
    }

    /// Largest radius of all bodies, in metres.
    pub(crate) fn max_radius_m(&self) -> f64 {
        self.largest_m
    }

    /// Calls `show` for every body whose centre is at most `reach_m` metres from a point of its
    /// level. The order depends on earlier positions: see
    /// [`collect_near`](Self::collect_near). Returns the number of bodies examined.
    pub(crate) fn for_each_near(
        &self,
        at: &Vector3<f64>,
        level: usize,
        reach_m: f64,
        mut show: impl FnMut(usize, &Disc),
    ) -> usize {
        if self.sorted.is_empty() {
            return 0;
        }
        let range_m = reach_m + self.strayed_m;
        let (left, bottom) = self.cells.at(at.x - range_m, at.y - range_m);
        let (right, top) = self.cells.at(at.x + range_m, at.y + range_m);
        let (reach_2, mut looked_at) = (reach_m * reach_m, 0);
        for row in bottom..=top {
            let first = self.begins[row * self.cells.columns + left] as usize;
            let end = self.begins[row * self.cells.columns + right + 1] as usize;
            looked_at += end - first;
            for (disc, number) in &self.sorted[first..end] {
                if disc.level == level && (disc.at - at).norm_squared() <= reach_2 {
                    show(*number as usize, disc);
                }
            }
        }
        looked_at
    }

    /// Collects the bodies that [`for_each_near`](Self::for_each_near) shows, in an order that
    /// depends only on where the bodies are now: cell by cell, then by number.
    pub(crate) fn collect_near(&self, at: &Vector3<f64>, level: usize, reach_m: f64, near: &mut Vec<NearBody>) {
        near.clear();
        self.for_each_near(at, level, reach_m, |number, disc| {
            near.push(NearBody { cell: self.cells_now.number_at(&disc.at), number: body_number(number) });
        });
        near.sort_unstable();
    }
}

/// A body that a query found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct NearBody {
    cell: u32,
    number: u32,
}

impl NearBody {
    /// Returns the number of the body.
    pub(crate) fn number(self) -> usize {
        self.number as usize
    }
}

fn body_number(number: usize) -> u32 {
    u32::try_from(number).expect("fewer bodies than a u32 counts")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn disc(x: f64, y: f64) -> Disc {
        Disc { at: Vector3::new(x, y, 0.0), radius_m: 0.25, level: 0 }
    }

    fn laid_out(discs: Vec<Disc>, cell_m: f64) -> BodyGrid {
        let mut bodies = BodyGrid::new(cell_m);
        discs.into_iter().for_each(|disc| bodies.add(disc));
        bodies.refresh();
        bodies
    }

    /// Returns the numbers of the bodies near a point of level 0, in their fixed order.
    fn collected(bodies: &BodyGrid, x: f64, y: f64, reach_m: f64) -> Vec<usize> {
        let mut found = Vec::new();
        bodies.collect_near(&Vector3::new(x, y, 0.0), 0, reach_m, &mut found);
        found.into_iter().map(NearBody::number).collect()
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
    fn a_body_without_a_level_is_near_no_other() {
        let mut bodies = laid_out(vec![disc(0.0, 0.0), Disc { radius_m: 3.0, ..disc(0.5, 0.0) }], 1.0);
        bodies.place(1, Vector3::zeros(), Disc::NO_LEVEL);
        bodies.refresh();
        assert_eq!((near(&bodies, 0.0, 0.0, 5.0), bodies.max_radius_m()), (vec![0], 0.25));
        bodies.place(1, Vector3::new(40.0, 0.0, 0.0), 0);
        bodies.refresh();
        assert_eq!((near(&bodies, 39.0, 0.0, 5.0), bodies.max_radius_m()), (vec![1], 3.0));
    }

    #[test]
    fn bodies_that_move_a_little_are_not_sorted_again() {
        let mut bodies = laid_out(vec![disc(0.0, 0.0), disc(9.9, 0.0), disc(20.0, 0.0)], 2.0);
        bodies.place(1, Vector3::new(10.3, 0.0, 0.0), 0);
        bodies.refresh();
        assert_eq!((bodies.strayed_m, near(&bodies, 10.4, 0.0, 0.2)), (10.3 - 9.9, vec![1]));
        bodies.place(1, Vector3::new(11.0, 0.0, 0.0), 0);
        bodies.refresh();
        assert_eq!((bodies.strayed_m, near(&bodies, 11.0, 0.0, 0.2)), (0.0, vec![1]));
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

        #[test]
        fn moved_bodies_are_found_in_the_order_of_bodies_sorted_anew(
            spots in prop::collection::vec((-20.0..20.0, -20.0..20.0), 1..60),
            moves in prop::collection::vec((0..60_usize, -1.5..1.5, -1.5..1.5, 0..8_usize), 0..200),
            (x, y, reach, cell) in (-25.0..25.0, -25.0..25.0, 0.0..10.0, 0.2..5.0),
        ) {
            let mut discs: Vec<Disc> = spots.iter().map(|(x, y)| disc(*x, *y)).collect();
            let mut bodies = laid_out(discs.clone(), cell);
            for (number, dx, dy, level) in moves {
                let number = number % discs.len();
                let moved = &mut discs[number];
                // One move in eight ends on level 1, the others on level 0.
                (moved.at, moved.level) = (moved.at + Vector3::new(dx, dy, 0.0), level / 7);
                bodies.place(number, moved.at, moved.level);
                bodies.refresh();
            }
            prop_assert_eq!(collected(&bodies, x, y, reach), collected(&laid_out(discs, cell), x, y, reach));
        }
    }
}
