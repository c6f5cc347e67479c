//! The topological map: places, and the edges between neighbours.

use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Shortest edge: a millimetre. A shorter edge would be lost when added to a long route.
pub(super) const LENGTH_MIN_M: f64 = 0.001;
/// Longest edge: a thousand kilometres.
const LENGTH_MAX_M: f64 = 1.0e6;

/// Places and edges, as in a file. [`check`](TopologicalMap::check) validates them.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TopologicalMap {
    /// Places with their poses.
    pub places: BTreeMap<PlaceId, Pose>,
    /// Edges between neighbours.
    pub edges: Vec<Edge>,
}

/// An edge between two neighbours.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Edge {
    /// First end; the start of a directed edge.
    pub a: PlaceId,
    /// Second end.
    pub b: PlaceId,
    /// Length in metres, which may exceed the straight line.
    pub length_m: f64,
    /// True if robots may drive only from `a` to `b`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub one_way: bool,
}

/// A mistake in a map. Common in hand-written files.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MapError {
    /// An edge ends at an unknown place.
    #[error("the edge {a} – {b} names {place}, which is not among the places")]
    UnknownPlace {
        /// First end.
        a: PlaceId,
        /// Second end.
        b: PlaceId,
        /// The end that is not on the map.
        place: PlaceId,
    },
    /// The length of an edge is out of range.
    #[error("the edge {a} – {b} is {length_m} m long; allowed is {LENGTH_MIN_M} m to {LENGTH_MAX_M} m")]
    Length {
        /// First end.
        a: PlaceId,
        /// Second end.
        b: PlaceId,
        /// Its length in metres.
        length_m: f64,
    },
    /// An edge connects a place to itself.
    #[error("the edge {a} – {a} joins a place to itself")]
    Loop {
        /// The place.
        a: PlaceId,
    },
    /// Two edges have the same start and end.
    #[error("there are two edges from {a} to {b}")]
    Duplicate {
        /// Common start.
        a: PlaceId,
        /// Common end.
        b: PlaceId,
    },
    /// The pose of a place is not finite.
    #[error("{place} has a pose that is not made of finite numbers")]
    Pose {
        /// The place.
        place: PlaceId,
    },
}

impl TopologicalMap {
    /// Validates the map.
    ///
    /// # Errors
    /// [`MapError`] for the first mistake.
    pub fn check(&self) -> Result<(), MapError> {
        for (place, pose) in &self.places {
            if ![pose.x, pose.y, pose.yaw].into_iter().all(f64::is_finite) {
                return Err(MapError::Pose { place: place.clone() });
            }
        }
        let mut seen = BTreeSet::new();
        for edge in &self.edges {
            let (a, b) = (&edge.a, &edge.b);
            if let Some(place) = [a, b].into_iter().find(|place| !self.places.contains_key(*place)) {
                return Err(MapError::UnknownPlace { a: a.clone(), b: b.clone(), place: place.clone() });
            }
            if a == b {
                return Err(MapError::Loop { a: a.clone() });
            }
            if !(LENGTH_MIN_M..=LENGTH_MAX_M).contains(&edge.length_m) {
                return Err(MapError::Length { a: a.clone(), b: b.clone(), length_m: edge.length_m });
            }
            for (from, to) in edge.directions() {
                if !seen.insert((from, to)) {
                    return Err(MapError::Duplicate { a: from.clone(), b: to.clone() });
                }
            }
        }
        Ok(())
    }
}

impl Edge {
    /// Returns the allowed directions.
    pub(super) fn directions(&self) -> impl Iterator<Item = (&PlaceId, &PlaceId)> {
        let back = (!self.one_way).then_some((&self.b, &self.a));
        [(&self.a, &self.b)].into_iter().chain(back)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(name: &str) -> PlaceId {
        PlaceId::new(name).unwrap()
    }

    fn edge(a: &str, b: &str, length_m: f64) -> Edge {
        Edge { a: place(a), b: place(b), length_m, one_way: false }
    }

    fn refusal(edges: Vec<Edge>) -> String {
        let places = ["A", "B"].map(|name| (place(name), Pose::default())).into();
        TopologicalMap { places, edges }.check().unwrap_err().to_string()
    }

    #[test]
    fn each_mistake_names_the_edge() {
        assert_eq!(refusal(vec![edge("A", "C", 1.0)]), "the edge A – C names C, which is not among the places");
        assert_eq!(refusal(vec![edge("A", "B", 0.0)]), "the edge A – B is 0 m long; allowed is 0.001 m to 1000000 m");
        for length in [-1.0, f64::NAN, f64::INFINITY, 2.0e6] {
            assert!(refusal(vec![edge("A", "B", length)]).contains("m long"), "{length}");
        }
        assert_eq!(refusal(vec![edge("A", "A", 1.0)]), "the edge A – A joins a place to itself");
        assert_eq!(refusal(vec![edge("A", "B", 1.0), edge("B", "A", 2.0)]), "there are two edges from B to A");
    }

    #[test]
    fn opposite_directed_edges_are_not_duplicates() {
        let places = ["A", "B"].map(|name| (place(name), Pose::default())).into();
        let edges = [("A", "B"), ("B", "A")].map(|(a, b)| Edge { one_way: true, ..edge(a, b, 1.0) }).into();
        TopologicalMap { places, edges }.check().unwrap();
    }

    #[test]
    fn a_pose_that_is_not_finite_is_rejected() {
        let places = [(place("A"), Pose::new(f64::NAN, 0.0, 0.0))].into();
        let error = TopologicalMap { places, edges: vec![] }.check().unwrap_err();
        assert_eq!(error, MapError::Pose { place: place("A") });
    }
}
