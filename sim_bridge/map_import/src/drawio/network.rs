//! Builds places and lanes from drawn paths and places.
//!
//! Points of paths in the same grid cell are merged. A line that passes a point runs through it. A
//! place without a path is connected to the nearest point of a path.

use super::conventions::{GRID, REACH};
use super::shape::Point;
use consort_world::map::intersection;
use std::collections::BTreeMap;

/// A node of the network; coordinates in units, y points down.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct NetworkNode {
    pub(super) at: Point,
    /// Number of the place, for a drawn place.
    pub(super) place: Option<usize>,
}

/// An edge of the network.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct NetworkEdge {
    pub(super) from: usize,
    pub(super) to: usize,
    /// Permissions to drive from `from` to `to`, and back.
    pub(super) directions: (bool, bool),
    pub(super) speed_limit_mps: Option<f64>,
}

/// A point on a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Via {
    /// A place, by its number.
    Place(usize),
    /// A point of the page.
    Point(Point),
}

/// The places and paths of a page.
#[derive(Debug, Default)]
pub(super) struct PathNetwork {
    pub(super) nodes: Vec<NetworkNode>,
    pub(super) edges: Vec<NetworkEdge>,
    by_cell: BTreeMap<(i64, i64), usize>,
}

impl PathNetwork {
    /// Creates a network of places without paths. Place `n` is node `n`.
    pub(super) fn of(places: impl IntoIterator<Item = Point>) -> PathNetwork {
        let mut network = PathNetwork::default();
        for (number, at) in places.into_iter().enumerate() {
            network.by_cell.entry(cell(at)).or_insert(network.nodes.len());
            network.nodes.push(NetworkNode { at, place: Some(number) });
        }
        network
    }

    /// Adds a path. Returns false if it has no length.
    pub(super) fn path(&mut self, through: &[Via], one_way: bool, speed_limit_mps: Option<f64>) -> bool {
        let mut nodes: Vec<usize> = through.iter().map(|via| self.node(*via)).collect();
        nodes.dedup();
        for pair in nodes.windows(2) {
            self.edges.push(NetworkEdge { from: pair[0], to: pair[1], directions: (true, !one_way), speed_limit_mps });
        }
        nodes.len() > 1
    }

    fn node(&mut self, via: Via) -> usize {
        match via {
            Via::Place(number) => number,
            Via::Point(at) => {
                let cell = cell(at);
                *self.by_cell.entry(cell).or_insert_with(|| {
                    let at = ((cell.0 as f64 + 0.5) * GRID, (cell.1 as f64 + 0.5) * GRID);
                    self.nodes.push(NetworkNode { at, place: None });
                    self.nodes.len() - 1
                })
            }
        }
    }

    /// Splits each edge at the nodes that it passes, and merges edges with the same ends.
    pub(super) fn split_edges(&mut self) {
        let mut merged: BTreeMap<(usize, usize), NetworkEdge> = BTreeMap::new();
        for edge in &self.edges {
            let (a, b) = (self.nodes[edge.from].at, self.nodes[edge.to].at);
            let others = self.nodes.iter().enumerate().filter(|(index, _)| *index != edge.from && *index != edge.to);
            let mut passed: Vec<(f64, usize)> = others
                .filter_map(|(index, node)| {
                    let (share, away) = foot(node.at, a, b);
                    (share > 0.0 && share < 1.0 && away <= GRID / 2.0).then_some((share, index))
                })
                .collect();
            passed.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let stops: Vec<usize> =
                [edge.from].into_iter().chain(passed.into_iter().map(|(_, node)| node)).chain([edge.to]).collect();
            for pair in stops.windows(2) {
                add(&mut merged, NetworkEdge { from: pair[0], to: pair[1], ..*edge });
            }
        }
        self.edges = merged.into_values().collect();
    }

    /// Connects each place without a path to the nearest point of a path within reach and without a
    /// wall in between. Returns the places without such a point.
    pub(super) fn connect_isolated(&mut self, walls: &[Vec<Point>]) -> Vec<usize> {
        let mut isolated: Vec<usize> = (0..self.nodes.len()).filter(|node| self.nodes[*node].place.is_some()).collect();
        isolated.retain(|node| self.edges.iter().all(|edge| edge.from != *node && edge.to != *node));
        isolated.retain(|node| !self.connect_isolated_node(*node, walls));
        isolated
    }

    fn connect_isolated_node(&mut self, node: usize, walls: &[Vec<Point>]) -> bool {
        let at = self.nodes[node].at;
        let is_unobstructed = |to: Point| {
            let sides = walls.iter().flat_map(|wall| wall.windows(2));
            !sides.into_iter().any(|side| intersection(at, to, side[0], side[1]).is_some())
        };
        // Candidates are the foot of the perpendicular and both ends: where a wall is in the way to
        // the foot, an end may be free. A foot close to an end is replaced by that end.
        let near = self.edges.iter().enumerate().flat_map(|(index, edge)| {
            let (a, b) = (self.nodes[edge.from].at, self.nodes[edge.to].at);
            let (share, _) = foot(at, a, b);
            let foot = between(a, b, share);
            let close = |end: Point| distance(foot, end) <= GRID / 2.0;
            let share = if close(a) { 0.0 } else { share };
            let share = if close(b) { 1.0 } else { share };
            [share, 0.0, 1.0].map(|share| (between(a, b, share), share, index))
        });
        let near = near.map(|(to, share, edge)| (distance(at, to), to, share, edge));
        let mut near: Vec<_> = near.filter(|(away, ..)| *away <= REACH).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.3.cmp(&b.3)));
        let Some((_, to, share, index)) = near.into_iter().find(|(_, to, ..)| is_unobstructed(*to)) else {
            return false;
        };
        let edge = self.edges[index];
        let end = match share {
            share if share <= 0.0 => edge.from,
            share if share >= 1.0 => edge.to,
            _ => {
                let end = self.nodes.len();
                self.nodes.push(NetworkNode { at: to, place: None });
                self.edges[index].to = end;
                self.edges.push(NetworkEdge { from: end, ..edge });
                end
            }
        };
        self.edges.push(NetworkEdge { from: node, to: end, directions: (true, true), speed_limit_mps: None });
        true
    }
}

/// Adds an edge, or merges it with the existing edge between the same ends. The lower speed limit
/// applies.
fn add(merged: &mut BTreeMap<(usize, usize), NetworkEdge>, edge: NetworkEdge) {
    let NetworkEdge { from, to, directions: (there, back), speed_limit_mps } = edge;
    let (from, to, directions) = if from < to { (from, to, (there, back)) } else { (to, from, (back, there)) };
    let known = merged.entry((from, to)).or_insert(NetworkEdge { from, to, directions, speed_limit_mps });
    known.directions = (known.directions.0 || directions.0, known.directions.1 || directions.1);
    known.speed_limit_mps = match (known.speed_limit_mps, speed_limit_mps) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (a, b) => a.or(b),
    };
}

/// Returns the grid cell of a point.
pub(super) fn cell((x, y): Point) -> (i64, i64) {
    ((x / GRID).floor() as i64, (y / GRID).floor() as i64)
}

fn distance(a: Point, b: Point) -> f64 {
    (a.0 - b.0).hypot(a.1 - b.1)
}

fn between(a: Point, b: Point, share: f64) -> Point {
    (a.0 + share * (b.0 - a.0), a.1 + share * (b.1 - a.1))
}

/// Returns the nearest point of a segment, as a fraction of the way from `a` to `b`, and its
/// distance.
fn foot(at: Point, a: Point, b: Point) -> (f64, f64) {
    let along = (b.0 - a.0, b.1 - a.1);
    let square = along.0 * along.0 + along.1 * along.1;
    let share = ((at.0 - a.0) * along.0 + (at.1 - a.1) * along.1) / square;
    let share = if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
    (share, distance(at, between(a, b, share)))
}
