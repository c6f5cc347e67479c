//! Shortest ways on a topological map (Dijkstra 1959).

use super::map::{MapProblem, TopologicalMap};
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_protocol::units::Metres;
use petgraph::algo::dijkstra;
use petgraph::graph::{DiGraph, NodeIndex};
use petgraph::visit::EdgeRef;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Ways between the places of one map.
#[derive(Debug)]
pub struct Routes {
    graph: DiGraph<PlaceId, f64>,
    index: BTreeMap<PlaceId, NodeIndex>,
    poses: BTreeMap<PlaceId, Pose>,
    /// Distances *to* a place from everywhere, worked out when first asked for: estimators ask for few destinations
    /// and many origins.
    to: Mutex<BTreeMap<NodeIndex, Distances>>,
}

/// Metres to one place, by origin; infinite where there is no way.
type Distances = Vec<f64>;

/// A shortest way.
#[derive(Debug, Clone, PartialEq)]
pub struct Route {
    /// The places passed, origin and destination included.
    pub places: Vec<PlaceId>,
    /// How far it is.
    pub length: Metres,
}

/// Why there is no way. Never to be taken for a short one.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NoRoute {
    /// A place that is not on the map.
    #[error("no place {place:?} on the map", place = .0.as_str())]
    Unknown(PlaceId),
    /// Both places are, but nothing joins them.
    #[error("no way from {from} to {to}")]
    Unreachable {
        /// The origin.
        from: PlaceId,
        /// The destination.
        to: PlaceId,
    },
}

impl Routes {
    /// Ways on a map.
    ///
    /// # Errors
    /// The first [`MapProblem`].
    pub fn new(map: &TopologicalMap) -> Result<Routes, MapProblem> {
        map.check()?;
        let mut graph = DiGraph::new();
        let index: BTreeMap<PlaceId, NodeIndex> =
            map.places.keys().map(|place| (place.clone(), graph.add_node(place.clone()))).collect();
        for edge in &map.edges {
            let (from, to) = (index[&edge.from], index[&edge.to]);
            graph.add_edge(from, to, edge.length.get());
            if edge.two_way {
                graph.add_edge(to, from, edge.length.get());
            }
        }
        Ok(Routes { graph, index, poses: map.places.clone(), to: Mutex::default() })
    }

    /// Where a place is.
    pub fn pose(&self, place: &PlaceId) -> Option<Pose> {
        self.poses.get(place).copied()
    }

    /// All places.
    pub fn places(&self) -> impl Iterator<Item = &PlaceId> {
        self.poses.keys()
    }

    /// How far it is; 0 m only from a place to itself.
    ///
    /// # Errors
    /// [`NoRoute`].
    pub fn length(&self, from: &PlaceId, to: &PlaceId) -> Result<Metres, NoRoute> {
        let (origin, destination) = (self.node(from)?, self.node(to)?);
        let metres = self.distances_to(destination, |distances| distances[origin.index()]);
        Metres::new(metres).map_err(|_| NoRoute::Unreachable { from: from.clone(), to: to.clone() })
    }

    /// The shortest way; among equally short ones that which turns first to the neighbour whose name comes first.
    ///
    /// # Errors
    /// [`NoRoute`].
    pub fn route(&self, from: &PlaceId, to: &PlaceId) -> Result<Route, NoRoute> {
        let length = self.length(from, to)?;
        let (mut here, destination) = (self.node(from)?, self.node(to)?);
        let mut places = vec![from.clone()];
        self.distances_to(destination, |distances| {
            while here != destination {
                let next = self.graph.edges(here).min_by(|a, b| {
                    let via = |edge: &petgraph::graph::EdgeReference<'_, f64>| {
                        edge.weight() + distances[edge.target().index()]
                    };
                    via(a).total_cmp(&via(b)).then_with(|| self.graph[a.target()].cmp(&self.graph[b.target()]))
                });
                // A place from which there is a way has a neighbour on it.
                here = next.expect("there is a way").target();
                places.push(self.graph[here].clone());
            }
        });
        Ok(Route { places, length })
    }

    fn node(&self, place: &PlaceId) -> Result<NodeIndex, NoRoute> {
        self.index.get(place).copied().ok_or_else(|| NoRoute::Unknown(place.clone()))
    }

    fn distances_to<T>(&self, destination: NodeIndex, look: impl FnOnce(&Distances) -> T) -> T {
        // A panic while the lock was held has left at worst one destination out.
        let mut known = self.to.lock().unwrap_or_else(PoisonError::into_inner);
        look(known.entry(destination).or_insert_with(|| {
            let reversed = petgraph::visit::Reversed(&self.graph);
            let found = dijkstra(reversed, destination, None, |edge| *edge.weight());
            let mut distances = vec![f64::INFINITY; self.graph.node_count()];
            for (place, metres) in found {
                distances[place.index()] = metres;
            }
            distances
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::super::map::Edge;
    use super::*;
    use proptest::prelude::*;

    fn place(name: &str) -> PlaceId {
        PlaceId::new(name).unwrap()
    }

    fn map(places: &[&str], edges: &[(&str, &str, f64, bool)]) -> TopologicalMap {
        TopologicalMap {
            places: places.iter().map(|name| (place(name), Pose::default())).collect(),
            edges: edges
                .iter()
                .map(|(from, to, metres, two_way)| Edge {
                    from: place(from),
                    to: place(to),
                    length: Metres::new(*metres).unwrap(),
                    two_way: *two_way,
                })
                .collect(),
        }
    }

    #[test]
    fn the_way_of_more_hops_is_taken_when_it_is_shorter() {
        let map = map(&["a", "b", "c"], &[("a", "c", 10.0, true), ("a", "b", 3.0, true), ("b", "c", 4.0, true)]);
        let routes = Routes::new(&map).unwrap();
        let way = Route { places: vec![place("a"), place("b"), place("c")], length: Metres::new(7.0).unwrap() };
        assert_eq!(routes.route(&place("a"), &place("c")), Ok(way));
    }

    #[test]
    fn where_there_is_no_way_there_is_no_length_either() {
        let routes = Routes::new(&map(&["a", "b", "c"], &[("a", "b", 1.0, false)])).unwrap();
        let none = |from: &str, to: &str| Err(NoRoute::Unreachable { from: place(from), to: place(to) });
        assert_eq!(routes.length(&place("a"), &place("c")), none("a", "c"));
        assert_eq!(routes.length(&place("b"), &place("a")), none("b", "a"));
        assert_eq!(routes.length(&place("a"), &place("x")), Err(NoRoute::Unknown(place("x"))));
        assert_eq!(routes.length(&place("a"), &place("a")), Ok(Metres::ZERO));
    }

    #[test]
    fn a_map_that_cannot_be_driven_is_refused() {
        let refused = |map: &TopologicalMap| Routes::new(map).unwrap_err().to_string();
        assert_eq!(refused(&map(&["a", "b"], &[("a", "x", 1.0, true)])), "edge a – x: no place \"x\"; there are a, b");
        assert_eq!(
            refused(&map(&["a", "b"], &[("a", "b", 0.0, true)])),
            "edge a – b: its length must be above 0 m, but is 0"
        );
        assert_eq!(refused(&map(&["a"], &[("a", "a", 1.0, true)])), "edge a – a: leads nowhere");
    }

    proptest! {
        #[test]
        fn no_way_is_shorter(edges in prop::collection::vec((0usize..6, 0usize..6, 1u32..20, any::<bool>()), 0..20)) {
            let names = ["a", "b", "c", "d", "e", "f"];
            let edges: Vec<_> = edges.into_iter().filter(|(a, b, ..)| a != b)
                .map(|(a, b, metres, two_way)| (names[a], names[b], f64::from(metres), two_way)).collect();
            let routes = Routes::new(&map(&names, &edges)).unwrap();
            // Floyd and Warshall, as plain as can be.
            let mut best = [[f64::INFINITY; 6]; 6];
            for (i, row) in best.iter_mut().enumerate() { row[i] = 0.0; }
            let at = |name: &str| names.iter().position(|n| *n == name).unwrap();
            for (a, b, metres, two_way) in &edges {
                best[at(a)][at(b)] = best[at(a)][at(b)].min(*metres);
                if *two_way { best[at(b)][at(a)] = best[at(b)][at(a)].min(*metres); }
            }
            for k in 0..6 { for i in 0..6 { for j in 0..6 {
                best[i][j] = best[i][j].min(best[i][k] + best[k][j]);
            }}}
            for (i, from) in names.iter().enumerate() { for (j, to) in names.iter().enumerate() {
                match routes.route(&place(from), &place(to)) {
                    Ok(route) => {
                        prop_assert_eq!(route.length.get(), best[i][j]);
                        let legs: f64 = route.places.windows(2).map(|leg| best[at(leg[0].as_str())][at(leg[1].as_str())]).sum();
                        prop_assert_eq!(legs, best[i][j]);
                    }
                    Err(_) => prop_assert!(best[i][j].is_infinite()),
                }
            }}
        }
    }
}
