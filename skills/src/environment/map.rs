//! The topological map: places, and the ways between neighbours.

use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Shortest edge: a millimetre. Anything shorter is lost when added to a long route.
const LENGTH_MIN_M: f64 = 0.001;
/// Longest edge: a thousand kilometres.
const LENGTH_MAX_M: f64 = 1.0e6;

/// Places and the ways between them, as in a file; [`check`](TopologicalMap::check) says whether it makes sense.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TopologicalMap {
    /// Where each place is.
    pub places: BTreeMap<PlaceId, Pose>,
    /// The ways between neighbours.
    pub edges: Vec<Edge>,
}

/// A way between two neighbours.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Edge {
    /// One end; the beginning of a one-way edge.
    pub a: PlaceId,
    /// The other end.
    pub b: PlaceId,
    /// Metres to drive, which may be more than the straight line.
    pub length_m: f64,
    /// Whether it may be driven from `a` to `b` only.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub one_way: bool,
}

/// What is wrong with a map. Ordinary in hand-written files.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MapError {
    /// An edge ends nowhere.
    #[error("the edge {a} – {b} names {place}, which is not among the places")]
    UnknownPlace {
        /// One end.
        a: PlaceId,
        /// The other end.
        b: PlaceId,
        /// The end that is not on the map.
        place: PlaceId,
    },
    /// An edge is of no sensible length.
    #[error("the edge {a} – {b} is {length_m} m long; allowed is {LENGTH_MIN_M} m to {LENGTH_MAX_M} m")]
    Length {
        /// One end.
        a: PlaceId,
        /// The other end.
        b: PlaceId,
        /// Its length in metres.
        length_m: f64,
    },
    /// An edge ends where it begins.
    #[error("the edge {a} – {a} joins a place to itself")]
    Loop {
        /// The place.
        a: PlaceId,
    },
    /// Two edges lead the same way.
    #[error("there are two edges from {a} to {b}")]
    Duplicate {
        /// Where both begin.
        a: PlaceId,
        /// Where both end.
        b: PlaceId,
    },
    /// A place is nowhere.
    #[error("{place} has a pose that is not made of finite numbers")]
    Pose {
        /// The place.
        place: PlaceId,
    },
}

impl TopologicalMap {
    /// Whether the map makes sense.
    ///
    /// # Errors
    /// [`MapError`] names the first mistake.
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
    /// The ways it may be driven.
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
    fn two_opposite_one_way_edges_are_no_duplicate() {
        let places = ["A", "B"].map(|name| (place(name), Pose::default())).into();
        let edges = [("A", "B"), ("B", "A")].map(|(a, b)| Edge { one_way: true, ..edge(a, b, 1.0) }).into();
        TopologicalMap { places, edges }.check().unwrap();
    }

    #[test]
    fn a_pose_that_is_nowhere_is_refused() {
        let places = [(place("A"), Pose::new(f64::NAN, 0.0, 0.0))].into();
        let error = TopologicalMap { places, edges: vec![] }.check().unwrap_err();
        assert_eq!(error, MapError::Pose { place: place("A") });
    }
}
