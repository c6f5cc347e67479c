//! Checks that every place can be reached from every other place, by lanes and lifts. On a map with
//! navigation graphs, this holds for the places of each graph.

use crate::map::diagnostic::{Disconnection, MapDiagnostic};
use crate::map::model::{Map, PlaceIndex};
use petgraph::algo::tarjan_scc;
use petgraph::graph::{DiGraph, NodeIndex};
use petgraph::visit::{Dfs, IntoNeighbors, NodeCount, Reversed, Visitable};
use std::cmp::Reverse;
use std::collections::BTreeSet;

/// Returns an error for each place without a route to or from the largest connected part of the
/// map, or of a navigation graph with the place.
pub(super) fn disconnected_places(map: &Map) -> Vec<MapDiagnostic> {
    let all: BTreeSet<PlaceIndex> = (0..map.places.len()).map(PlaceIndex).collect();
    let graphs = map.graphs();
    if graphs.is_empty() {
        return disconnected_in(map, None, &all);
    }
    let mut in_a_graph = BTreeSet::new();
    let mut diagnostics = Vec::new();
    for graph in graphs {
        let ends = map.by_ends.iter().filter(|(_, lane)| map.lanes[**lane].is_in(Some(graph)));
        let places: BTreeSet<PlaceIndex> = ends.flat_map(|((from, to), _)| [*from, *to]).collect();
        diagnostics.extend(disconnected_in(map, Some(graph), &places));
        in_a_graph.extend(places);
    }
    let isolated = all.difference(&in_a_graph).map(|place| MapDiagnostic::Disconnected {
        place: map.place_at(*place).id.clone(),
        disconnection: Disconnection::Isolated,
        graph: None,
    });
    diagnostics.extend(isolated);
    diagnostics
}

/// Returns an error for each of these places without a route to or from the largest connected part of
/// them, on the lanes of a graph.
fn disconnected_in(map: &Map, graph: Option<&str>, places: &BTreeSet<PlaceIndex>) -> Vec<MapDiagnostic> {
    let lanes = map.by_ends.iter().filter(|(_, lane)| map.lanes[**lane].is_in(graph));
    let lanes = lanes.map(|((from, to), _)| (from.0 as u32, to.0 as u32));
    let mut network = DiGraph::<(), ()>::with_capacity(map.places.len(), map.by_ends.len());
    for _ in &map.places {
        network.add_node(());
    }
    network.extend_with_edges(lanes);
    // A robot that enters a lift may leave at any stop: a ring through its stops represents this.
    for lift in &map.lifts {
        let stops = lift.stops.iter().filter_map(|stop| map.index(stop)).filter(|stop| places.contains(stop));
        let stops: Vec<u32> = stops.map(|index| index.0 as u32).collect();
        let next = stops.iter().cycle().skip(1);
        network.extend_with_edges(stops.iter().copied().zip(next.copied()));
    }
    let belongs = |node: &NodeIndex| places.contains(&PlaceIndex(node.index()));
    let parts = tarjan_scc(&network).into_iter().filter(|part| part.iter().any(belongs));
    // The largest part; of equal parts the part with the first place, so the result is
    // deterministic.
    let largest = parts.max_by_key(|part| (part.len(), Reverse(part.iter().min().copied())));
    let Some(start) = largest.and_then(|part| part.first().copied()) else { return Vec::new() };
    let (out_of_start, into_start) = (reachable_from(&network, start), reachable_from(Reversed(&network), start));
    let disconnection = |index: usize| match (out_of_start[index], into_start[index]) {
        (true, true) => None,
        (false, true) => Some(Disconnection::Unreachable),
        (true, false) => Some(Disconnection::DeadEnd),
        (false, false) => Some(Disconnection::Isolated),
    };
    let error = |place: &PlaceIndex| {
        let disconnection = disconnection(place.0)?;
        let graph = graph.map(str::to_owned);
        Some(MapDiagnostic::Disconnected { place: map.place_at(*place).id.clone(), disconnection, graph })
    };
    places.iter().filter_map(error).collect()
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
