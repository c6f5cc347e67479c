//! A level of a building, and its lanes and walls as entries of a map.

use super::coordinates::{LevelTransform, Point};
use super::diagnostic::{EntryError, RmfDiagnostic};
use super::raw::{self, Edge, EntryReader, Fiducial, Vertex, parameter};
use consort_world::map::{Facing, LaneEntry};
use consort_world::suggest::did_you_mean;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

/// A level with valid entries.
pub(super) struct Level<'a> {
    pub(super) name: &'a str,
    pub(super) elevation: f64,
    pub(super) vertices: Vec<Vertex>,
    pub(super) lanes: Vec<Edge>,
    pub(super) walls: Vec<Edge>,
    pub(super) doors: Vec<Edge>,
    pub(super) measurements: Vec<Edge>,
    pub(super) fiducials: Vec<Fiducial>,
    /// Transform to metres; `None` if the level cannot be aligned with the reference level.
    pub(super) frame: Option<LevelTransform>,
    /// Name of the place at each vertex with a lane of the graph.
    pub(super) places: BTreeMap<usize, String>,
}

pub(super) fn level_of<'a>(name: &'a str, raw: &raw::Level, diagnostics: &mut Vec<RmfDiagnostic>) -> Level<'a> {
    let mut entries = EntryReader { level: name, diagnostics };
    let vertices = entries.vertices(raw.vertices.as_ref());
    let count = vertices.len();
    Level {
        name,
        elevation: raw.elevation,
        lanes: entries.edges("lane", raw.lanes.as_ref(), count),
        walls: entries.edges("wall", raw.walls.as_ref(), count),
        doors: entries.edges("door", raw.doors.as_ref(), count),
        measurements: entries.edges("measurement", raw.measurements.as_ref(), count),
        fiducials: entries.fiducials(raw.fiducials.as_ref()),
        vertices,
        frame: None,
        places: BTreeMap::new(),
    }
}

pub(super) fn level_named(levels: &[Level], field: &'static str, name: &str) -> Result<usize, EntryError> {
    levels.iter().position(|level| level.name == name).ok_or_else(|| {
        let hint = did_you_mean(name, levels.iter().map(|level| level.name));
        EntryError::UnknownLevel { field, level: name.to_owned(), hint }
    })
}

/// Returns the graph of a lane; 0 if the lane gives none.
pub(super) fn graph_of(lane: &Edge) -> Result<i64, EntryError> {
    parameter(&lane.parameters, "graph_idx", "a whole number", Value::as_i64).map(|graph| graph.unwrap_or(0))
}

pub(super) fn ends(lanes: &[Edge]) -> BTreeSet<usize> {
    lanes.iter().flat_map(|lane| lane.ends).collect()
}

pub(super) fn between(level: &Level, lane: &Edge) -> (String, String) {
    (level.places[&lane.ends[0]].clone(), level.places[&lane.ends[1]].clone())
}

pub(super) fn lane_of(level: &Level, lane: &Edge) -> Result<LaneEntry, EntryError> {
    let both = parameter(&lane.parameters, "bidirectional", "[4, true] or [4, false]", Value::as_bool)?;
    let limit = parameter(&lane.parameters, "speed_limit", "a number of metres per second", Value::as_f64)?;
    let facing: fn(&Value) -> Option<Option<Facing>> = |value| match value.as_str()? {
        "" => Some(None),
        "forward" => Some(Some(Facing::Forward)),
        "backward" => Some(Some(Facing::Backward)),
        _ => None,
    };
    let facing = parameter(&lane.parameters, "orientation", "forward or backward", facing)?;
    Ok(LaneEntry {
        between: between(level, lane),
        length_m: None,
        one_way: both != Some(true),
        speed_limit_mps: limit.filter(|limit| *limit > 0.0),
        facing: facing.flatten(),
        graphs: BTreeSet::new(),
    })
}

/// Joins walls to polylines: a wall that begins at the end of the wall before continues it.
pub(super) fn walls(walls: &[Edge], at: impl Fn(usize) -> Point) -> Vec<Vec<Point>> {
    let mut lines: Vec<Vec<Point>> = Vec::new();
    let mut last = None;
    for wall in walls {
        let [from, to] = wall.ends;
        match lines.last_mut().filter(|_| last == Some(from)) {
            Some(line) => line.push(at(to)),
            None => lines.push(vec![at(from), at(to)]),
        }
        last = Some(to);
    }
    lines
}
