//! Whether every place can be reached from every other, by lane and by lift.

use super::{Disconnection, Map, MapDiagnostic};
use petgraph::algo::tarjan_scc;
use petgraph::graph::{DiGraph, NodeIndex};
use petgraph::visit::{Dfs, IntoNeighbors, NodeCount, Reversed, Visitable};
use std::cmp::Reverse;

/// The places that cannot be reached from, or left for, the largest part of the map that hangs together.
pub(super) fn disconnected_places(map: &Map) -> Vec<MapDiagnostic> {
    let lanes = map.by_ends.keys().map(|(from, to)| (from.0 as u32, to.0 as u32));
    let mut graph = DiGraph::<(), ()>::with_capacity(map.places.len(), map.by_ends.len());
    for _ in &map.places {
        graph.add_node(());
    }
    graph.extend_with_edges(lanes);
    // Who steps into a lift steps out wherever it stops: a ring through its stops says as much.
    for lift in &map.lifts {
        let stops: Vec<u32> =
            lift.stops.iter().filter_map(|stop| map.index(stop)).map(|index| index.0 as u32).collect();
        let next = stops.iter().cycle().skip(1);
        graph.extend_with_edges(stops.iter().copied().zip(next.copied()));
    }
    let parts = tarjan_scc(&graph).into_iter();
    // The largest part, and of equals the one with the first place: the same answer for the same file.
    let largest = parts.max_by_key(|part| (part.len(), Reverse(part.iter().min().copied())));
    let Some(hub) = largest.and_then(|part| part.first().copied()) else { return Vec::new() };
    let (out, into) = (reached(&graph, hub), reached(Reversed(&graph), hub));
    let how = |index: usize| match (out[index], into[index]) {
        (true, true) => None,
        (false, true) => Some(Disconnection::Unreachable),
        (true, false) => Some(Disconnection::DeadEnd),
        (false, false) => Some(Disconnection::Isolated),
    };
    let places = map.places.iter().enumerate();
    places.filter_map(|(i, place)| Some(MapDiagnostic::CutOff { place: place.id.clone(), how: how(i)? })).collect()
}

/// For each place whether a way leads there from `start`.
fn reached<G>(graph: G, start: NodeIndex) -> Vec<bool>
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
