//! Reader for the map published with MissionControl: `nodes` with label, x, y and yaw (or null),
//! and `edges`.

use super::map::{Edge, MapError, TopologicalMap};
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use serde::Deserialize;

/// A text is not a map in the published form.
#[derive(Debug, thiserror::Error)]
pub enum ReferenceMapError {
    /// Not JSON, or in another form.
    #[error("this is not a map of the published form: {0}")]
    Json(#[from] serde_json::Error),
    /// Two nodes have the same label.
    #[error("there are two nodes {0}")]
    Duplicate(PlaceId),
    /// The map is invalid.
    #[error(transparent)]
    Map(#[from] MapError),
}

#[derive(Deserialize)]
struct ReferenceMap {
    nodes: Vec<ReferenceNode>,
    edges: Vec<ReferenceEdge>,
}

#[derive(Deserialize)]
struct ReferenceNode {
    label: PlaceId,
    x: f64,
    y: f64,
    yaw: Option<f64>,
}

#[derive(Deserialize)]
struct ReferenceEdge {
    a: PlaceId,
    b: PlaceId,
    length_m: f64,
}

impl TopologicalMap {
    /// Reads a map in the published form. A heading of null becomes 0.
    ///
    /// # Errors
    /// [`ReferenceMapError`] if the text is not in that form or the map is invalid.
    pub fn from_reference_json(text: &str) -> Result<TopologicalMap, ReferenceMapError> {
        let read: ReferenceMap = serde_json::from_str(text)?;
        let mut map = TopologicalMap::default();
        for node in read.nodes {
            let pose = Pose::new(node.x, node.y, node.yaw.unwrap_or(0.0));
            if map.places.insert(node.label.clone(), pose).is_some() {
                return Err(ReferenceMapError::Duplicate(node.label));
            }
        }
        let two_way = |edge: ReferenceEdge| Edge { a: edge.a, b: edge.b, length_m: edge.length_m, one_way: false };
        map.edges = read.edges.into_iter().map(two_way).collect();
        map.check()?;
        Ok(map)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_form_is_read() {
        let text = r#"{"units": "m, rad",
            "nodes": [{"label": "A", "x": 1, "y": 2.5, "yaw": null}, {"label": "B", "x": 0, "y": 0, "yaw": 1.5}],
            "edges": [{"a": "A", "b": "B", "length_m": 4.5}]}"#;
        let map = TopologicalMap::from_reference_json(text).unwrap();
        let place = |name| PlaceId::new(name).unwrap();
        assert_eq!(map.places[&place("A")], Pose::new(1.0, 2.5, 0.0));
        assert_eq!(map.places[&place("B")], Pose::new(0.0, 0.0, 1.5));
        assert_eq!(map.edges, [Edge { a: place("A"), b: place("B"), length_m: 4.5, one_way: false }]);
    }

    #[test]
    fn an_edge_to_an_unknown_place_is_rejected() {
        let text = r#"{"nodes": [{"label": "A", "x": 1, "y": 2, "yaw": null}], "edges": [{"a": "A", "b": "B", "length_m": 1}]}"#;
        let error = TopologicalMap::from_reference_json(text).unwrap_err().to_string();
        assert_eq!(error, "the edge A – B names B, which is not among the places");
    }
}
