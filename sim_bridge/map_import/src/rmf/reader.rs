//! Reads a building: chooses the graphs, aligns the levels, names the places, and adds the entries
//! of each level to the map.

use super::coordinates::{self, CoordinateSystem, LevelTransform, Point};
use super::diagnostic::{EntryError, RmfDiagnostic};
use super::level::{Level, between, ends, graph_of, lane_of, level_named, level_of, walls};
use super::lifts;
use super::raw::{self, Building, Edge, parameter};
use crate::drawing::{Drawing, DrawnRobot, round, to_map_name};
use crate::lanes;
use crate::read_error::ReadError;
use crate::settings::ImportOptions;
use consort_world::map::render::DrawnItem;
use consort_world::map::{DEFAULT_LEVEL, DoorEntry, LaneEntry, LevelEntry, PlaceEntry, PlaceKind, intersection};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

/// Reads a building; `name` is the name of the map if the file gives none.
pub(crate) fn read(text: &str, name: &str, options: &ImportOptions) -> Result<Drawing, ReadError<RmfDiagnostic>> {
    let building: Building = serde_saphyr::from_str(text).map_err(|error| ReadError::Syntax(error.to_string()))?;
    let mut reader = Reader::default();
    reader.drawing.map.name = name.to_owned();
    let read = reader.building(&building, options);
    if let Err(error) = read {
        reader.diagnostics.push(error);
    }
    if !reader.diagnostics.is_empty() {
        return Err(ReadError::Invalid(reader.diagnostics));
    }
    reader.drawing.assign_nearest_places();
    Ok(reader.drawing)
}

#[derive(Default)]
struct Reader {
    drawing: Drawing,
    diagnostics: Vec<RmfDiagnostic>,
    /// True if lanes name their graphs.
    has_several_graphs: bool,
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
        self.check_graphs(&levels, options).map_err(whole)?;
        if let Some(graph) = options.graph {
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
        if self.has_several_graphs {
            self.drawing.map.lanes = lanes::join(std::mem::take(&mut self.drawing.map.lanes));
        }
        lifts::read(building, system, &levels, &mut self.drawing, &mut self.diagnostics);
        Ok(())
    }

    /// Checks the graphs of the lanes.
    fn check_graphs(&mut self, levels: &[Level], options: &ImportOptions) -> Result<(), EntryError> {
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
        if known.is_empty() {
            return if sound && self.diagnostics.is_empty() { Err(EntryError::NoLanes) } else { Ok(()) };
        }
        let list = known.iter().map(i64::to_string).collect::<Vec<_>>().join(", ");
        match options.graph {
            Some(graph) if !known.contains(&graph) => return Err(EntryError::UnknownGraph { graph, known: list }),
            None if known.len() > 1 => {
                self.has_several_graphs = true;
                let note = format!(
                    "the lanes belong to graphs {list}; the file of a robot names its graph, as `graph = \"0\"`"
                );
                self.drawing.notes.push(note);
            }
            _ => {}
        }
        Ok(())
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
            let dock = self.dock(level, *vertex);
            self.drawing.map.places.push(PlaceEntry {
                name: name.clone(),
                kind,
                x_m,
                y_m,
                yaw_rad: 0.0,
                level: level_name.clone(),
                dock,
            });
        }
        for lane in &level.lanes {
            match lane_of(level, lane) {
                Ok(entry) => {
                    let graph = graph_of(lane).ok().filter(|_| self.has_several_graphs);
                    let graphs = graph.map(|graph| graph.to_string()).into_iter().collect();
                    self.drawing.map.lanes.push(LaneEntry { graphs, ..entry });
                }
                Err(error) => self.report(format!("level {:?}, lane {}", level.name, lane.number), error),
            }
        }
        for door in &level.doors {
            self.door(level, door, level_name.clone(), at);
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
        let docks = self.dock(level, number).is_some();
        match (charges, parks || docks, vertex.name.is_empty()) {
            (true, _, _) => PlaceKind::Charger,
            (false, true, _) => PlaceKind::Dock,
            (false, false, true) => PlaceKind::Corridor,
            (false, false, false) => PlaceKind::Other,
        }
    }

    /// Returns the name by which drivers know the dock or the charger at a vertex.
    fn dock(&self, level: &Level, number: usize) -> Option<String> {
        let name = level.vertices[number].parameters.get("dock_name").and_then(Value::as_str)?;
        (!name.is_empty()).then(|| name.to_owned())
    }

    fn door(&mut self, level: &Level, door: &Edge, level_name: Option<String>, at: impl Fn(usize) -> Point) {
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
        // Only a door without lanes names its level.
        let mut drawn_on = None;
        if on.is_empty() {
            self.drawing.notes.push(format!("{} ({name:?}) is only drawn: no lane leads through it", here()));
            drawn_on = Some(level_name.unwrap_or_else(|| DEFAULT_LEVEL.to_owned()));
        }
        let door = DoorEntry { name, on, span: Some((a, b)), level: drawn_on, ..DoorEntry::default() };
        self.drawing.map.doors.push(door);
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
        let at_lanes = level.lanes.iter().filter(|lane| lane.ends.contains(&number));
        let graphs: BTreeSet<i64> = at_lanes.filter_map(|lane| graph_of(lane).ok()).collect();
        let graph = graphs.first().filter(|_| self.has_several_graphs && graphs.len() == 1).map(i64::to_string);
        let kind = kind.map(|kind| ("robot_type".to_owned(), kind));
        let item = DrawnItem {
            id: format!("{} vertex {number}", level.name),
            kind: "robot".to_owned(),
            name,
            level: level_name,
            x_m,
            y_m,
            yaw_rad: round(first.map_or(0.0, heading)),
            attributes: kind.into_iter().chain(graph.map(|graph| ("graph".to_owned(), graph))).collect(),
            ..DrawnItem::default()
        };
        self.drawing.robots.push(DrawnRobot { item, ..DrawnRobot::default() });
    }
}
