//! Whether what was written is a sound map.

use super::file::{LaneEntry, MapFile, PlaceEntry, limits};
use super::{Lane, Map, Place, PlaceIndex};
use crate::suggest::did_you_mean;
use consort_protocol::ids::{NameError, PlaceId};
use consort_protocol::pose::Pose;
use consort_protocol::units::Metres;
use petgraph::algo::tarjan_scc;
use petgraph::graph::{DiGraph, NodeIndex};
use petgraph::visit::{Dfs, IntoNeighbors, NodeCount, Reversed, Visitable};
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::fmt;

/// One thing that is wrong with a map.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MapProblem {
    /// The map's name is not one.
    #[error("{text:?} cannot name a map: allowed are 1 to 64 characters of A-Z, a-z, 0-9, `_`, `.` and `-`")]
    Name {
        /// The name as given.
        text: String,
    },
    /// More than [`limits`] allow.
    #[error("{count} {what} are more than the {max} allowed")]
    TooMany {
        /// Of what.
        what: &'static str,
        /// How many there are.
        count: usize,
        /// How many there may be.
        max: usize,
    },
    /// A map without places.
    #[error("there are no places")]
    Empty,
    /// The name of a place is not one.
    #[error("{0}")]
    PlaceName(#[from] NameError),
    /// Two places of one name.
    #[error("place {:?} stands more than once", place.as_str())]
    Duplicate {
        /// Its name.
        place: PlaceId,
    },
    /// A number of a place is infinite, not a number, or absurdly large.
    #[error("place {place:?}: {field} is {value}, allowed is a number from -{max} to {max}", max = limits::EXTENT_M)]
    Number {
        /// The place as written.
        place: String,
        /// The field.
        field: &'static str,
        /// The number.
        value: f64,
    },
    /// A corner of a wall is infinite, not a number, or absurdly large.
    #[error("wall {wall}: a corner is at ({x}, {y}), allowed are numbers from -{max} to {max}", max = limits::EXTENT_M)]
    Corner {
        /// Which wall, counted from 1.
        wall: usize,
        /// Metres to the east.
        x: f64,
        /// Metres to the north.
        y: f64,
    },
    /// A lane to a place that is not on the map.
    #[error("lane {lane}: there is no place {place:?}{hint}")]
    UnknownPlace {
        /// The lane.
        lane: LaneName,
        /// The name as written.
        place: String,
        /// The place probably meant, in words; may be empty.
        hint: String,
    },
    /// A lane from a place to itself.
    #[error("lane {lane}: both ends are one place")]
    Loop {
        /// The lane.
        lane: LaneName,
    },
    /// A lane without length, or with one that is no length.
    #[error("lane {lane}: length is {length_m} m, allowed is a number above 0 and up to {max}", max = limits::EXTENT_M)]
    Length {
        /// The lane.
        lane: LaneName,
        /// Its length as written or measured.
        length_m: f64,
    },
    /// A lane shorter than the straight line between its ends.
    #[error("lane {lane}: {length_m} m are less than the straight line of {straight_m:.3} m")]
    TooShort {
        /// The lane.
        lane: LaneName,
        /// Its length as written.
        length_m: f64,
        /// The distance of its ends.
        straight_m: f64,
    },
    /// Two lanes for one way.
    #[error("lane {lane} stands more than once")]
    DuplicateLane {
        /// The lane.
        lane: LaneName,
    },
    /// A place without a way to or from the rest of the map.
    #[error("place {:?} {how} the rest of the map", place.as_str())]
    CutOff {
        /// The place.
        place: PlaceId,
        /// Which way is missing.
        how: Seclusion,
    },
}

/// A lane by its ends as written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LaneName(pub String, pub String);

impl fmt::Display for LaneName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "between {:?} and {:?}", self.0, self.1)
    }
}

/// How a place is cut off from the others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Seclusion {
    /// No way there and none back.
    Apart,
    /// One-way lanes lead away only.
    NoWayIn,
    /// One-way lanes lead there only.
    NoWayOut,
}

impl fmt::Display for Seclusion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Seclusion::Apart => "is cut off from",
            Seclusion::NoWayIn => "cannot be reached from",
            Seclusion::NoWayOut => "cannot be left for",
        })
    }
}

/// A lane may be this much shorter than the straight line: hand-written lengths are rounded to a centimetre.
const ROUNDING_M: f64 = 0.01;

pub(super) fn check(written: &MapFile) -> Result<Map, Vec<MapProblem>> {
    let mut problems = too_many(written);
    if !problems.is_empty() {
        return Err(problems);
    }
    if consort_protocol::ids::EnsembleId::new(written.name.as_str()).is_err() {
        problems.push(MapProblem::Name { text: written.name.clone() });
    }
    corners(&written.walls, &mut problems);
    let mut map = Map {
        name: written.name.clone(),
        places: Vec::new(),
        lanes: Vec::new(),
        walls: written.walls.clone(),
        by_name: BTreeMap::new(),
        by_ends: BTreeMap::new(),
    };
    for entry in &written.places {
        place(entry, &mut map, &mut problems);
    }
    for entry in &written.lanes {
        lane(entry, &mut map, written, &mut problems);
    }
    if problems.is_empty() {
        problems = cut_off(&map);
    }
    if problems.is_empty() { Ok(map) } else { Err(problems) }
}

fn too_many(written: &MapFile) -> Vec<MapProblem> {
    if written.places.is_empty() {
        return vec![MapProblem::Empty];
    }
    [
        ("places", written.places.len(), limits::PLACES),
        ("lanes", written.lanes.len(), limits::LANES),
        ("wall corners", written.walls.iter().map(Vec::len).sum(), limits::WALL_CORNERS),
    ]
    .into_iter()
    .filter(|(_, count, max)| count > max)
    .map(|(what, count, max)| MapProblem::TooMany { what, count, max })
    .collect()
}

/// Whether it is a number on a floor; false for what is not a number at all.
fn sane(value: f64) -> bool {
    value.abs() <= limits::EXTENT_M
}

fn corners(walls: &[Vec<(f64, f64)>], problems: &mut Vec<MapProblem>) {
    for (index, wall) in walls.iter().enumerate() {
        if let Some(&(x, y)) = wall.iter().find(|(x, y)| !sane(*x) || !sane(*y)) {
            problems.push(MapProblem::Corner { wall: index + 1, x, y });
        }
    }
}

fn place(entry: &PlaceEntry, map: &mut Map, problems: &mut Vec<MapProblem>) {
    for (field, value) in [("x_m", entry.x_m), ("y_m", entry.y_m), ("yaw_rad", entry.yaw_rad)] {
        if !sane(value) {
            problems.push(MapProblem::Number { place: entry.name.clone(), field, value });
        }
    }
    match PlaceId::new(entry.name.as_str()) {
        Err(error) => problems.push(error.into()),
        Ok(id) if map.by_name.contains_key(&id) => problems.push(MapProblem::Duplicate { place: id }),
        Ok(id) => {
            map.by_name.insert(id.clone(), PlaceIndex(map.places.len()));
            let pose = Pose::new(entry.x_m, entry.y_m, entry.yaw_rad);
            map.places.push(Place { id, kind: entry.kind, pose });
        }
    }
}

fn lane(entry: &LaneEntry, map: &mut Map, written: &MapFile, problems: &mut Vec<MapProblem>) {
    let name = || LaneName(entry.between.0.clone(), entry.between.1.clone());
    let mut end = |text: &String| {
        let found = PlaceId::new(text.as_str()).ok().and_then(|id| map.index(&id));
        if found.is_none() {
            let hint = did_you_mean(text, written.places.iter().map(|place| place.name.as_str()));
            problems.push(MapProblem::UnknownPlace { lane: name(), place: text.clone(), hint });
        }
        found
    };
    let (Some(from), Some(to)) = (end(&entry.between.0), end(&entry.between.1)) else { return };
    if from == to {
        problems.push(MapProblem::Loop { lane: name() });
        return;
    }
    let (a, b) = (map.at(from).pose, map.at(to).pose);
    if ![a.x, a.y, b.x, b.y].into_iter().all(sane) {
        return; // said of the place already
    }
    let straight_m = a.distance(b).get();
    let length_m = entry.length_m.unwrap_or(straight_m);
    let Some(length) = Metres::new(length_m).ok().filter(|_| length_m > 0.0 && sane(length_m)) else {
        problems.push(MapProblem::Length { lane: name(), length_m });
        return;
    };
    if length_m < straight_m - ROUNDING_M {
        problems.push(MapProblem::TooShort { lane: name(), length_m, straight_m });
        return;
    }
    let two_way = !entry.one_way;
    let taken = map.by_ends.contains_key(&(from, to)) || (two_way && map.by_ends.contains_key(&(to, from)));
    if taken {
        problems.push(MapProblem::DuplicateLane { lane: name() });
        return;
    }
    let index = map.lanes.len();
    map.by_ends.insert((from, to), index);
    if two_way {
        map.by_ends.insert((to, from), index);
    }
    map.lanes.push(Lane { from: map.at(from).id.clone(), to: map.at(to).id.clone(), length, two_way });
}

/// The places that cannot be reached from, or left for, the largest part of the map that hangs together.
fn cut_off(map: &Map) -> Vec<MapProblem> {
    let edges = map.by_ends.keys().map(|(from, to)| (from.0 as u32, to.0 as u32));
    let mut graph = DiGraph::<(), ()>::with_capacity(map.places.len(), map.by_ends.len());
    for _ in &map.places {
        graph.add_node(());
    }
    graph.extend_with_edges(edges);
    let parts = tarjan_scc(&graph).into_iter();
    // The largest part, and of equals the one with the first place: the same answer for the same file.
    let largest = parts.max_by_key(|part| (part.len(), Reverse(part.iter().min().copied())));
    let Some(hub) = largest.and_then(|part| part.first().copied()) else { return Vec::new() };
    let (out, into) = (reached(&graph, hub), reached(Reversed(&graph), hub));
    let how = |index: usize| match (out[index], into[index]) {
        (true, true) => None,
        (false, true) => Some(Seclusion::NoWayIn),
        (true, false) => Some(Seclusion::NoWayOut),
        (false, false) => Some(Seclusion::Apart),
    };
    let places = map.places.iter().enumerate();
    places.filter_map(|(i, place)| Some(MapProblem::CutOff { place: place.id.clone(), how: how(i)? })).collect()
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
