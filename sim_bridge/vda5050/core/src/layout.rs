//! The nodes and edges that a vehicle knows, and routes on them.

use std::collections::{BTreeMap, BTreeSet};

/// A node of a layout.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LayoutNode {
    /// East of the map's origin, in metres.
    pub x_m: f64,
    /// North of the map's origin, in metres.
    pub y_m: f64,
    /// Heading that the vehicle takes on the node, in radians.
    pub yaw_rad: Option<f64>,
}

impl LayoutNode {
    fn distance_m(&self, (x_m, y_m): (f64, f64)) -> f64 {
        (self.x_m - x_m).hypot(self.y_m - y_m)
    }
}

/// Nodes by id, and edges in both directions. Without edges the vehicle drives between any two nodes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Layout {
    nodes: BTreeMap<String, LayoutNode>,
    neighbours: BTreeMap<String, BTreeSet<String>>,
}

/// An edge names a node that does not exist.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("edges[{edge}]: no node {node:?}; allowed are the nodes of `places` and of `nodes`")]
pub struct LayoutError {
    /// Index of the edge.
    pub edge: usize,
    /// The node.
    pub node: String,
}

impl Layout {
    /// Creates a layout.
    ///
    /// # Errors
    /// An edge names a node that does not exist.
    pub fn new(nodes: BTreeMap<String, LayoutNode>, edges: &[[String; 2]]) -> Result<Layout, LayoutError> {
        let mut neighbours: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        for (edge, [a, b]) in edges.iter().enumerate() {
            for (from, to) in [(a, b), (b, a)] {
                if !nodes.contains_key(from) {
                    return Err(LayoutError { edge, node: from.clone() });
                }
                neighbours.entry(from.clone()).or_default().insert(to.clone());
            }
        }
        Ok(Layout { nodes, neighbours })
    }

    /// Returns a node.
    pub fn node(&self, id: &str) -> Option<&LayoutNode> {
        self.nodes.get(id)
    }

    /// Returns the nearest node to a position, and its distance in metres.
    pub fn nearest(&self, at_m: (f64, f64)) -> Option<(&str, f64)> {
        let distances = self.nodes.iter().map(|(id, node)| (id.as_str(), node.distance_m(at_m)));
        distances.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Returns the shortest route between two nodes, both included.
    pub fn route(&self, from: &str, to: &str) -> Option<Vec<String>> {
        if from == to {
            return Some(vec![to.to_owned()]);
        }
        if self.neighbours.is_empty() {
            return Some(vec![from.to_owned(), to.to_owned()]);
        }
        // Dijkstra on a few hundred nodes.
        let mut open: BTreeMap<String, (f64, String)> = BTreeMap::from([(from.to_owned(), (0.0, from.to_owned()))]);
        let mut closed: BTreeMap<String, String> = BTreeMap::new();
        while let Some(id) = open.iter().min_by(|a, b| a.1.0.total_cmp(&b.1.0)).map(|(id, _)| id.clone()) {
            let Some((length_m, before)) = open.remove(&id) else { break };
            closed.insert(id.clone(), before);
            if id == to {
                let mut route = vec![id];
                while let Some(last) = route.last().filter(|last| *last != from) {
                    let before = closed[last].clone();
                    route.push(before);
                }
                route.reverse();
                return Some(route);
            }
            let at = self.nodes[&id];
            for next in self.neighbours.get(&id).into_iter().flatten().filter(|next| !closed.contains_key(*next)) {
                let total_m = length_m + self.nodes[next].distance_m((at.x_m, at.y_m));
                if open.get(next).is_none_or(|(known_m, _)| total_m < *known_m) {
                    open.insert(next.clone(), (total_m, id.clone()));
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_route_is_the_shortest_over_the_edges() {
        let node = |x_m: f64, y_m: f64| LayoutNode { x_m, y_m, yaw_rad: None };
        let nodes = [("a", node(0.0, 0.0)), ("b", node(5.0, 0.0)), ("c", node(0.0, 9.0)), ("d", node(5.0, 9.0))];
        let nodes = BTreeMap::from(nodes.map(|(id, node)| (id.to_owned(), node)));
        let edges = [["a", "b"], ["a", "c"], ["b", "d"], ["c", "d"]].map(|edge| edge.map(str::to_owned));
        let layout = Layout::new(nodes.clone(), &edges[..3]).unwrap();
        assert_eq!(layout.route("c", "d").unwrap(), ["c", "a", "b", "d"]);
        assert_eq!(Layout::new(nodes.clone(), &edges).unwrap().route("c", "d").unwrap(), ["c", "d"]);
        assert_eq!(Layout::new(nodes.clone(), &edges[..1]).unwrap().route("c", "d"), None);
        assert_eq!(Layout::new(nodes.clone(), &[]).unwrap().route("c", "d").unwrap(), ["c", "d"]);
        assert_eq!(layout.nearest((4.0, 1.0)).unwrap().0, "b");
        let wrong = Layout::new(nodes, &[["a".to_owned(), "x".to_owned()]]).unwrap_err();
        assert_eq!(wrong, LayoutError { edge: 0, node: "x".to_owned() });
    }
}
