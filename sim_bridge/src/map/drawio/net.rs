//! From drawn paths and places to places and lanes.
//!
//! Points of paths are one where they lie in one cell of a grid. A line that leads past a point leads through it.
//! A place that no path leads to is joined to the nearest point of a path.

use super::shape::Point;
use super::{GRID, REACH};
use crate::map::building::intersection;
use std::collections::BTreeMap;

/// A point of the net, in units; y points down.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Spot {
    pub(super) at: Point,
    /// For a place drawn as such, which one.
    pub(super) place: Option<usize>,
}

/// A line of the net.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Way {
    pub(super) from: usize,
    pub(super) to: usize,
    /// Whether it may be driven from `from` to `to`, and back.
    pub(super) open: (bool, bool),
    pub(super) speed_limit_mps: Option<f64>,
}

/// Where a path leads through.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Via {
    /// A place, by its number.
    Place(usize),
    /// A point of the page.
    Point(Point),
}

/// The places and paths of one page.
#[derive(Debug, Default)]
pub(super) struct Net {
    pub(super) spots: Vec<Spot>,
    pub(super) ways: Vec<Way>,
    by_cell: BTreeMap<(i64, i64), usize>,
}

impl Net {
    /// A net of places without paths. Place `n` is spot `n`.
    pub(super) fn of(places: impl IntoIterator<Item = Point>) -> Net {
        let mut net = Net::default();
        for (number, at) in places.into_iter().enumerate() {
            net.by_cell.entry(cell(at)).or_insert(net.spots.len());
            net.spots.push(Spot { at, place: Some(number) });
        }
        net
    }

    /// Adds a path; false if it has no length.
    pub(super) fn path(&mut self, through: &[Via], one_way: bool, speed_limit_mps: Option<f64>) -> bool {
        let mut spots: Vec<usize> = through.iter().map(|via| self.spot(*via)).collect();
        spots.dedup();
        for pair in spots.windows(2) {
            self.ways.push(Way { from: pair[0], to: pair[1], open: (true, !one_way), speed_limit_mps });
        }
        spots.len() > 1
    }

    fn spot(&mut self, via: Via) -> usize {
        match via {
            Via::Place(number) => number,
            Via::Point(at) => {
                let cell = cell(at);
                *self.by_cell.entry(cell).or_insert_with(|| {
                    let at = ((cell.0 as f64 + 0.5) * GRID, (cell.1 as f64 + 0.5) * GRID);
                    self.spots.push(Spot { at, place: None });
                    self.spots.len() - 1
                })
            }
        }
    }

    /// Leads every line through the points that it leads past, and makes one of lines with the same ends.
    pub(super) fn tie(&mut self) {
        let mut tied: BTreeMap<(usize, usize), Way> = BTreeMap::new();
        for way in &self.ways {
            let (a, b) = (self.spots[way.from].at, self.spots[way.to].at);
            let others = self.spots.iter().enumerate().filter(|(index, _)| *index != way.from && *index != way.to);
            let mut met: Vec<(f64, usize)> = others
                .filter_map(|(index, spot)| {
                    let (share, away) = foot(spot.at, a, b);
                    (share > 0.0 && share < 1.0 && away <= GRID / 2.0).then_some((share, index))
                })
                .collect();
            met.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let stops: Vec<usize> =
                [way.from].into_iter().chain(met.into_iter().map(|(_, spot)| spot)).chain([way.to]).collect();
            for pair in stops.windows(2) {
                add(&mut tied, Way { from: pair[0], to: pair[1], ..*way });
            }
        }
        self.ways = tied.into_values().collect();
    }

    /// Joins each place that no path leads to with the nearest point of a path within reach to which no wall is in the
    /// way. Returns the places that there is none for.
    pub(super) fn join(&mut self, walls: &[Vec<Point>]) -> Vec<usize> {
        let mut alone: Vec<usize> = (0..self.spots.len()).filter(|spot| self.spots[*spot].place.is_some()).collect();
        alone.retain(|spot| self.ways.iter().all(|way| way.from != *spot && way.to != *spot));
        alone.retain(|spot| !self.join_one(*spot, walls));
        alone
    }

    fn join_one(&mut self, spot: usize, walls: &[Vec<Point>]) -> bool {
        let at = self.spots[spot].at;
        let free = |to: Point| {
            let sides = walls.iter().flat_map(|wall| wall.windows(2));
            !sides.into_iter().any(|side| intersection(at, to, side[0], side[1]).is_some())
        };
        // The foot of the perpendicular, and both ends: where a wall is in the way to one, another may do. A foot close
        // to an end is that end.
        let near = self.ways.iter().enumerate().flat_map(|(index, way)| {
            let (a, b) = (self.spots[way.from].at, self.spots[way.to].at);
            let (share, _) = foot(at, a, b);
            let foot = between(a, b, share);
            let close = |end: Point| distance(foot, end) <= GRID / 2.0;
            let share = if close(a) { 0.0 } else { share };
            let share = if close(b) { 1.0 } else { share };
            [share, 0.0, 1.0].map(|share| (between(a, b, share), share, index))
        });
        let near = near.map(|(to, share, way)| (distance(at, to), to, share, way));
        let mut near: Vec<_> = near.filter(|(away, ..)| *away <= REACH).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.3.cmp(&b.3)));
        let Some((_, to, share, index)) = near.into_iter().find(|(_, to, ..)| free(*to)) else { return false };
        let way = self.ways[index];
        let end = match share {
            share if share <= 0.0 => way.from,
            share if share >= 1.0 => way.to,
            _ => {
                let end = self.spots.len();
                self.spots.push(Spot { at: to, place: None });
                self.ways[index].to = end;
                self.ways.push(Way { from: end, ..way });
                end
            }
        };
        self.ways.push(Way { from: spot, to: end, open: (true, true), speed_limit_mps: None });
        true
    }
}

/// Adds a line, or opens up the one there is between the same ends: of two speed limits the lower holds.
fn add(tied: &mut BTreeMap<(usize, usize), Way>, way: Way) {
    let Way { from, to, open: (there, back), speed_limit_mps } = way;
    let (from, to, open) = if from < to { (from, to, (there, back)) } else { (to, from, (back, there)) };
    let known = tied.entry((from, to)).or_insert(Way { from, to, open, speed_limit_mps });
    known.open = (known.open.0 || open.0, known.open.1 || open.1);
    known.speed_limit_mps = match (known.speed_limit_mps, speed_limit_mps) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (a, b) => a.or(b),
    };
}

/// The cell of the grid that a point lies in.
pub(super) fn cell((x, y): Point) -> (i64, i64) {
    ((x / GRID).floor() as i64, (y / GRID).floor() as i64)
}

fn distance(a: Point, b: Point) -> f64 {
    (a.0 - b.0).hypot(a.1 - b.1)
}

fn between(a: Point, b: Point, share: f64) -> Point {
    (a.0 + share * (b.0 - a.0), a.1 + share * (b.1 - a.1))
}

/// The nearest point of a line, as the share of the way from `a` to `b`, and how far away it is.
fn foot(at: Point, a: Point, b: Point) -> (f64, f64) {
    let along = (b.0 - a.0, b.1 - a.1);
    let square = along.0 * along.0 + along.1 * along.1;
    let share = ((at.0 - a.0) * along.0 + (at.1 - a.1) * along.1) / square;
    let share = if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
    (share, distance(at, between(a, b, share)))
}
