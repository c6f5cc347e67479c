//! Checks a map file and builds the map.

mod building;
mod connectivity;

use super::diagnostic::{BuildingDiagnostic, LaneName, MapDiagnostic};
use super::file::{LaneEntry, MapFile, PlaceEntry, limits};
use super::model::{Lane, Map, MapPlace, PlaceIndex};
use crate::suggest::did_you_mean;
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_protocol::units::{Metres, MetresPerSecond};
use std::collections::BTreeMap;

/// Tolerance for lanes shorter than the straight line: lengths in hand-written files are rounded to
/// a centimetre.
const ROUNDING_M: f64 = 0.01;

pub(super) fn check(file: &MapFile) -> Result<Map, Vec<MapDiagnostic>> {
    let mut diagnostics = too_many(file);
    if !diagnostics.is_empty() {
        return Err(diagnostics);
    }
    if consort_protocol::ids::EnsembleId::new(file.name.as_str()).is_err() {
        diagnostics.push(MapDiagnostic::Name { text: file.name.clone() });
    }
    let mut map = Map {
        name: file.name.clone(),
        levels: Vec::new(),
        places: Vec::new(),
        lanes: Vec::new(),
        walls: Vec::new(),
        wall_levels: Vec::new(),
        doors: Vec::new(),
        lifts: Vec::new(),
        by_name: BTreeMap::new(),
        by_ends: BTreeMap::new(),
        doors_by_lane: BTreeMap::new(),
        lift_of: BTreeMap::new(),
    };
    building::check_levels(file, &mut map, &mut diagnostics);
    corners(&map.walls, &mut diagnostics);
    for entry in &file.places {
        place(entry, &mut map, &mut diagnostics);
    }
    for entry in &file.lanes {
        lane(entry, &mut map, file, &mut diagnostics);
    }
    building::check_doors_and_lifts(file, &mut map, &mut diagnostics);
    if diagnostics.is_empty() {
        diagnostics = connectivity::disconnected_places(&map);
    }
    if diagnostics.is_empty() { Ok(map) } else { Err(diagnostics) }
}

fn too_many(file: &MapFile) -> Vec<MapDiagnostic> {
    if file.places.is_empty() {
        return vec![MapDiagnostic::Empty];
    }
    [
        ("places", file.places.len(), limits::PLACES),
        ("lanes", file.lanes.len(), limits::LANES),
        ("wall corners", file.all_walls().map(Vec::len).sum(), limits::WALL_CORNERS),
        ("levels", file.levels.len(), limits::LEVELS),
        ("doors", file.doors.len(), limits::DOORS),
        ("lanes with doors", file.doors.iter().map(|door| door.on.len()).sum(), limits::LANES),
        ("lifts", file.lifts.len(), limits::LIFTS),
        ("lift stops", file.lifts.iter().map(|lift| lift.stops.len()).sum(), limits::PLACES),
    ]
    .into_iter()
    .filter(|(_, count, max)| count > max)
    .map(|(what, count, max)| MapDiagnostic::TooMany { what, count, max })
    .collect()
}

/// Checks the range of a coordinate or length; false for NaN.
fn is_in_range(value: f64) -> bool {
    value.abs() <= limits::EXTENT_M
}

fn corners(walls: &[Vec<(f64, f64)>], diagnostics: &mut Vec<MapDiagnostic>) {
    for (index, wall) in walls.iter().enumerate() {
        if let Some(&(x, y)) = wall.iter().find(|(x, y)| !is_in_range(*x) || !is_in_range(*y)) {
            diagnostics.push(MapDiagnostic::Corner { wall: index + 1, x, y });
        }
    }
}

fn place(entry: &PlaceEntry, map: &mut Map, diagnostics: &mut Vec<MapDiagnostic>) {
    for (field, value) in [("x_m", entry.x_m), ("y_m", entry.y_m), ("yaw_rad", entry.yaw_rad)] {
        if !is_in_range(value) {
            diagnostics.push(MapDiagnostic::Number { place: entry.name.clone(), field, value });
        }
    }
    match PlaceId::new(entry.name.as_str()) {
        Err(error) => diagnostics.push(error.into()),
        Ok(id) if map.by_name.contains_key(&id) => diagnostics.push(MapDiagnostic::Duplicate { place: id }),
        Ok(id) => {
            map.by_name.insert(id.clone(), PlaceIndex(map.places.len()));
            let pose = Pose::new(entry.x_m, entry.y_m, entry.yaw_rad);
            let level = building::check_level_of("place", &entry.name, entry.level.as_deref(), map, diagnostics);
            map.places.push(MapPlace { id, kind: entry.kind, pose, level, dock: entry.dock.clone() });
        }
    }
}

fn lane(entry: &LaneEntry, map: &mut Map, file: &MapFile, diagnostics: &mut Vec<MapDiagnostic>) {
    let name = || LaneName(entry.between.0.clone(), entry.between.1.clone());
    let mut end = |text: &String| {
        let found = PlaceId::new(text.as_str()).ok().and_then(|id| map.index(&id));
        if found.is_none() {
            let hint = did_you_mean(text, file.places.iter().map(|place| place.name.as_str()));
            diagnostics.push(MapDiagnostic::UnknownPlace { lane: name(), place: text.clone(), hint });
        }
        found
    };
    let (Some(from), Some(to)) = (end(&entry.between.0), end(&entry.between.1)) else { return };
    if from == to {
        diagnostics.push(MapDiagnostic::Loop { lane: name() });
        return;
    }
    let [from_level, to_level] = [from, to].map(|end| map.place_at(end).level);
    if from_level != to_level {
        let [from, to] = [from_level, to_level].map(|level| map.level(level).name.clone());
        diagnostics.push(BuildingDiagnostic::LaneAcrossLevels { lane: name(), from, to }.into());
        return;
    }
    let speed_limit = entry.speed_limit_mps.map(MetresPerSecond::new);
    let Ok(speed_limit) = speed_limit.transpose() else {
        let value = entry.speed_limit_mps.unwrap_or_default();
        diagnostics.push(BuildingDiagnostic::SpeedLimit { lane: name(), value }.into());
        return;
    };
    let (a, b) = (map.place_at(from).pose, map.place_at(to).pose);
    if ![a.x, a.y, b.x, b.y].into_iter().all(is_in_range) {
        return; // the error of the place is reported already
    }
    let straight_m = a.distance(b).get();
    let length_m = entry.length_m.unwrap_or(straight_m);
    let Some(length) = Metres::new(length_m).ok().filter(|_| length_m > 0.0 && is_in_range(length_m)) else {
        diagnostics.push(MapDiagnostic::Length { lane: name(), length_m });
        return;
    };
    if length_m < straight_m - ROUNDING_M {
        diagnostics.push(MapDiagnostic::TooShort { lane: name(), length_m, straight_m });
        return;
    }
    let two_way = !entry.one_way;
    let exists = map.by_ends.contains_key(&(from, to)) || (two_way && map.by_ends.contains_key(&(to, from)));
    if exists {
        diagnostics.push(MapDiagnostic::DuplicateLane { lane: name() });
        return;
    }
    let index = map.lanes.len();
    map.by_ends.insert((from, to), index);
    if two_way {
        map.by_ends.insert((to, from), index);
    }
    let [from, to] = [from, to].map(|end| map.place_at(end).id.clone());
    let graphs = entry.graphs.clone();
    map.lanes.push(Lane { from, to, length, two_way, speed_limit, facing: entry.facing, graphs });
}
