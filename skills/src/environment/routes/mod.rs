//! Shortest routes on a topological map (Dijkstra 1959), or the fastest under speed limits of people.
//!
//! Distances are stored by destination. The first query for a destination runs a search over the
//! map; every later query, from any start, is a look-up. If a thousand robots price a drive to the
//! same room, this costs a single search.

use super::descriptor::EnvironmentDescriptor;
use super::map::{Edge, LENGTH_MIN_M, MapError, TopologicalMap};
use super::passages::Passages;
use super::speed_limits::SpeedLimits;
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_protocol::units::{Metres, MetresPerSecond, Seconds};
use petgraph::Direction;
use petgraph::algo::dijkstra;
use petgraph::graph::{DiGraph, EdgeIndex, EdgeReference, NodeIndex};
use petgraph::visit::{EdgeRef, Reversed};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::OnceLock;

/// Greatest distance of a robot from the straight line of a leg to count as on the leg: Nav2's
/// default goal tolerance.
pub(crate) const TOLERANCE_M: f64 = 0.25;

/// Routes between the places of a map.
#[derive(Debug, Clone)]
pub struct Routes {
    graph: DiGraph<(PlaceId, Pose), f64>,
    index: BTreeMap<PlaceId, NodeIndex>,
    /// Costs from every node in metres, by destination; infinite without a route.
    costs: Vec<OnceLock<Vec<f64>>>,
    /// True if closed edges of the map are left out.
    reduced: bool,
    /// Places that are closed as a whole.
    closed_places: BTreeSet<NodeIndex>,
    /// Number of metres for which a metre of an edge counts, for edges on which the robot is slowed.
    slowed: BTreeMap<EdgeIndex, f64>,
}

/// A shortest route.
#[derive(Debug, Clone, PartialEq)]
pub struct Route {
    /// Places from the first to the last, both included.
    pub places: Vec<PlaceId>,
    /// Length.
    pub length: Metres,
}

/// There is no route. This must never be treated as a distance of 0 m.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RouteError {
    /// A place is not on the map.
    #[error("no route from {from} to {to}: {place} is not on the map")]
    UnknownPlace {
        /// Start.
        from: PlaceId,
        /// Destination.
        to: PlaceId,
        /// The place that is not on the map.
        place: PlaceId,
    },
    /// Both places are on the map, but every connection between them is known to be closed.
    #[error("no route from {from} to {to}: the ways between them are closed")]
    Closed {
        /// Start.
        from: PlaceId,
        /// Destination.
        to: PlaceId,
    },
    /// Both places are on the map, without a connection.
    #[error("no route from {from} to {to}: the map has no way between them")]
    Unreachable {
        /// Start.
        from: PlaceId,
        /// Destination.
        to: PlaceId,
    },
}

impl EnvironmentDescriptor for Routes {
    const KIND: &'static str = "routes";
}

impl Routes {
    /// Prepares a map for queries.
    ///
    /// # Errors
    /// [`MapError`] if the map is invalid.
    pub fn new(map: &TopologicalMap) -> Result<Routes, MapError> {
        map.check()?;
        let mut graph = DiGraph::new();
        let node = |(place, pose): (&PlaceId, &Pose)| (place.clone(), graph.add_node((place.clone(), *pose)));
        let index: BTreeMap<PlaceId, NodeIndex> = map.places.iter().map(node).collect();
        for edge in &map.edges {
            for (from, to) in edge.directions() {
                graph.add_edge(index[from], index[to], edge.length_m);
            }
        }
        let costs = vec![OnceLock::new(); index.len()];
        let (closed_places, slowed) = (BTreeSet::new(), BTreeMap::new());
        Ok(Routes { graph, index, costs, reduced: false, closed_places, slowed })
    }

    /// Returns routes for lower bounds of travel times: without passages, no drive on them takes longer than on the map with these
    /// passages, whichever lanes are closed. A lift is a leg of almost no length.
    ///
    /// # Errors
    /// [`MapError`] if the map is invalid.
    pub fn shortest(map: &TopologicalMap, passages: &Passages) -> Result<Routes, MapError> {
        let edge = |edge: &Edge| {
            let is_lift = passages.is_lift(&edge.a, &edge.b) || passages.is_lift(&edge.b, &edge.a);
            Edge { length_m: if is_lift { LENGTH_MIN_M } else { edge.length_m }, ..edge.clone() }
        };
        Routes::new(&TopologicalMap { places: map.places.clone(), edges: map.edges.iter().map(edge).collect() })
    }

    /// Returns the routes without the edges between these places, in either direction. A pair of a
    /// place and itself closes the place: no route enters it, and routes from it lead out. Pairs that
    /// are not on the map are ignored.
    pub fn without_closed(&self, closed: &[(PlaceId, PlaceId)]) -> Cow<'_, Routes> {
        let ends = closed.iter().filter_map(|(a, b)| Some((*self.index.get(a)?, *self.index.get(b)?)));
        let (places, lanes): (Vec<_>, Vec<_>) = ends.partition(|(a, b)| a == b);
        let closed_places: BTreeSet<NodeIndex> = places.into_iter().map(|(place, _)| place).collect();
        let edges = lanes.into_iter().flat_map(|(a, b)| [self.graph.find_edge(a, b), self.graph.find_edge(b, a)]);
        let mut edges: BTreeSet<_> = edges.flatten().collect();
        // The way out of neighbouring closed places leads through them.
        let enters = |edge: &EdgeReference<'_, f64>| {
            closed_places.contains(&edge.target()) && !closed_places.contains(&edge.source())
        };
        edges.extend(self.graph.edge_references().filter(enters).map(|edge| edge.id()));
        if edges.is_empty() && closed_places.is_empty() {
            return Cow::Borrowed(self);
        }
        let graph =
            self.graph.filter_map(|_, place| Some(place.clone()), |edge, m| (!edges.contains(&edge)).then_some(*m));
        let costs = vec![OnceLock::new(); self.index.len()];
        // Edges are numbered anew.
        let slowed = BTreeMap::new();
        Cow::Owned(Routes { graph, index: self.index.clone(), costs, reduced: true, closed_places, slowed })
    }

    /// Returns the routes of a robot of this speed: they are the fastest under the limits. A metre on which people slow
    /// the robot to half of its speed counts as two metres. Limits above those of the map, in `passages`, count as none.
    /// Lift rides from and to a limited place count as its lanes do.
    pub fn limited(
        &self,
        limits: &SpeedLimits,
        speed: MetresPerSecond,
        passages: Option<&Passages>,
    ) -> Cow<'_, Routes> {
        let edges = limits.lanes().flat_map(|(a, b)| self.edges_of(a, b));
        let slowed = edges.filter_map(|edge| {
            let (from, to) = self.graph.edge_endpoints(edge)?;
            let [from, to] = [from, to].map(|end| &self.graph[end].0);
            let own = passages.map_or(speed, |passages| passages.speed(from, to, speed));
            let slow = limits.slowed(from, to, own);
            (slow != own).then(|| (edge, own.get() / slow.get()))
        });
        let slowed: BTreeMap<EdgeIndex, f64> = slowed.collect();
        if slowed.is_empty() {
            return Cow::Borrowed(self);
        }
        Cow::Owned(Routes {
            graph: self.graph.clone(),
            index: self.index.clone(),
            costs: vec![OnceLock::new(); self.index.len()],
            reduced: self.reduced,
            closed_places: self.closed_places.clone(),
            slowed,
        })
    }

    /// Returns the edges between two places in both directions, or all from and to a place that is given twice. None for
    /// a place that is not on the map.
    fn edges_of(&self, a: &PlaceId, b: &PlaceId) -> Vec<EdgeIndex> {
        let (Some(a), Some(b)) = (self.index.get(a).copied(), self.index.get(b).copied()) else { return vec![] };
        if a == b {
            let edges = |direction| self.graph.edges_directed(a, direction).map(|edge| edge.id());
            return edges(Direction::Outgoing).chain(edges(Direction::Incoming)).collect();
        }
        [self.graph.find_edge(a, b), self.graph.find_edge(b, a)].into_iter().flatten().collect()
    }

    /// Checks whether a robot that has passed `from` enters a closed lane or place on its way to the
    /// neighbour `to`.
    pub(crate) fn enters_closed(closed: &[(PlaceId, PlaceId)], from: &PlaceId, to: &PlaceId) -> bool {
        let is_closed = |place: &PlaceId| closed.iter().any(|(a, b)| a == b && a == place);
        let is_lane = |(a, b): &(PlaceId, PlaceId)| (a == from && b == to) || (a == to && b == from);
        from != to && (closed.iter().any(is_lane) || is_closed(to) && !is_closed(from))
    }

    /// Returns the length of the route; 0 m from a place to itself.
    ///
    /// # Errors
    /// [`RouteError`] with both ends.
    pub fn distance(&self, from: &PlaceId, to: &PlaceId) -> Result<Metres, RouteError> {
        if self.slowed.is_empty() { self.cost(from, to) } else { Ok(self.route(from, to)?.length) }
    }

    /// Returns the cost of the route: its length, unless the robot is slowed.
    fn cost(&self, from: &PlaceId, to: &PlaceId) -> Result<Metres, RouteError> {
        let (start, end) = (self.node(from, from, to)?, self.node(to, from, to)?);
        if start != end && self.closed_places.contains(&end) {
            return Err(RouteError::Closed { from: from.clone(), to: to.clone() });
        }
        Metres::new(self.to(end)[start.index()]).map_err(|_| {
            let (from, to) = (from.clone(), to.clone());
            if self.reduced { RouteError::Closed { from, to } } else { RouteError::Unreachable { from, to } }
        })
    }

    fn edge_cost(&self, edge: EdgeIndex) -> f64 {
        self.graph[edge] * self.slowed.get(&edge).copied().unwrap_or(1.0)
    }

    /// Returns the shortest route, or the fastest if the robot is slowed. Of several equal routes, the first in the
    /// order of the places' names.
    ///
    /// # Errors
    /// [`RouteError`] with both ends.
    pub fn route(&self, from: &PlaceId, to: &PlaceId) -> Result<Route, RouteError> {
        let mut length = self.cost(from, to)?;
        let (mut at, end) = (self.index[from], self.index[to]);
        let costs = self.to(end);
        let mut places = vec![from.clone()];
        while at != end {
            // The search added the same two numbers, so the sum is equal to the last bit for at
            // least one neighbour. Edges have a positive length, so every step comes nearer.
            let closer = |next: &NodeIndex| {
                let edge = self.graph.find_edge(at, *next).expect("a neighbour has an edge");
                costs[next.index()] + self.edge_cost(edge) == costs[at.index()]
            };
            // Nodes were numbered in the order of the places' names.
            at = self.graph.neighbors(at).filter(closer).min().expect("a finite distance has a next step");
            places.push(self.graph[at].0.clone());
        }
        if !self.slowed.is_empty() {
            length =
                places.windows(2).map(|leg| self.leg_length(&leg[0], &leg[1])).fold(Metres::ZERO, |sum, leg| sum + leg);
        }
        Ok(Route { places, length })
    }

    /// Returns the places to drive to, in order, for a robot at `pose` that last passed `passed`.
    /// On a leg the robot continues or turns back, whichever costs less and is allowed. Anywhere else
    /// it first returns to `passed`. Empty at `to`.
    ///
    /// # Errors
    /// [`RouteError`] with both ends.
    pub fn legs(&self, passed: &PlaceId, pose: Pose, to: &PlaceId) -> Result<Vec<PlaceId>, RouteError> {
        let route = self.route(passed, to);
        let start = self.node(passed, passed, to)?;
        let from_passed = self.graph[start].1.distance(pose).get();
        if from_passed <= TOLERANCE_M {
            return Ok(route?.places.split_off(1));
        }
        let Some((ahead, left)) = self.leg_at(start, pose) else { return Ok(route?.places) };
        let onward = self.route(&self.graph[ahead].0, to);
        let back = self.graph.find_edge(ahead, start).and(route.as_ref().ok());
        let lane = self.graph.find_edge(start, ahead).and_then(|lane| self.slowed.get(&lane).copied()).unwrap_or(1.0);
        let cost = |from: NodeIndex| self.index.get(to).map_or(f64::INFINITY, |end| self.to(*end)[from.index()]);
        match (onward, back) {
            (Ok(_), Some(back)) if cost(start) + from_passed * lane < cost(ahead) + left * lane => {
                Ok(back.places.clone())
            }
            (Ok(onward), _) => Ok(onward.places),
            (Err(_), Some(back)) => Ok(back.places.clone()),
            (Err(error), None) => Err(error),
        }
    }

    /// Returns the distance along these [`legs`](Routes::legs).
    ///
    /// # Errors
    /// [`RouteError`] with both ends.
    pub fn distance_left(&self, passed: &PlaceId, pose: Pose, to: &PlaceId) -> Result<Metres, RouteError> {
        let legs = self.legs(passed, pose, to)?;
        let Some((first, start)) = legs.first().and_then(|first| Some((first, self.pose(first)?))) else {
            return Ok(Metres::ZERO);
        };
        Ok(pose.distance(start) + self.distance(first, to)?)
    }

    /// Returns the travel time along these [`legs`](Routes::legs), at this speed or the limits,
    /// with the delays in `passages`. Delays on the way to the first of the legs count only for a
    /// robot that stands at `passed`.
    ///
    /// # Errors
    /// [`RouteError`] with both ends.
    pub fn time_left(
        &self,
        passed: &PlaceId,
        pose: Pose,
        to: &PlaceId,
        speed: MetresPerSecond,
        passages: &Passages,
    ) -> Result<Seconds, RouteError> {
        let mut legs = self.legs(passed, pose, to)?;
        let stands_there = self.pose(passed).is_some_and(|place| place.distance(pose).get() <= TOLERANCE_M);
        let mut time = Seconds::ZERO;
        if stands_there {
            legs.insert(0, passed.clone());
        } else if let Some(first) = legs.first().and_then(|first| self.pose(first)) {
            time += pose.distance(first).at(passages.limits().slowed(passed, &legs[0], speed));
        }
        for leg in legs.windows(2) {
            time += passages.time(&leg[0], &leg[1], self.leg_length(&leg[0], &leg[1]), speed);
        }
        Ok(time)
    }

    /// Returns the length of the edge between two neighbours on a route.
    fn leg_length(&self, from: &PlaceId, to: &PlaceId) -> Metres {
        let edge = self.graph.find_edge(self.index[from], self.index[to]).expect("neighbours on a route have an edge");
        Metres::new(self.graph[edge]).expect("edges of a checked map have a length")
    }

    /// Returns the places that a robot at `pose` that last passed `passed` may pass next: none if it stands there, and
    /// otherwise its neighbours.
    pub fn places_ahead(&self, passed: &PlaceId, pose: Pose) -> Vec<&PlaceId> {
        let Some(start) = self.index.get(passed) else { return vec![] };
        if self.graph[*start].1.distance(pose).get() <= TOLERANCE_M {
            return vec![];
        }
        self.graph.neighbors(*start).map(|place| &self.graph[place].0).collect()
    }

    /// Returns those of the [next places](Routes::places_ahead) to which the robot may be on its way: it is at most
    /// `within_m` metres away from the straight line to them.
    pub fn ways_at(&self, passed: &PlaceId, pose: Pose, within_m: f64) -> Vec<&PlaceId> {
        let Some(begin) = self.pose(passed) else { return vec![] };
        let is_near = |end: Pose| distance_to_segment(pose, begin, end) <= within_m;
        let ahead = self.places_ahead(passed, pose).into_iter();
        ahead.filter(|next| self.pose(next).is_some_and(is_near)).collect()
    }

    /// Returns the pose of a place.
    pub fn pose(&self, place: &PlaceId) -> Option<Pose> {
        self.index.get(place).map(|node| self.graph[*node].1)
    }

    /// All places, in the order of their names.
    pub fn places(&self) -> impl Iterator<Item = &PlaceId> {
        self.index.keys()
    }

    /// Returns the leg from `start` with `pose` on its straight line: its other end, and the
    /// distance left in metres.
    fn leg_at(&self, start: NodeIndex, pose: Pose) -> Option<(NodeIndex, f64)> {
        let begin = self.graph[start].1;
        let mut best: Option<(f64, NodeIndex, f64)> = None;
        let mut ends: Vec<NodeIndex> = self.graph.neighbors(start).collect();
        ends.sort();
        for end in ends {
            let off = distance_to_segment(pose, begin, self.graph[end].1);
            if off <= TOLERANCE_M && best.is_none_or(|(least, ..)| off < least) {
                best = Some((off, end, pose.distance(self.graph[end].1).get()));
            }
        }
        best.map(|(_, end, left)| (end, left))
    }

    fn node(&self, place: &PlaceId, from: &PlaceId, to: &PlaceId) -> Result<NodeIndex, RouteError> {
        let unknown = || RouteError::UnknownPlace { from: from.clone(), to: to.clone(), place: place.clone() };
        self.index.get(place).copied().ok_or_else(unknown)
    }

    /// Returns the costs from every node to `end`, in metres.
    fn to(&self, end: NodeIndex) -> &[f64] {
        self.costs[end.index()].get_or_init(|| {
            let mut metres = vec![f64::INFINITY; self.graph.node_count()];
            for (node, cost) in dijkstra(Reversed(&self.graph), end, None, |edge| self.edge_cost(edge.id())) {
                metres[node.index()] = cost;
            }
            metres
        })
    }
}

fn distance_to_segment(pose: Pose, begin: Pose, end: Pose) -> f64 {
    let (dx, dy) = (end.x - begin.x, end.y - begin.y);
    let square = dx * dx + dy * dy;
    let along = if square > 0.0 { ((pose.x - begin.x) * dx + (pose.y - begin.y) * dy) / square } else { 0.0 };
    let along = along.clamp(0.0, 1.0);
    pose.distance(Pose::new(begin.x + along * dx, begin.y + along * dy, 0.0)).get()
}

#[cfg(test)]
mod tests;
