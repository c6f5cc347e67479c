//! A topological map as plain data: places, and edges between them.

use consort_protocol::ids::{NameError, PlaceId};
use consort_protocol::pose::Pose;
use consort_protocol::units::{Metres, UnitError};
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

/// Places and the ways between neighbours.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TopologicalMap {
    /// Where each place is.
    pub places: BTreeMap<PlaceId, Pose>,
    /// Which places are neighbours.
    pub edges: Vec<Edge>,
}

/// A way between two neighbours.
#[derive(Debug, Clone, PartialEq)]
pub struct Edge {
    /// From here.
    pub from: PlaceId,
    /// To there.
    pub to: PlaceId,
    /// How far.
    pub length: Metres,
    /// Whether it may be driven from there to here too.
    pub two_way: bool,
}

/// What is wrong with a map.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MapProblem {
    /// The text is not of the form.
    #[error("line {line}, column {column}: {problem}")]
    Syntax {
        /// From 1.
        line: usize,
        /// From 1.
        column: usize,
        /// What is wrong there.
        problem: String,
    },
    /// A place's name cannot be one.
    #[error(transparent)]
    Name(#[from] NameError),
    /// A place stands twice.
    #[error("place {place:?} stands there twice", place = .place.as_str())]
    Twice {
        /// Which.
        place: PlaceId,
    },
    /// An edge to nowhere.
    #[error("edge {from} – {to}: no place {missing:?}; there are {known}", missing = .missing.as_str())]
    NoPlace {
        /// One end.
        from: PlaceId,
        /// The other end.
        to: PlaceId,
        /// Which of them is not on the map.
        missing: PlaceId,
        /// The places that are, or the first of them.
        known: String,
    },
    /// An edge of no length, which would make every way over it free.
    #[error("edge {from} – {to}: its length must be above 0 m, but is {length}")]
    NoLength {
        /// One end.
        from: PlaceId,
        /// The other end.
        to: PlaceId,
        /// The length given.
        length: f64,
    },
    /// An edge from a place to itself.
    #[error("edge {place} – {place}: leads nowhere")]
    Loop {
        /// Which place.
        place: PlaceId,
    },
    /// A number that is none.
    #[error("{what}: {problem}")]
    Number {
        /// Of what.
        what: String,
        /// What is wrong.
        problem: UnitError,
    },
}

#[derive(Deserialize)]
struct ReferenceMap {
    nodes: Vec<ReferenceNode>,
    edges: Vec<ReferenceEdge>,
}

#[derive(Deserialize)]
struct ReferenceNode {
    label: String,
    x: f64,
    y: f64,
    yaw: Option<f64>,
}

#[derive(Deserialize)]
struct ReferenceEdge {
    a: String,
    b: String,
    length_m: f64,
}

impl TopologicalMap {
    /// Reads the form in which the published evaluation's map is kept: `nodes` with `label`, `x`, `y` (metres) and `yaw`
    /// (radians or null), and two-way `edges` with `a`, `b` and `length_m`.
    ///
    /// # Errors
    /// The first [`MapProblem`].
    pub fn from_reference_json(text: &str) -> Result<TopologicalMap, MapProblem> {
        let read: ReferenceMap = serde_json::from_str(text).map_err(|problem| MapProblem::Syntax {
            line: problem.line(),
            column: problem.column(),
            problem: problem.to_string(),
        })?;
        let mut map = TopologicalMap::default();
        for node in read.nodes {
            let place = PlaceId::new(node.label)?;
            let pose = Pose::new(node.x, node.y, node.yaw.unwrap_or(0.0));
            if map.places.insert(place.clone(), pose).is_some() {
                return Err(MapProblem::Twice { place });
            }
        }
        for edge in read.edges {
            let (from, to) = (PlaceId::new(edge.a)?, PlaceId::new(edge.b)?);
            let length = Metres::new(edge.length_m)
                .map_err(|problem| MapProblem::Number { what: format!("edge {from} – {to}"), problem })?;
            map.edges.push(Edge { from, to, length, two_way: true });
        }
        map.check()?;
        Ok(map)
    }

    /// Checks that every edge joins two places of the map and is longer than nothing.
    ///
    /// # Errors
    /// The first [`MapProblem`].
    pub fn check(&self) -> Result<(), MapProblem> {
        for Edge { from, to, length, .. } in &self.edges {
            for end in [from, to] {
                if !self.places.contains_key(end) {
                    let known: BTreeSet<&str> = self.places.keys().map(PlaceId::as_str).collect();
                    let mut known = known.into_iter().take(40).collect::<Vec<_>>().join(", ");
                    if self.places.len() > 40 {
                        known.push_str(", …");
                    }
                    let (from, to, missing) = (from.clone(), to.clone(), end.clone());
                    return Err(MapProblem::NoPlace { from, to, missing, known });
                }
            }
            if from == to {
                return Err(MapProblem::Loop { place: from.clone() });
            }
            if length.get() <= 0.0 {
                return Err(MapProblem::NoLength { from: from.clone(), to: to.clone(), length: length.get() });
            }
        }
        Ok(())
    }
}
