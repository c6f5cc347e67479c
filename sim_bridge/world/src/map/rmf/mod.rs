//! Buildings of Open-RMF: the `.building.yaml` files of its traffic editor.
//!
//! The reader uses these parts of the file:
//!
//! - **coordinates.** `reference_image` (default): pixels with y down, which are flipped. The scale
//!   is the mean of distance divided by length over the `measurements` of the reference level, or
//!   [`ImportOptions::scale_m`]. Other levels are aligned with the reference level by their common
//!   `fiducials`. `cartesian_meters`: metres, unchanged. `wgs84`: longitude and latitude, converted
//!   to metres around the vertex named by the parameter `generate_origin_vertex`, else around the
//!   least longitude and latitude.
//! - **graph.** Lanes have a `graph_idx`: robots of the same kind drive on the same graph. Only the
//!   graph [`ImportOptions::graph`] is read, by default the graph with the lowest number. The
//!   vertices at its lanes become places; other vertices do not.
//! - **places.** A vertex without a name becomes `L1 vertex 7`. A name that occurs on several
//!   levels is followed by its level, as in `lobby (L2)`. A vertex with `is_charger` is a charger;
//!   a vertex with `is_parking_spot` or `dock_name` is a dock.
//! - **lanes.** `bidirectional`, `speed_limit` (if above 0) and `orientation` (`forward`,
//!   `backward`).
//! - **doors** are placed on the lanes that cross them. Doors without such a lane are ignored. The
//!   format has no opening time.
//! - **lifts** stop at the places in their cabin, on each level with doors (`level_doors`) between
//!   their lowest and highest floor, and at the places with their name in `lift_cabin`.
//! - **robots** stand at vertices with `spawn_robot_name` ([`Drawing::robots`]).
//!
//! Models, floors, lights and crowds are ignored.

mod coordinates;
mod diagnostic;
mod raw;
#[cfg(test)]
mod tests;

pub use diagnostic::{EntryError, RmfDiagnostic};

use super::building::intersection;
use super::drawing::{Drawing, DrawnItem, DrawnRobot};
use super::file::{DoorEntry, ImportOptions, LaneEntry, LevelEntry, LiftEntry, PlaceEntry};
use super::import::{ImportError, round, to_map_name};
use super::{Facing, MapDiagnostic, PlaceKind};
use crate::suggest::did_you_mean;
use coordinates::{CoordinateSystem, LevelTransform};
use raw::{Building, Edge, EntryReader, Fiducial, Vertex, parameter};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

/// Margin around the cabin in which a place is still a stop, in metres: the gap between cabin and
/// shaft.
const GAP_M: f64 = 0.05;

type Point = (f64, f64);

/// A level with valid entries.
struct Level<'a> {
    name: &'a str,
    elevation: f64,
    vertices: Vec<Vertex>,
    lanes: Vec<Edge>,
    walls: Vec<Edge>,
    doors: Vec<Edge>,
    measurements: Vec<Edge>,
    fiducials: Vec<Fiducial>,
    /// Transform to metres; `None` if the level cannot be aligned with the reference level.
    frame: Option<LevelTransform>,
    /// Name of the place at each vertex with a lane of the graph.
    places: BTreeMap<usize, String>,
}

/// Reads a building; `name` is the name of the map if the file gives none.
pub(super) fn read(text: &str, name: &str, options: &ImportOptions) -> Result<Drawing, ImportError> {
    let building: Building = serde_saphyr::from_str(text).map_err(|error| ImportError::Syntax(error.to_string()))?;
    let mut reader = Reader::default();
    reader.drawing.map.name = name.to_owned();
    let read = reader.building(&building, options);
    if let Err(error) = read {
        reader.diagnostics.push(error);
    }
    if !reader.diagnostics.is_empty() {
        return Err(ImportError::Invalid(reader.diagnostics.into_iter().map(MapDiagnostic::from).collect()));
    }
    reader.drawing.assign_nearest_places();
    Ok(reader.drawing)
}

#[derive(Default)]
struct Reader {
    drawing: Drawing,
    diagnostics: Vec<RmfDiagnostic>,
}

impl Reader {
    fn report(&mut self, at: String, error: EntryError) {
        self.diagnostics.push(RmfDiagnostic { at, error });
    }

    fn building(&mut self, building: &Building, options: &ImportOptions) -> Result<(), RmfDiagnostic> {
        let whole = |error| RmfDiagnostic { at: "building".to_owned(), error };
        let named = [&building.name, &building.building_name].into_iter().flatten().filter_map(raw::text);
        if let Some(name) = named.into_iter().find(|name| !name.is_empty()) {
            self.drawing.map.name = to_map_name(&name);
        }
        let system = CoordinateSystem::of(building.coordinate_system.as_deref()).map_err(whole)?;
        let mut levels: Vec<Level> =
            building.levels.0.iter().map(|(name, level)| level_of(name, level, &mut self.diagnostics)).collect();
        if levels.is_empty() {
            return Err(whole(EntryError::NoLevels));
        }
        let graph = self.graph(&levels, options).map_err(whole)?;
        if let Some(graph) = graph {
            for level in &mut levels {
                level.lanes.retain(|lane| graph_of(lane).is_ok_and(|of| of == graph));
            }
        }
        self.place(building, system, options, &mut levels).map_err(whole)?;
        self.name(&mut levels);
        levels.sort_by(|a, b| a.elevation.total_cmp(&b.elevation));
        let several = levels.iter().filter(|level| level.frame.is_some()).count() > 1;
        for level in &levels {
            self.level(level, several, system);
        }
        self.lifts(building, system, &levels);
        Ok(())
    }

    /// Returns the graph to read; `None` if the lanes are invalid.
    fn graph(&mut self, levels: &[Level], options: &ImportOptions) -> Result<Option<i64>, EntryError> {
        let mut known = BTreeSet::new();
        let sound = self.diagnostics.is_empty();
        for level in levels {
            for lane in &level.lanes {
                match graph_of(lane) {
                    Ok(graph) => {
                        known.insert(graph);
                    }
                    Err(error) => self.report(format!("level {:?}, lane {}", level.name, lane.number), error),
                }
            }
        }
        let list = |known: &BTreeSet<i64>| known.iter().map(i64::to_string).collect::<Vec<_>>().join(", ");
        match (options.graph, known.first()) {
            (_, None) if sound && self.diagnostics.is_empty() => Err(EntryError::NoLanes),
            (_, None) => Ok(None),
            (Some(graph), _) if !known.contains(&graph) => Err(EntryError::UnknownGraph { graph, known: list(&known) }),
            (Some(graph), _) => Ok(Some(graph)),
            (None, Some(first)) => {
                let first = *first;
                known.remove(&first);
                if !known.is_empty() {
                    let others = list(&known);
                    self.drawing
                        .notes
                        .push(format!("only lanes of graph {first} are read; lanes of graph {others} are ignored"));
                }
                Ok(Some(first))
            }
        }
    }

    /// Computes the transform of each level.
    fn place(
        &mut self,
        building: &Building,
        system: CoordinateSystem,
        options: &ImportOptions,
        levels: &mut [Level],
    ) -> Result<(), EntryError> {
        let reference = match &building.reference_level_name {
            None => 0,
            Some(name) => level_named(levels, "reference_level_name", name)?,
        };
        let frame = match system {
            CoordinateSystem::CartesianMeters => Some(LevelTransform::METRES),
            CoordinateSystem::Wgs84 => {
                let parameters = raw::parameters(building.parameters.as_ref())?;
                let vertices = levels.iter().flat_map(|level| &level.vertices);
                Some(LevelTransform::local_tangent_plane(coordinates::origin(&parameters, vertices)))
            }
            CoordinateSystem::ReferenceImage => {
                let level = &levels[reference];
                let measured = || {
                    coordinates::metres_per_pixel(
                        level.name,
                        &level.vertices,
                        &level.measurements,
                        &mut self.diagnostics,
                    )
                };
                options.scale_m.or_else(measured).map(LevelTransform::scaled)
            }
        };
        let Some(frame) = frame else { return Ok(()) };
        let (base, marks) = (levels[reference].name.to_owned(), levels[reference].fiducials.clone());
        for (index, level) in levels.iter_mut().enumerate() {
            if index == reference || system != CoordinateSystem::ReferenceImage {
                level.frame = Some(frame);
                continue;
            }
            let pairs = coordinates::shared_fiducials(system, &marks, &level.fiducials);
            level.frame = LevelTransform::fit_to_reference(&frame, &pairs);
            if level.frame.is_some() {
                continue;
            }
            let error = EntryError::NotAligned { reference: base.clone(), shared: pairs.len() };
            if level.lanes.is_empty() {
                self.drawing.notes.push(format!("level {:?} is ignored: it has no lanes, and {error}", level.name));
            } else {
                self.report(format!("level {:?}", level.name), error);
            }
        }
        Ok(())
    }

    /// Names the vertices at lanes.
    fn name(&mut self, levels: &mut [Level]) {
        let mut used: BTreeMap<&str, usize> = BTreeMap::new();
        let mut duplicates = Vec::new();
        for level in levels.iter() {
            let mut here: BTreeMap<&str, usize> = BTreeMap::new();
            for vertex in ends(&level.lanes) {
                let name = level.vertices[vertex].name.as_str();
                if name.is_empty() {
                    continue;
                }
                match here.get(name) {
                    None => {
                        here.insert(name, vertex);
                        *used.entry(name).or_default() += 1;
                    }
                    Some(other) => {
                        let error = EntryError::DuplicateName { name: name.to_owned(), other: *other };
                        duplicates.push((format!("level {:?}, vertex {vertex}", level.name), error));
                    }
                }
            }
        }
        let named: Vec<BTreeMap<usize, String>> = levels
            .iter()
            .map(|level| {
                let name = |vertex: usize| match level.vertices[vertex].name.as_str() {
                    "" => format!("{} vertex {vertex}", level.name),
                    name if used.get(name).is_some_and(|count| *count > 1) => format!("{name} ({})", level.name),
                    name => name.to_owned(),
                };
                ends(&level.lanes).into_iter().map(|vertex| (vertex, name(vertex))).collect()
            })
            .collect();
        for (level, places) in levels.iter_mut().zip(named) {
            level.places = places;
        }
        for (at, error) in duplicates {
            self.report(at, error);
        }
    }

    fn level(&mut self, level: &Level, several: bool, system: CoordinateSystem) {
        let Some(frame) = level.frame else { return };
        let at = |vertex: usize| {
            let (x, y) = frame.apply(system.to_y_up(level.vertices[vertex].at));
            (round(x), round(y))
        };
        let level_name = several.then(|| level.name.to_owned());
        for (vertex, name) in &level.places {
            let ((x_m, y_m), kind) = (at(*vertex), self.kind(level, *vertex));
            self.drawing.map.places.push(PlaceEntry {
                name: name.clone(),
                kind,
                x_m,
                y_m,
                yaw_rad: 0.0,
                level: level_name.clone(),
            });
        }
        for lane in &level.lanes {
            match lane_of(level, lane) {
                Ok(lane) => self.drawing.map.lanes.push(lane),
                Err(error) => self.report(format!("level {:?}, lane {}", level.name, lane.number), error),
            }
        }
        for door in &level.doors {
            self.door(level, door, at);
        }
        for (number, vertex) in level.vertices.iter().enumerate() {
            if let Some(name) = vertex.parameters.get("spawn_robot_name").and_then(raw::text) {
                self.robot(level, number, name, level_name.clone(), at);
            }
        }
        let walls = walls(&level.walls, at);
        if several {
            let entry = LevelEntry { name: level.name.to_owned(), elevation_m: round(level.elevation), walls };
            self.drawing.map.levels.push(entry);
        } else {
            self.drawing.map.walls = walls;
        }
    }

    fn kind(&mut self, level: &Level, number: usize) -> PlaceKind {
        let vertex = &level.vertices[number];
        let mut flag = |name: &str| {
            let found = parameter(&vertex.parameters, name, "[4, true] or [4, false]", Value::as_bool);
            found.unwrap_or_else(|error| {
                self.report(format!("level {:?}, vertex {number}", level.name), error);
                None
            })
        };
        let charges = flag("is_charger") == Some(true);
        let parks = flag("is_parking_spot") == Some(true);
        let docks = vertex.parameters.get("dock_name").and_then(Value::as_str).is_some_and(|name| !name.is_empty());
        match (charges, parks || docks, vertex.name.is_empty()) {
            (true, _, _) => PlaceKind::Charger,
            (false, true, _) => PlaceKind::Dock,
            (false, false, true) => PlaceKind::Corridor,
            (false, false, false) => PlaceKind::Other,
        }
    }

    fn door(&mut self, level: &Level, door: &Edge, at: impl Fn(usize) -> Point) {
        let here = || format!("level {:?}, door {}", level.name, door.number);
        let name = match parameter(&door.parameters, "name", "[1, name]", raw::text) {
            Ok(Some(name)) if !name.is_empty() => name,
            Ok(_) => return self.report(here(), EntryError::Missing { field: "name" }),
            Err(error) => return self.report(here(), error),
        };
        let [a, b] = door.ends.map(&at);
        let across = level.lanes.iter().filter(|lane| {
            let [from, to] = lane.ends.map(&at);
            intersection(from, to, a, b).is_some()
        });
        let on: Vec<_> = across.map(|lane| between(level, lane)).collect();
        if on.is_empty() {
            self.drawing.notes.push(format!("{} ({name:?}) is ignored: no lane leads through it", here()));
            return;
        }
        self.drawing.map.doors.push(DoorEntry { name, on, span: Some((a, b)), ..DoorEntry::default() });
    }

    fn robot(
        &mut self,
        level: &Level,
        number: usize,
        name: String,
        level_name: Option<String>,
        at: impl Fn(usize) -> Point,
    ) {
        let vertex = &level.vertices[number];
        let (x_m, y_m) = at(number);
        let heading = |lane: &Edge| {
            let [from, to] = lane.ends.map(&at);
            (to.1 - from.1).atan2(to.0 - from.0)
        };
        let first = level.lanes.iter().find(|lane| lane.ends.contains(&number));
        let kind = vertex.parameters.get("spawn_robot_type").and_then(raw::text);
        let item = DrawnItem {
            id: format!("{} vertex {number}", level.name),
            kind: "robot".to_owned(),
            name,
            level: level_name,
            x_m,
            y_m,
            yaw_rad: round(first.map_or(0.0, heading)),
            attributes: kind.into_iter().map(|kind| ("robot_type".to_owned(), kind)).collect(),
            ..DrawnItem::default()
        };
        self.drawing.robots.push(DrawnRobot { item, ..DrawnRobot::default() });
    }

    fn lifts(&mut self, building: &Building, system: CoordinateSystem, levels: &[Level]) {
        let lifts = building.lifts.as_ref().map_or(&[][..], |lifts| &lifts.0);
        let names: BTreeSet<&str> = lifts.iter().map(|(name, _)| name.as_str()).collect();
        let mut named_stops: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
        for level in levels {
            for (vertex, place) in &level.places {
                let named = level.vertices[*vertex].parameters.get("lift_cabin").and_then(Value::as_str);
                let Some(named) = named.filter(|named| !named.is_empty()) else { continue };
                if names.contains(named) {
                    named_stops.entry(named).or_default().insert(place);
                } else {
                    let hint = did_you_mean(named, names.iter().copied());
                    let at = format!("level {:?}, vertex {vertex}", level.name);
                    self.report(at, EntryError::UnknownLift { lift: named.to_owned(), hint });
                }
            }
        }
        for (name, lift) in lifts {
            let cabin = match Cabin::of(lift, system, levels, &building.reference_level_name) {
                Ok(cabin) => cabin,
                Err(error) => {
                    self.report(format!("lift {name:?}"), error);
                    continue;
                }
            };
            let named_stops = named_stops.get(name.as_str());
            let stops: Vec<String> = levels
                .iter()
                .flat_map(|level| level.places.iter().map(move |(vertex, place)| (level, *vertex, place)))
                .filter(|(level, vertex, place)| {
                    named_stops.is_some_and(|named_stops| named_stops.contains(place.as_str()))
                        || cabin.holds(level, *vertex, system)
                })
                .map(|(_, _, place)| place.clone())
                .collect();
            if stops.is_empty() {
                self.drawing
                    .notes
                    .push(format!("lift {name:?} is ignored: no lane ends in its cabin on a level with its doors"));
            } else {
                self.drawing.map.lifts.push(LiftEntry { name: name.clone(), stops, ..LiftEntry::default() });
            }
        }
    }
}

/// The floor of a lift, and the levels with its doors.
struct Cabin {
    centre: Point,
    /// Half of its width and depth.
    half: (f64, f64),
    yaw: f64,
    levels: BTreeSet<String>,
}

impl Cabin {
    fn of(
        lift: &raw::Lift,
        system: CoordinateSystem,
        levels: &[Level],
        reference: &Option<String>,
    ) -> Result<Cabin, EntryError> {
        for (field, value) in [("width", lift.width), ("depth", lift.depth)] {
            if !(value > 0.0 && value.is_finite()) {
                let (field, text) = (field.to_owned(), value.to_string());
                return Err(EntryError::InvalidValue { field, text, allowed: "a number of metres above 0" });
            }
        }
        let floor = |field: &'static str, name: &Option<String>| {
            let named = name.as_deref().filter(|name| !name.is_empty());
            named.map(|name| level_named(levels, field, name)).transpose()
        };
        let own = floor("reference_floor_name", &lift.reference_floor_name)?;
        let shared = floor("reference_level_name", reference)?;
        let lowest =
            floor("lowest_floor", &lift.lowest_floor)?.map_or(f64::NEG_INFINITY, |level| levels[level].elevation);
        let highest =
            floor("highest_floor", &lift.highest_floor)?.map_or(f64::INFINITY, |level| levels[level].elevation);
        let mut served = BTreeSet::new();
        for (name, doors) in lift.level_doors.as_ref().map_or(&[][..], |levels| &levels.0) {
            let level = level_named(levels, "level_doors", name)?;
            let has_doors = doors.as_array().is_none_or(|doors| !doors.is_empty());
            if has_doors && (lowest..=highest).contains(&levels[level].elevation) {
                served.insert(name.clone());
            }
        }
        let frame = own.or(shared).and_then(|level| levels[level].frame);
        let frame = frame.or_else(|| levels.iter().find_map(|level| level.frame)).unwrap_or(LevelTransform::METRES);
        let centre = frame.apply(system.to_y_up((lift.x, lift.y)));
        Ok(Cabin { centre, half: (lift.width / 2.0 + GAP_M, lift.depth / 2.0 + GAP_M), yaw: lift.yaw, levels: served })
    }

    fn holds(&self, level: &Level, vertex: usize, system: CoordinateSystem) -> bool {
        let Some(frame) = level.frame.filter(|_| self.levels.contains(level.name)) else { return false };
        let (x, y) = frame.apply(system.to_y_up(level.vertices[vertex].at));
        let (dx, dy) = (x - self.centre.0, y - self.centre.1);
        let (sin, cos) = self.yaw.sin_cos();
        (dx * cos + dy * sin).abs() <= self.half.0 && (dy * cos - dx * sin).abs() <= self.half.1
    }
}

fn level_of<'a>(name: &'a str, raw: &raw::Level, diagnostics: &mut Vec<RmfDiagnostic>) -> Level<'a> {
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

fn level_named(levels: &[Level], field: &'static str, name: &str) -> Result<usize, EntryError> {
    levels.iter().position(|level| level.name == name).ok_or_else(|| {
        let hint = did_you_mean(name, levels.iter().map(|level| level.name));
        EntryError::UnknownLevel { field, level: name.to_owned(), hint }
    })
}

/// Returns the graph of a lane; 0 if the lane gives none.
fn graph_of(lane: &Edge) -> Result<i64, EntryError> {
    parameter(&lane.parameters, "graph_idx", "a whole number", Value::as_i64).map(|graph| graph.unwrap_or(0))
}

fn ends(lanes: &[Edge]) -> BTreeSet<usize> {
    lanes.iter().flat_map(|lane| lane.ends).collect()
}

fn between(level: &Level, lane: &Edge) -> (String, String) {
    (level.places[&lane.ends[0]].clone(), level.places[&lane.ends[1]].clone())
}

fn lane_of(level: &Level, lane: &Edge) -> Result<LaneEntry, EntryError> {
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
    })
}

/// Joins walls to polylines: a wall that begins at the end of the wall before continues it.
fn walls(walls: &[Edge], at: impl Fn(usize) -> Point) -> Vec<Vec<Point>> {
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
