//! Checks that every place can be reached from every other place, by lanes and lifts.

use crate::map::diagnostic::{Disconnection, MapDiagnostic};
use crate::map::model::Map;
use petgraph::algo::tarjan_scc;
use petgraph::graph::{DiGraph, NodeIndex};
use petgraph::visit::{Dfs, IntoNeighbors, NodeCount, Reversed, Visitable};
use std::cmp::Reverse;

/// Returns an error for each place without a route to or from the largest connected part of the
/// map.
pub(super) fn disconnected_places(map: &Map) -> Vec<MapDiagnostic> {
    let lanes = map.by_ends.keys().map(|(from, to)| (from.0 as u32, to.0 as u32));
    let mut graph = DiGraph::<(), ()>::with_capacity(map.places.len(), map.by_ends.len());
    for _ in &map.places {
        graph.add_node(());
    }
    graph.extend_with_edges(lanes);
    // A robot that enters a lift may leave at any stop: a ring through its stops represents this.
    for lift in &map.lifts {
        let stops: Vec<u32> =
            lift.stops.iter().filter_map(|stop| map.index(stop)).map(|index| index.0 as u32).collect();
        let next = stops.iter().cycle().skip(1);
        graph.extend_with_edges(stops.iter().copied().zip(next.copied()));
    }
    let parts = tarjan_scc(&graph).into_iter();
    // The largest part; of equal parts the part with the first place, so the result is
    // deterministic.
    let largest = parts.max_by_key(|part| (part.len(), Reverse(part.iter().min().copied())));
    let Some(start) = largest.and_then(|part| part.first().copied()) else { return Vec::new() };
    let (out_of_start, into_start) = (reachable_from(&graph, start), reachable_from(Reversed(&graph), start));
    let disconnection = |index: usize| match (out_of_start[index], into_start[index]) {
        (true, true) => None,
        (false, true) => Some(Disconnection::Unreachable),
        (true, false) => Some(Disconnection::DeadEnd),
        (false, false) => Some(Disconnection::Isolated),
    };
    let places = map.places.iter().enumerate();
    places
        .filter_map(|(i, place)| {
            Some(MapDiagnostic::Disconnected { place: place.id.clone(), disconnection: disconnection(i)? })
        })
        .collect()
}

/// Returns, for each place, whether a route leads there from `start`.
fn reachable_from<G>(graph: G, start: NodeIndex) -> Vec<bool>
where
    G: IntoNeighbors<NodeId = NodeIndex> + Visitable<NodeId = NodeIndex> + NodeCount,
{
    let mut found = vec![false; graph.node_count()];
    let mut walk = Dfs::new(graph, start);
    while let Some(node) = walk.next(graph) {
        found[node.index()] = true;
    }
    found
}
